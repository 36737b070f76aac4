"""Texts of the operator's user interface, for the terminal and the page in the browser.

Texts for a participant are in `_participant`. They must not contain a wall that the view does not contain.
"""

from dataclasses import dataclass

from rig.session.engine._desk import Action, DeskView
from rig.session.terminal._conversation import TWICE, Conversation
from rig.session.terminal._live import Snapshot
from rig.session.terminal._pointer import CLOSE, HandKind

HALF, NEAR = 0.4, 0.8  # fractions of the limit from which an effort is called "half", and "near the limit"
LOW = 0.1  # length of the bar of an effort that is called "low"
GAUGES = ("phase", "depth", "velocity", "effort", "round trip", "late, lost")
MEANINGS: dict[str, str] = {
    "go": "continue (also enter)",
    "redo": "discard the last trial and repeat it",
    "pause": "pause before the next trial",
    "note": "write a note into the log",
    "skip": "end this run (search) without a limit (asks for confirmation)",
    "abort": "leave the session; it can be resumed (asks for confirmation)",
}
HANDS: dict[HandKind, list[tuple[str, str]]] = {
    "keyboard": [
        ("right, left", "one step towards the wall, or back; inside the wall each step presses harder"),
        ("up, down", f"{CLOSE} steps at once"),
        ("end, home", "into the wall and full press, or back behind the start"),
    ],
    "mouse": [
        (
            "mouse",
            "to the right: towards the wall; inside the wall the hand presses harder the further you move",
        ),
        ("button", "while held: full press"),
    ],
}
ORDER: tuple[Action, ...] = ("go", "redo", "pause", "note", "skip", "abort")


@dataclass(frozen=True, slots=True)
class Gauge:
    """Line of the panel with live values: name, text, and length of its bar (`share`, 0 … 1; None for no bar)."""

    name: str
    share: float | None
    text: str


def place(view: DeskView) -> str:
    """Return participant's code, block, search and trial number as one line; unknown ones are left out."""
    parts = [view.code] if view.code else []
    if view.practice:
        parts.append("practice")
    elif view.block:
        parts.append(f"block {view.block}" + (f" of {view.blocks}" if view.blocks else ""))
    if view.run:
        parts.append(f"run {view.run}" + (f" of {view.runs}" if view.runs else ""))
    if view.trial:
        parts.append(f"trial {view.trial}" + (f" of about {view.trials}" if view.trials else ""))
    return " · ".join(parts)


def state(talk: Conversation) -> str:
    """Return the state of the session as text, with the operator's request for the next question, if any."""
    waits = "" if talk.later is None else f" ({talk.later} next)"
    return talk.view.state + waits


def facts(view: DeskView) -> list[tuple[str, str]]:
    """Return pairs of label and text about the current trial, such as condition, wall and motor heat."""
    wall = "hidden"
    if view.stiffness is not None:
        wall = f"K = {view.stiffness:g}" + ("" if view.damping is None else f", B = {view.damping:g}")
    return [
        ("state", view.state),
        ("condition", "hidden" if view.condition is None else view.condition),
        ("wall", wall),
        ("counts", "no (practice)" if view.practice else "yes"),
        ("attempt", str(view.attempt)),
        *([("asked", view.asked)] if view.asked else []),
        ("motor heat", f"{100 * view.heat:.0f} % of budget"),
    ]


def gauges(view: DeskView, live: Snapshot | None) -> list[Gauge]:
    """Return the lines of the panel with live values; without a running control loop they contain dashes."""
    if live is None:
        return [Gauge(name, None, "-") for name in GAUGES]
    scale = view.scale
    way = abs(float(scale.get("wall", 0.0)) - float(scale.get("start", 0.0))) or 1.0
    speed = abs(float(scale.get("speed_limit") or 0.0)) or 1.0
    position_unit, velocity_unit = scale.get("position_unit", ""), scale.get("velocity_unit", "")
    trip = "-" if live.round_trip_ns is None else f"{live.round_trip_ns * 1e-6:.2f} ms"
    values = (
        (None, live.phase),
        (live.penetration / way, f"{live.penetration:+.4f} {position_unit}"),
        (abs(live.velocity) / speed, f"{live.velocity:+.3f} {velocity_unit}"),
        _effort(view, live),
        (None, trip),
        (None, f"{live.late}, {live.lost}" + (f" ({live.skipped} skipped)" if live.skipped else "")),
    )
    return [Gauge(name, share, text) for name, (share, text) in zip(GAUGES, values, strict=True)]


