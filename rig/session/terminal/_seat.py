"""Connect an operator to a session: process messages and keys, and move the simulated hand.

A terminal (`rig.session.terminal._program`) and a page in the browser (`rig.extras.console.sessions`) pass messages and
keys to a `Seat`, and display its state. It must not read the properties of a wall, because the operator may be blinded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from rig.core.errors import ConfigError
from rig.realtime import running
from rig.session.planning._keymap import KeyMap
from rig.session.terminal._conversation import Conversation, Decision, StopPressed
from rig.session.terminal._live import LiveLoop, Snapshot
from rig.session.terminal._pointer import KEYS, START_SHARE, HandKind, Pointer, PointerTarget

# Only for types: a console that restarts within a hit must start fast, without the control loop.
if TYPE_CHECKING:
    from rig.session.engine._runner import TrialRunner
    from rig.session.planning._protocol import Keys

PRESS_N = 4.0  # full press if the experiment gives none: the force of a normal grip (`rig.core.operators`)


class SeatHand:
    """Simulated hand that the operator moves by an input device (`kind`): "mouse" or "keyboard".

    `press` is the force of a full press (N), `hand` the receiver of the hand's target position and press.
    """

    def __init__(self, kind: HandKind, press: float, hand: PointerTarget) -> None:
        self.kind = kind
        self.pointer = Pointer(press)
        self._hand = hand

    def key(self, name: str) -> bool:
        """Move the simulated hand and return True if `name` is a key that moves it; return False for any other key."""
        return self.kind == "keyboard" and self.pointer.key(name)

    def begin(self) -> None:
        """Move the simulated hand back to the start position before a trial, if arrow keys move it."""
        if self.kind == "keyboard":
            # Keys that led into the last wall would touch the next one in free space.
            self.pointer.point(START_SHARE, held=False)

    def hold(self) -> None:
        """Send target position and press again, because a simulated hand without new messages rests."""
        intention = self.pointer.intention
        if intention is not None:
            self._hand.move(*intention)

    def close(self) -> None:
        """Release the simulated hand, which then rests."""
        self._hand.close()


class Seat:
    """The operator's side of a session: it receives the session's messages, processes keys, and sends replies.

    `setup` is the content of the session's first message (process ID and keys), `say` a function that sends a message
    to the session, and `hand` the simulated hand that the operator moves, or None.

    Attributes
    ----------
    talk
        State of the operator's user interface.
    snapshot
        Current values of the running trial; None if no control loop runs.
    number
        Number of the open question, or of the last question.
    """

    def __init__(
        self, setup: Mapping[str, Any], say: Callable[..., None], hand: SeatHand | None = None
    ) -> None:
        self._pid = int(setup["pid"])
        self._say = say
        self.hand = hand
        self.talk = Conversation(KeyMap.from_mapping(setup["keys"]), None if hand is None else hand.kind)
        self.live = LiveLoop(self._pid)
        self.snapshot: Snapshot | None = None
        self.number = 0

    def receive(self, kind: str, message: Mapping[str, Any], now_s: float) -> bool:
        """Process a message from the session at the time `now_s` (s); return True if the bell should ring."""
        if kind == "view":
            before = self.talk.view.state
            self.talk.see(message["view"])
            if self.hand is not None:
                self.hand.pointer.scale(self.talk.view.scale)
            return self.talk.view.state != before and self.talk.view.state == "go"
        if kind != "ask":
            return False
        self.number = message["number"]
        ready = bool(message["question"]["kind"] == "ready")
        answered = self.talk.ask(message["question"], now_s)
        if ready and self.hand is not None:
            self.hand.begin()
        self.do(answered)
        return ready

    def key(self, name: str, now_s: float, shown_s: float | None = None) -> None:
        """Process a key that arrived at `now_s` (s).

        `shown_s` is the time between the display of the question and the key (s), if known.
        """
        if self.hand is None or self.talk.entry is not None or not self.hand.key(name):
            self.do(self.talk.press(name, now_s), shown_s)

    def look(self, now_s: float) -> None:
        """Read the values of the running control loop, and end a rest whose time is over at `now_s` (s)."""
        self.do(self.talk.pass_time(now_s))
        self.snapshot = self.live.look()
        self.talk.live = self.snapshot is not None
        if self.hand is not None:
            self.hand.hold()

    def do(self, outcomes: list[Decision], shown_s: float | None = None) -> None:
        """Execute decisions of the operator: stop the rig, or send a reply to the session.

        `shown_s` is the time since the question was displayed (s), if known.
        """
        for outcome in outcomes:
            if isinstance(outcome, StopPressed):
                # First of all, because sending the message below may take time.
                running.ask_to_stop(self._pid)
                if self.talk.moving:
                    self._say("stop")
            else:
                known = {} if shown_s is None else {"shown_s": shown_s}
                self._say("reply", number=self.number, action=outcome.action, value=outcome.value, **known)


def full_press(experiment: Mapping[str, Any]) -> float:
    """Return the force (N) with which an experiment's simulated hand presses, or a default."""
    return float(experiment.get("operator", {}).get("press", PRESS_N))


def keymap_for(keys: Keys, hand: HandKind | None) -> KeyMap:
    """Return the key map for ``[keys]``; raise `ConfigError` for an invalid key or one that moves the hand."""
    keymap = KeyMap.of(keys)
    for meaning, key in keymap.keys.items() if hand == "keyboard" else ():
        if key in KEYS:
            raise ConfigError(
                f"[keys] {meaning} = {key!r}: this key already moves the simulated hand",
                remedy="choose another key in the protocol, or do not move the hand with the keyboard (`hand`)",
            )
    return keymap


def refuse_a_hand(hand: HandKind | None, runner: TrialRunner) -> None:
    """Raise `ConfigError` if a simulated hand (`hand` not None) is requested on a real rig."""
    if hand is not None and not runner.simulated:
        raise ConfigError(
            f"`hand` {hand} moves a simulated hand and needs a simulated rig, but `url` names a real rig",
            remedy="omit `hand`, or omit `url`",
        )
