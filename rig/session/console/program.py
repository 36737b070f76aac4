"""The console's own loop: keys, messages, picture, one after another in one thread, so that it shows when one hangs.

Standard input and output are the terminal. Between two rounds it says that it is alive; whatever stops the rounds, a
stopped process, a terminal that takes no more output, ends a hit within seconds (`rig.session.console.desk`).
"""

from __future__ import annotations

import fcntl
import os
import select
import signal
import struct
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from rig.realtime.hand import SharedHand
from rig.session.console import terminal
from rig.session.console.conversation import Conversation, Stop
from rig.session.console.keyboard import Event, Key, Keyboard, Mode, Mouse
from rig.session.console.live import Snapshot
from rig.session.console.messages import Lines, line_of
from rig.session.console.plain import PlainLines
from rig.session.console.screen import picture
from rig.session.console.seat import Seat, SeatHand
from rig.session.keymap import STOP

if TYPE_CHECKING:
    from rich.console import Console

assert sys.platform != "win32"

ROUND_S = 0.08  # between two pictures while the rig moves: 12.5 a second
QUIET_S = 0.2  # between two rounds while it does not
WHOLE_S = 2.0  # between two pictures of which every line is written
CLEAR = "\x1b[2J"
REDRAW_S = 0.5  # between two pictures then, if nothing else happens
ESCAPE_S = 0.05  # how long a lone escape waits for the rest of a sequence
IN, OUT = 0, 1
GONE = 3  # exit code: the terminal is gone
READ_BYTES = 4096
LEFT = "the session's program has ended; continue with `rig session resume`\n"


def main(arguments: list[str]) -> int:
    """Be a console until the session says that it is over, or is gone."""
    from_session, to_session = (int(text) for text in arguments)
    for number in (signal.SIGINT, signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN):
        signal.signal(number, signal.SIG_IGN)  # ^C is for the session's program, which ends this one
    with _signals() as woken:
        console = _Console(from_session, to_session, woken)
        try:
            return console.run()
        except BrokenPipeError:
            return 0  # the session's program is gone


@contextmanager
def _signals() -> Iterator[int]:
    """A descriptor that can be read when the window has changed or somebody wants this process to end."""
    reader, writer = os.pipe()
    for descriptor in (reader, writer):
        os.set_blocking(descriptor, False)

    def end(number: int, frame: object) -> None:
        raise SystemExit(0)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGHUP, end)
    signal.signal(signal.SIGWINCH, lambda number, frame: None)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        yield reader
    finally:
        signal.set_wakeup_fd(-1)
        os.close(reader)
        os.close(writer)


