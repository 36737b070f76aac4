"""A person at a terminal: the session's side of the console."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, cast

from rig.core.errors import ConfigError, StoppedError
from rig.core.present import plain as plain_of
from rig.realtime.hand import SharedHand
from rig.session.console import terminal
from rig.session.console.child import Child, Message
from rig.session.console.pointer import KEYS, HandKind
from rig.session.desk import Action, Desk, Question, Reply, View
from rig.session.keymap import KeyMap
from rig.session.protocol import VERDICTS, Keys, Protocol
from rig.session.runner import TrialRunner

SILENCE_S = 2.0  # of the console while a hit runs; then the hit ends
HUNG_S = 10.0  # of a console while nothing moves; then it is started anew
START_S = 30.0  # that a console may take to come up on a loaded machine
RESTARTS = 3  # of the console in one session
POLL_S = 0.1
SHORTEST_S = 1e-3  # of a rest that is as good as over
TERMINAL = Path("/dev/tty")
PRESS_N = 4.0  # of a hand whose experiment does not say: that of a normal grip (`rig.core.operators`)
REMEDY = "continue with `rig session resume`; with `plain` it needs next to nothing of the terminal"


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedHand:
    """How the simulated hand is moved at the console: by what, through which file, and how hard it can press (N).

    The file has a directory of its own, which goes with the console.
    """

    kind: HandKind
    path: Path
    press: float


class ConsoleDesk(Desk):
    """A console in the terminal, with what happens when it hangs, dies, or loses its terminal.

    Parameters
    ----------
    keys
        Of the protocol.
    plain
        Lines instead of a picture.
    hand
        The simulated hand that the console moves; None where a participant or a script does.
    place
        The terminal. Where there is none, standard input and output are used as they are, as lines.
    silence_s
        How long the console may be silent while a hit runs (s).
    hung_s
        And while nothing moves.

    Raises
    ------
    ConfigError
        Invalid keys, a hand that this console cannot move, or a terminal that belongs to another job.
    RigError
        The console does not start.
    """

    def __init__(
        self,
        keys: Keys | None = None,
        *,
        plain: bool = False,
        hand: MovedHand | None = None,
        place: Path = TERMINAL,
        silence_s: float = SILENCE_S,
        hung_s: float = HUNG_S,
    ) -> None:
        self._keymap = KeyMap.of(keys or Keys())
        if hand is not None and hand.kind == "keyboard":
            _refuse_keys_of_the_hand(self._keymap)
        self._silence_s, self._hung_s = silence_s, hung_s
        with ExitStack() as opened:
            self._place = _opened(place)
            if self._place >= 0:
                opened.callback(os.close, self._place)
            self._start(plain=plain, hand=hand)
            opened.pop_all()

    def _start(self, *, plain: bool, hand: MovedHand | None) -> None:
        self._before = terminal.attributes(self._place) if self._place >= 0 else None
        self._setup: Message = {
            "pid": os.getpid(),
            "keys": plain_of(self._keymap),
            "plain": plain or self._before is None or os.environ.get("TERM", "dumb") == "dumb",
            "attributes": None if self._before is None else terminal.as_plain(self._before),
            "hand": None if hand is None else {**asdict(hand), "path": str(hand.path)},
        }
        if hand is not None and hand.kind == "mouse" and self._setup["plain"]:
            raise ConfigError(
                "the mouse moves the hand on a full screen alone, and this console prints lines",
                remedy="leave `plain` out, in a terminal that can draw; or take `hand` keyboard",
            )
        self._hand = hand
        self._inbox: SimpleQueue[tuple[Child, Message]] = SimpleQueue()
        self._view: View | None = None
        self._question: Question | None = None
        self._began_s = 0.0
        self._number = 0
        self._restarts = 0
        self._stop_asked = False
        self._closed = False
        self._child = self._started()

    @property
    def pid(self) -> int:
        """Of the console's process."""
        return self._child.pid

    def show(self, view: View) -> None:
        """Show how things stand; returns at once, also when the console hangs."""
        self._view = view
        self._child.say("view", view=plain_of(view))

    def ask(self, question: Question) -> Reply:
        """Ask, and wait for the answer; a console that hangs or died meanwhile is started anew.

        Raises
        ------
        StoppedError
            The terminal is gone, standard input has ended, or the console died too often.
        """
        if (
            question.kind != "rest" or question != self._question
        ):  # a rest continues while somebody writes a note
            self._began_s = time.monotonic()
        self._question = question
        self._number += 1
        self._ask(question)
        while True:
            message = self._next(POLL_S)
            took_s = time.monotonic() - self._began_s
            reply = None if message is None else self._reply(message, question, took_s)
            if reply is not None:
                self._stop_asked = False  # what is stopped from now on is what follows
                if reply.action != "note":
                    self._question = None
                return reply
            self._child.flush()
            if self._child.dead or self._child.silent_s > self._patience_s:
                self._restart()
                self._ask(question)

    def watch(self) -> Callable[[int, int], None] | None:
        """Watch the console while a hit runs: STOP, and a silent console, end it."""
        return self._watch

    def close(self) -> None:
        """Give the terminal back as it was."""
        if not self._closed:
            self._closed = True
            self._child.close()
            if self._place >= 0:
                os.close(self._place)
            if self._hand is not None:
                shutil.rmtree(self._hand.path.parent, ignore_errors=True)

    def _watch(self, ticks: int, phase: int) -> None:
        while (message := self._next(0.0)) is not None:
            self._check_there(message)
        if self._stop_asked:
            raise StoppedError("stopped at the console; the effort is zero")
        if self._child.dead:
            heard_s = self._child.heard_s
            self._restart()
            self._child.heard_s = heard_s  # the hit does not wait for a new one
        limit_s = self._silence_s if self._child.greeted or self._restarts else START_S
        if time.monotonic() - self._child.heard_s > limit_s:
            raise StoppedError(
                f"the console was silent for {limit_s:g} s while a hit ran; the effort is zero",
                remedy=REMEDY,
            )

    @property
    def _patience_s(self) -> float:
        return self._hung_s if self._child.greeted else START_S

    def _ask(self, question: Question) -> None:
        """Send a question; of a rest, what is left of it."""
        seconds = question.seconds
        if seconds:
            seconds = max(SHORTEST_S, seconds - (time.monotonic() - self._began_s))
        asked = replace(question, seconds=seconds)
        self._child.say("ask", number=self._number, question=plain_of(asked))

    def _next(self, patience_s: float) -> Message | None:
        """The next message of the console that is; what an earlier one said is over."""
        try:
            child, message = self._inbox.get(timeout=patience_s) if patience_s else self._inbox.get_nowait()
        except Empty:
            return None
        if child is not self._child:
            return None
        if message["kind"] == "stop":
            self._stop_asked = True
        return message

    def _reply(self, message: Message, question: Question, took_s: float) -> Reply | None:
        """The reply in a message; None when it is not one to this question."""
        self._check_there(message)
        if message["kind"] != "reply" or message.get("number") != self._number:
            return None
        action, value = message.get("action"), str(message.get("value", ""))
        over = action == "go" and question.kind == "rest" and took_s > question.seconds - POLL_S
        if (action not in question.actions and not over) or (action == "judge" and value not in VERDICTS):
            return None
        return Reply(action=cast("Action", action), value=value, took_s=took_s)

    @staticmethod
    def _check_there(message: Message) -> None:
        if message["kind"] == "gone":
            raise StoppedError(str(message.get("why", "the console is gone")), remedy=REMEDY)

    def _started(self) -> Child:
        return Child(self._place, self._before, self._setup, self._inbox)

    def _restart(self) -> None:
        """A new console in the place of one that died or hangs, with what it must know."""
        if not self._child.dead:
            self._child.kill()
        why = self._child.complaint()
        self._child.close(last=self._restarts >= RESTARTS)
        if self._restarts >= RESTARTS:
            raise StoppedError(
                f"the console ended {self._restarts + 1} times" + (f": {why}" if why else ""), remedy=REMEDY
            )
        self._restarts += 1
        self._child = self._started()
        if self._view is not None:
            self._child.say("view", view=plain_of(self._view))


