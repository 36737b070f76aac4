"""The session's side of the operator's console at a terminal; the console itself is a child process.

`rig session run` uses this module. It must not decide about trials or write to the session's directory;
`rig.session.engine` does that.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Literal

from rig.core.errors import ConfigError, StoppedError
from rig.core.present import plain as plain_of
from rig.core.scratch import scratch
from rig.realtime.hand import SharedHand
from rig.session.engine._desk import Desk
from rig.session.planning._protocol import Keys, Protocol
from rig.session.terminal import _terminal as terminal
from rig.session.terminal._asking import SILENCE_S, AskingDesk
from rig.session.terminal._seat import full_press, keymap_for, refuse_a_hand

# Only for types: a console that restarts within a hit must start fast, without the control loop.
if TYPE_CHECKING:
    from rig.session.engine._runner import TrialRunner

if sys.platform != "win32":
    import termios

    from rig.session.terminal._child import Child, Message

assert sys.platform != "win32"

HUNG_S = 10.0  # longest silence of a console while nothing moves; after it the console is restarted
START_S = 30.0  # longest start of a console, on a loaded machine
RESTARTS = 3  # of the console in one session
TERMINAL = Path("/dev/tty")
REMEDY = "continue with `rig session resume`"


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedHand:
    """Simulated hand that arrow keys move at the console: file for its target position, and force of a full press (N).

    The file is in a temporary directory, which `close` removes.
    """

    path: Path
    press: float
    close: Callable[[], None] = lambda: None


class ConsoleDesk(AskingDesk):
    """Operator's user interface in a terminal, with a console process that is restarted if it hangs or dies.

    Parameters
    ----------
    keys
        Section ``[keys]`` of the protocol.
    hand
        Simulated hand that arrow keys move; None if it hits by itself or a participant moves the handle.
    place
        Path of the terminal.
    silence_s
        Longest time without a message from the console during a hit (s); after this time the hit ends.
    hung_s
        Longest time without a message while nothing moves (s); after this time the console is restarted.

    Raises
    ------
    ConfigError
        Keys are not valid, or the terminal is missing or belongs to another job of the shell.
    RigError
        The console does not start.
    """

    def __init__(
        self,
        keys: Keys | None = None,
        *,
        hand: MovedHand | None = None,
        place: Path = TERMINAL,
        silence_s: float = SILENCE_S,
        hung_s: float = HUNG_S,
    ) -> None:
        super().__init__()
        self._keymap = keymap_for(keys or Keys(), None if hand is None else "keyboard")
        self._silence_s, self._hung_s = silence_s, hung_s
        with ExitStack() as opened:
            self._place, self._before = _open_terminal(place)
            opened.callback(os.close, self._place)
            self._start(hand)
            opened.pop_all()

    def _start(self, hand: MovedHand | None) -> None:
        self._setup: Message = {
            "pid": os.getpid(),
            "keys": plain_of(self._keymap),
            "attributes": terminal.as_plain(self._before),
            "hand": None if hand is None else {"path": str(hand.path), "press": hand.press},
        }
        self._hand = hand
        self._inbox: SimpleQueue[tuple[Child, Message]] = SimpleQueue()
        self._restarts = 0
        self._closed = False
        self._child = self._start_child()

    @property
    def pid(self) -> int:
        """Process ID of the operator's console."""
        return self._child.pid

    def close(self) -> None:
        """End the process of the operator's console and restore the terminal's settings."""
        if not self._closed:
            self._closed = True
            self._child.close()
            os.close(self._place)
            if self._hand is not None:
                self._hand.close()

    def _send(self, kind: str, **content: Any) -> None:
        self._child.say(kind, **content)

    def _take(self, patience_s: float) -> Message | None:
        try:
            child, message = self._inbox.get(timeout=patience_s) if patience_s else self._inbox.get_nowait()
        except Empty:
            return None
        if child is not self._child:
            return None
        if message["kind"] == "gone":
            raise StoppedError(
                str(message.get("why", "the connection to the console was lost")), remedy=REMEDY
            )
        return message

    def _check_there(self) -> None:
        if self._child.dead:
            heard_s = self._child.heard_s
            self._restart()
            # The new console has not shown the hit yet: its start must not extend the allowed silence.
            self._child.heard_s = heard_s
        limit_s = self._silence_s if self._child.greeted or self._restarts else START_S
        if time.monotonic() - self._child.heard_s > limit_s:
            raise StoppedError(
                f"no message from the console for {limit_s:g} s during a hit; the effort is zero",
                remedy=REMEDY,
            )

    def _is_renewed(self) -> bool:
        """Restart the operator's console if it died or hangs; return True if it was restarted."""
        self._child.flush()
        renewed = self._child.dead or self._child.silent_s > (
            self._hung_s if self._child.greeted else START_S
        )
        if renewed:
            self._restart()
        return renewed

    def _start_child(self) -> Child:
        return Child(self._place, self._before, self._setup, self._inbox)

    def _restart(self) -> None:
        if not self._child.dead:
            self._child.kill()
        why = self._child.complaint()
        self._child.close(last=self._restarts >= RESTARTS)
        if self._restarts >= RESTARTS:
            raise StoppedError(
                f"the console has failed {self._restarts + 1} times" + (f": {why}" if why else ""),
                remedy=REMEDY,
            )
        self._restarts += 1
        self._child = self._start_child()
        if self._view is not None:
            self._child.say("view", view=plain_of(self._view))


def at_console(
    *, hand: Literal["keyboard"] | None = None, place: Path = TERMINAL
) -> Callable[[Protocol, Mapping[str, Any], TrialRunner], Desk]:
    """Return a function that makes the operator's user interface in a terminal, as `run_session` needs it.

    Parameters
    ----------
    hand
        Input device that moves the hand of a simulated rig; None if the hand hits by itself. For a real rig the
        returned function raises `ConfigError` if `hand` is given.
    place
        Path of the terminal.
    """

    def make(protocol: Protocol, experiment: Mapping[str, Any], runner: TrialRunner) -> Desk:
        moved: MovedHand | None = None
        refuse_a_hand(hand, runner)
        with ExitStack() as made:
            if hand is not None:
                kept = made.enter_context(ExitStack())
                path = kept.enter_context(scratch("hand")) / "hand"
                # The file must exist before the simulated device opens it.
                SharedHand.create(path).close()
                moved = MovedHand(path=path, press=full_press(experiment), close=kept.close)
            desk = ConsoleDesk(protocol.keys, hand=moved, place=place)
            made.pop_all()
        runner.hand = runner.hand if moved is None else moved.path
        return desk

    return make


def _open_terminal(place: Path) -> tuple[int, list[Any]]:
    """Open the terminal and return its descriptor and settings; raise `ConfigError` if another job uses it."""
    with ExitStack() as opened:
        try:
            descriptor = os.open(place, os.O_RDWR | os.O_NOCTTY)
            opened.callback(os.close, descriptor)
            before = termios.tcgetattr(descriptor)
        except (OSError, termios.error) as error:
            raise ConfigError(
                f"a session with a person needs a terminal for the operator ({place}: {error.args[-1]})",
                remedy="run the session in a terminal or in a browser (`rig console`), or rehearse it: --rehearse",
            ) from error
        try:
            ours = os.tcgetpgrp(descriptor) == os.getpgrp()
        except OSError:
            # A terminal that is not the controlling terminal of a session has no foreground process group.
            ours = True
        if not ours:
            raise ConfigError(
                "the session is a background job of the shell, which cannot read keys",
                remedy="bring it to the foreground with: fg",
            )
        opened.pop_all()
    return descriptor, before