class _Console:
    """The parts together."""

    def __init__(self, from_session: int, to_session: int, woken: int) -> None:
        self._from, self._to, self._woken = from_session, to_session, woken
        self._lines = Lines()
        setup, self._early = self._setup()
        hand = setup.get("hand")
        self._hand = None if hand is None else _MovedHand(hand)
        self._seat = Seat(setup, self._say, self._hand)
        self._talk = self._seat.talk
        self._attributes = setup["attributes"]
        self._bell = self._talk.keymap.bell
        self._keyboard = Keyboard()
        self._read_s = 0.0  # when bytes came last
        self._is_terminal = terminal.is_terminal(IN)
        self._typed: list[Event] = []  # of a script, which may be ahead of the questions
        self._script_over = False
        self._over = False
        self._drawn_s = 0.0
        self._face: _Face = _Lines() if setup["plain"] or not self._is_terminal else _Screen(self._hand)

    def _setup(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """The first message, and what came with it."""
        while True:
            data = os.read(self._from, READ_BYTES)
            if not data:
                raise BrokenPipeError
            messages = list(self._lines.feed(data))
            if messages:
                return messages[0], messages[1:]

    def run(self) -> int:
        """Rounds until it is over."""
        before = None if self._attributes is None else terminal.from_plain(self._attributes)
        if before is not None:
            typed = Keyboard().feed(
                terminal.take(IN, before)
            )  # while no console was here: no answer, but STOP is STOP
            if Key(STOP) in typed:
                self._seat.do([Stop()])
            for key in typed:
                if isinstance(key, Key):  # it may be down
                    self._talk.held.arrive(key.name, time.monotonic())
        try:
            with self._face:
                for message in self._early:
                    self._hear(message)
                while not self._over:
                    if not self._round():
                        return GONE
            return 0
        except BrokenPipeError:
            self._over = True
            raise
        finally:
            self._seat.live.close()
            if self._hand is not None:
                self._hand.close()
            if before is not None:
                terminal.give_back(IN, before, screen=False)

    def _round(self) -> bool:
        """One look at everything; False when the terminal is gone."""
        self._say("alive")
        sources = [self._from, self._woken]
        if not self._script_over:
            sources.append(IN)
        wait = ROUND_S if self._talk.moving else QUIET_S
        if self._keyboard.waiting:
            wait = min(wait, max(0.0, self._read_s + ESCAPE_S - time.monotonic()))
        ready, _, _ = select.select(sources, [], [], wait)
        if self._woken in ready:
            with suppress(BlockingIOError):
                os.read(self._woken, READ_BYTES)
        # A key that was pressed before a question could be seen is no answer to it: keys first.
        if IN in ready and not self._read():
            return False
        if self._from in ready:
            data = os.read(self._from, READ_BYTES)
            if not data:
                raise BrokenPipeError
            for message in self._lines.feed(data):
                self._hear(message)
        if self._keyboard.waiting and time.monotonic() - self._read_s >= ESCAPE_S:
            self._take(self._keyboard.flush())
        self._run_script()
        self._seat.look(time.monotonic())
        if ready or self._talk.moving or time.monotonic() - self._drawn_s > REDRAW_S:
            self._face.show(self._talk, self._seat.snapshot)
            self._drawn_s = time.monotonic()
        return True

    def _hear(self, message: dict[str, Any]) -> None:
        if self._seat.hear(message["kind"], message, time.monotonic()) and self._bell and self._is_terminal:
            os.write(OUT, b"\a")
        self._over = self._over or message["kind"] == "end"

    def _read(self) -> bool:
        """What was typed; False when there will be no more and somebody must still answer."""
        try:
            data = os.read(IN, READ_BYTES)
        except OSError:  # the terminal hung up, or this is not its foreground any more
            data = b""
        if data:
            self._read_s = time.monotonic()
            self._take(self._keyboard.feed(data))
        elif self._is_terminal:
            self._say("gone", why="the terminal is gone")
            return False
        else:
            self._script_over = True
        return True

    def _take(self, events: list[Event]) -> None:
        if not self._is_terminal:
            self._typed += events
            return
        for event in events:
            self._event(event)

    def _run_script(self) -> None:
        """Without a terminal, each key waits for a question: nobody is there to see when one is asked."""
        while self._typed and self._talk.question is not None:
            self._event(self._typed.pop(0))
        if self._script_over and not self._typed and self._talk.question is not None:
            self._say("gone", why="standard input has ended, and nobody else can answer")
            self._script_over = True
            self._talk.question = None

    def _event(self, event: Event) -> None:
        if isinstance(event, Key):
            self._face.typed(self._talk, event.name)
            self._seat.key(event.name, time.monotonic() if self._is_terminal else None)
        elif self._hand is not None:
            self._hand.mouse(event)

    def _say(self, kind: str, **content: Any) -> None:
        os.write(self._to, line_of(kind, **content))  # short: a pipe takes it whole


class _Face:
    """How things are shown."""

    def __enter__(self) -> _Face:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        pass

    def show(self, talk: Conversation, live: Snapshot | None) -> None:
        """Show how things stand."""

    def typed(self, talk: Conversation, key: str) -> None:
        """A key is about to be understood."""


class _Lines(_Face):
    """As lines."""

    def __init__(self) -> None:
        self._plain = PlainLines()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, BrokenPipeError):
            _write(LEFT)

    def show(self, talk: Conversation, live: Snapshot | None) -> None:
        """Print what is new."""
        for line in self._plain.lines(talk, live, time.monotonic()):
            _write(line + "\n")

    def typed(self, talk: Conversation, key: str) -> None:
        """Echo a line that is being typed: the terminal does not."""
        if talk.entry is None or not terminal.is_terminal(IN):
            return
        if key == "enter":
            _write("\n")
        elif key == "backspace" and talk.entry.text:
            _write("\b \b")
        elif key == "space" or len(key) == 1:
            _write(" " if key == "space" else key)