def at_console(
    *, hand: HandKind | None = None, plain: bool = False, place: Path = TERMINAL
) -> Callable[[Protocol, Mapping[str, Any], TrialRunner], Desk]:
    """A console for `rig.session.run.run_session`.

    Parameters
    ----------
    hand
        By what the handle of a simulated rig is moved here; None: its simulated hand plays its script.
    plain, place
        As of `ConsoleDesk`.

    Raises
    ------
    ConfigError
        A hand for a rig that is not simulated.
    """

    def make(protocol: Protocol, experiment: Mapping[str, Any], runner: TrialRunner) -> Desk:
        moved: MovedHand | None = None
        if hand is not None and not runner.simulated:
            raise ConfigError(
                f"`hand` {hand} moves a simulated rig, and this one is real",
                remedy="leave it out, or `url`",
            )
        with ExitStack() as made:
            if hand is not None:
                directory = Path(tempfile.mkdtemp(prefix="rig-hand-"))
                made.callback(shutil.rmtree, directory, ignore_errors=True)
                path = directory / "hand"
                SharedHand.create(path).close()  # before a device looks for it
                press = experiment.get("operator", {}).get("press", PRESS_N)
                moved = MovedHand(kind=hand, path=path, press=float(press))
            desk = ConsoleDesk(protocol.keys, plain=plain, hand=moved, place=place)
            made.pop_all()
        runner.hand = runner.hand if moved is None else moved.path
        return desk

    return make


def _refuse_keys_of_the_hand(keymap: KeyMap) -> None:
    for meaning, key in keymap.keys.items():
        if key in KEYS:
            raise ConfigError(
                f"[keys] {meaning} = {key!r}: that key moves the hand",
                remedy="give another key, or leave `hand` keyboard out",
            )


def _opened(place: Path) -> int:
    """A descriptor of the terminal, or -1 where there is none.

    Raises `ConfigError` when it is another job's now: who reads from it then is stopped by the kernel.
    """
    try:
        descriptor = os.open(place, os.O_RDWR | os.O_NOCTTY | os.O_CLOEXEC)
    except OSError:
        return -1
    try:
        ours = os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:
        ours = True  # nobody's controlling terminal has no foreground
    if not ours:
        os.close(descriptor)
        raise ConfigError("the session runs in the background, where nobody can answer", remedy="fg")
    return descriptor