def _effort(view: DeskView, live: Snapshot) -> tuple[float, str]:
    """Return length of the bar and text of the effort (N·m or N): a number, or a word if the operator is blinded."""
    limit = abs(float(view.scale.get("effort_limit") or 0.0))
    share = live.peak_effort / limit if limit else 0.0
    # Where the operator must be blind to the wall, an effort is a word: as a number, next to the penetration, it would
    # reveal the stiffness.
    if not view.blinded:
        text = f"{live.effort:+.3f} {view.scale.get('effort_unit', '')}"
        return share, text + (", saturated" if live.saturated else "")
    if live.saturated:
        return 1.0, "saturated"
    if share >= NEAR:
        return NEAR, "near the limit"
    if share >= HALF:
        return HALF, "half"
    return LOW, "low"


def question(talk: Conversation, now_s: float) -> str:
    """Return the text of the open question; without a question, a text that the operator must wait.

    `now_s` is the time on the caller's clock (s), for the remaining time of a rest.
    """
    if talk.twice is not None:
        return f"{TWICE[talk.twice]}?"
    asked = talk.question
    if asked is None:
        return "the rig is moving; SPACE stops it" if talk.live else "please wait"
    left = talk.left_s(now_s)
    text = asked.text
    item = asked.item or {}
    if asked.kind == "item" and item.get("text") and item["text"] not in text:
        text = f"{text} {item['text']}".strip()
    if asked.kind == "item" and item.get("kind") == "choice":
        choices = enumerate(item.get("choices", ()), 1)
        text += "  " + "  ".join(f"{n} {choice}" for n, choice in choices)
    if asked.kind == "item" and item.get("kind") == "scale":
        text += f"  ({item['lowest']} to {item['highest']})"
    return text + (f"  ({left:.0f} s left)" if asked.kind == "rest" and asked.seconds else "")


def list_offered(talk: Conversation) -> list[tuple[str, str]]:
    """Return the keys that answer the open question, each with its meaning."""
    keymap, allowed = talk.keymap, talk.allowed
    if talk.twice is not None:
        return [("y", "yes"), ("escape", "no")]
    found = list(keymap.verdicts) if "judge" in allowed else []
    if talk.question is not None and talk.question.kind == "item":
        found.append(("enter", "answer"))
    return found + [(keymap.key_of(action), action) for action in ORDER if action in allowed]


def choices(talk: Conversation) -> str:
    """Return one line with the keys that answer the open question."""
    if talk.twice is not None:
        return f"[y] yes, or {talk.keymap.key_of(talk.twice)} again; any other key: no"
    return "  ".join(f"[{key}] {text}" for key, text in list_offered(talk))


def always(talk: Conversation) -> str:
    """Return the text about the keys that the operator can press at any time."""
    return "\n".join(filter(None, [hand(talk), "[SPACE] STOP  [?] keys  [^C] stop and leave"]))


def hand(talk: Conversation) -> str:
    """Return a text about how to move the simulated hand; "" if the operator does not move it."""
    if talk.hand is None:
        return ""
    if talk.hand == "mouse":
        return "hand: mouse to the right  [button] full press"
    return "hand: [left] [right] a step  [down] [up] more  [home] back  [end] into the wall"


def help_pairs(talk: Conversation, *, interrupts: bool = True) -> list[tuple[str, str]]:
    """Return all keys with their effects; with `interrupts`, also keys by which a terminal sends signals (^C)."""
    keymap = talk.keymap
    return [
        ("SPACE", "STOP: zero effort now"),
        *((key, f"verdict: {verdict}") for key, verdict in keymap.verdicts),
        *((keymap.key_of(action), MEANINGS[action]) for action in ORDER),
        *([("^C", "stop, and leave the session; works also when this console hangs")] if interrupts else []),
        *(HANDS[talk.hand] if talk.hand else []),
        ("?, enter, escape", "close this list; any other key acts as listed"),
    ]