class _Screen(_Face):
    """As a picture in the terminal's alternate screen, of which only changed lines are written.

    The line may be slow (ssh, a serial console), and a terminal on this computer takes time that a loop may want.
    """

    def __init__(self, hand: _MovedHand | None) -> None:
        self._console: Console = Console(file=sys.stdout, highlight=False, markup=False, emoji=False)
        self._blocks = (self._console.encoding or "").lower().startswith("utf")
        self._mouse = hand is not None and hand.kind == "mouse"
        self._shown: list[str] = []
        self._size = (0, 0)
        self._whole_s = 0.0

    def __enter__(self) -> _Face:
        mouse = terminal.MOUSE_ON + terminal.ASK_PIXELS if self._mouse else ""
        _write(terminal.SCREEN_ON + mouse)
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        _write((terminal.MOUSE_OFF if self._mouse else "") + terminal.STYLE_OFF + terminal.SCREEN_OFF)
        if isinstance(error, BrokenPipeError):
            _write(LEFT)

    def show(self, talk: Conversation, live: Snapshot | None) -> None:
        """Draw what has changed; now and then everything, should somebody else have written there."""
        now_s = time.monotonic()
        width, height = size = self._console.size.width, self._console.size.height
        with self._console.capture() as drawn:
            self._console.print(
                picture(talk, live, now_s, width=width, height=height, blocks=self._blocks),
                height=height,
                end="",
            )
        lines = drawn.get().split("\n")[:height]
        anew = size != self._size or now_s - self._whole_s > WHOLE_S
        if anew:
            self._whole_s = now_s
        before = [] if anew else self._shown
        changed = [
            f"\x1b[{n + 1};1H{line}" for n, line in enumerate(lines) if n >= len(before) or line != before[n]
        ]
        if changed:
            _write((CLEAR if size != self._size else "") + "".join(changed))
        self._shown, self._size = lines, size


class _MovedHand(SeatHand):
    """The simulated hand, moved at this terminal."""

    def __init__(self, told: dict[str, Any]) -> None:
        super().__init__(told["kind"], float(told["press"]), SharedHand.create(Path(told["path"])))
        self._pixels = False

    def mouse(self, event: Event) -> None:
        """Take a motion of the mouse, or the terminal's word that it can tell pixels."""
        if (
            isinstance(event, Mode)
            and event.number == terminal.PIXELS
            and event.known
            and _width(pixels=True)
        ):
            self._pixels = True
            _write(terminal.PIXELS_ON)
        elif isinstance(event, Mouse) and self.kind == "mouse":
            width = max(2, _width(pixels=self._pixels))
            self.pointer.point((event.x - 1) / (width - 1), held=event.held)


def _width(*, pixels: bool) -> int:
    """Width of the terminal in pixels (0: it does not say) or cells."""
    try:
        _, cells, wide, _ = struct.unpack("HHHH", fcntl.ioctl(IN, termios.TIOCGWINSZ, bytes(8)))
    except OSError:
        return 0
    return int(wide if pixels else cells)


def _write(text: str) -> None:
    with suppress(OSError):
        sys.stdout.write(text)
        sys.stdout.flush()
