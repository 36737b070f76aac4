"""Run the console on a terminal (standard input and output): keys, messages and output in one thread.

With one thread, a hang of any part stops the messages to the session, which then detects the hang.
"""

import os
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.realtime.hand import SharedHand
from rig.session.planning._keymap import STOP
from rig.session.terminal import _terminal as terminal
from rig.session.terminal._conversation import StopPressed
from rig.session.terminal._keyboard import Keyboard
from rig.session.terminal._messages import MessageReader, line_of
from rig.session.terminal._plain import PlainLines
from rig.session.terminal._seat import Seat, SeatHand

assert sys.platform != "win32"

ROUND_S = 0.08  # between two rounds of the console while the rig moves: 12.5 rounds a second
QUIET_S = 0.2  # between two rounds while the rig does not move
ESCAPE_S = 0.05  # longest wait after a lone escape byte for the rest of its sequence
IN, OUT = 0, 1
GONE = 3  # exit code: the terminal is gone
READ_BYTES = 4096
LEFT = "the session's program has ended; continue with `rig session resume`\n"


def main(arguments: list[str]) -> int:
    """Run the console with the descriptors of two pipes (from and to the session); return the exit code."""
    from_session, to_session = (int(text) for text in arguments)
    for number in (signal.SIGINT, signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN):
        # Ctrl+C signals the session's process, which ends this one in an orderly way.
        signal.signal(number, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    try:
        return _Console(from_session, to_session).run()
    except BrokenPipeError:
        return 0  # the session's program is gone


def _end(number: int, frame: object) -> None:
    raise SystemExit(0)


class _Console:
    """The running console with its parts: terminal, keyboard, messages, conversation and output."""

    def __init__(self, from_session: int, to_session: int) -> None:
        self._from, self._to = from_session, to_session
        self._lines = MessageReader()
        setup, self._early = self._setup()
        hand = setup["hand"]
        self._hand = (
            None
            if hand is None
            else SeatHand("keyboard", float(hand["press"]), SharedHand.create(Path(hand["path"])))
        )
        self._seat = Seat(setup, self._send, self._hand)
        self._talk = self._seat.talk
        self._attributes = setup["attributes"]
        self._bell = self._talk.keymap.bell
        self._keyboard = Keyboard()
        self._read_s = 0.0  # when bytes came last
        self._over = False
        self._printer = PlainLines()

    def _setup(self) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        while True:
            data = os.read(self._from, READ_BYTES)
            if not data:
                raise BrokenPipeError
            messages = list(self._lines.feed(data))
            if messages:
                return messages[0], messages[1:]

    def run(self) -> int:
        """Display the session and process keys until the session ends; return the exit code."""
        before = terminal.from_plain(self._attributes)
        # What was typed while no console was here answers nothing, but STOP is STOP, and a key may still be down.
        typed = Keyboard().feed(terminal.take(IN, before))
        if STOP in typed:
            self._seat.do([StopPressed()])
        for key in typed:
            self._talk.held.arrive(key, time.monotonic())
        try:
            for message in self._early:
                self._handle_message(message)
            while not self._over:
                if not self._round():
                    return GONE
            return 0
        except BrokenPipeError:
            # The program that conducts has died; without this line its person would face a screen that stopped.
            _write(LEFT)
            raise
        finally:
            self._seat.live.close()
            if self._hand is not None:
                self._hand.close()
            terminal.give_back(IN, before)

    def _round(self) -> bool:
        # Whatever stops the rounds (a stopped process, a terminal that takes no more output) ends a hit within seconds.
        self._send("alive")
        wait = ROUND_S if self._talk.moving else QUIET_S
        if self._keyboard.waiting:
            wait = min(wait, max(0.0, self._read_s + ESCAPE_S - time.monotonic()))
        ready, _, _ = select.select([self._from, IN], [], [], wait)
        # A key that was pressed before a question could be seen is no answer to it: keys first.
        if IN in ready and not self._read():
            return False
        if self._from in ready:
            data = os.read(self._from, READ_BYTES)
            if not data:
                raise BrokenPipeError
            for message in self._lines.feed(data):
                self._handle_message(message)
        if self._keyboard.waiting and time.monotonic() - self._read_s >= ESCAPE_S:
            self._press(self._keyboard.flush())
        self._seat.look(time.monotonic())
        for line in self._printer.lines(self._talk, self._seat.snapshot, time.monotonic()):
            _write(line + "\n")
        return True

    def _handle_message(self, message: dict[str, Any]) -> None:
        if self._seat.receive(message["kind"], message, time.monotonic()) and self._bell:
            _write("\a")
        self._over = self._over or message["kind"] == "end"

    def _read(self) -> bool:
        """Read typed keys; return False if the terminal was closed or this process is no longer in its foreground."""
        try:
            data = os.read(IN, READ_BYTES)
        except OSError:
            # EIO: this terminal hung up, or it is not its foreground any more.
            data = b""
        if not data:
            self._send("gone", why="the terminal was closed")
            return False
        self._read_s = time.monotonic()
        self._press(self._keyboard.feed(data))
        return True

    def _press(self, keys: list[str]) -> None:
        for key in keys:
            self._echo(key)
            self._seat.key(key, time.monotonic())

    def _echo(self, key: str) -> None:
        # The terminal does not echo keys while the console reads them one by one.
        entry = self._talk.entry
        if entry is None:
            return
        if key == "enter":
            _write("\n")
        elif key == "backspace" and entry.text:
            _write("\b \b")
        elif key == STOP or len(key) == 1:
            _write(" " if key == STOP else key)

    def _send(self, kind: str, **content: Any) -> None:
        # A message is shorter than PIPE_BUF, so the pipe accepts it as a whole.
        os.write(self._to, line_of(kind, **content))


def _write(text: str) -> None:
    with suppress(OSError):
        sys.stdout.write(text)
        sys.stdout.flush()
