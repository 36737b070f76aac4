"""Explain to a blinded operator why a trial is invalid and what to change, without information about the wall.

Log lines, pauses and questions of a session use these texts. A reason that is not listed here is never shown.
"""

from collections.abc import Iterable

from rig.control.verdict import Opening

RIG_LIMIT = "rig limit"
HIDDEN = "for a reason that is hidden from a blinded operator"
AS_IT_IS = ""
# Text that a blinded operator reads for each reason. A settling time, a calm wall and a number of ticks (the rate)
# would reveal wall or condition.
_ADVICE = {
    Opening.LOST_OR_LATE: AS_IT_IS,
    Opening.NEVER_TOUCHED: AS_IT_IS,
    Opening.TOUCHED_EARLY: AS_IT_IS,
    Opening.FALSE_START: AS_IT_IS,
    Opening.ENDED_EARLY: AS_IT_IS,
    Opening.TOUCHED_LATE: "the wall was touched too late",
    Opening.GONE: "the handle was outside the wall at the end: ask to stay inside it",
    Opening.LEFT: "the hand left the wall before the end and did not come back: ask to stay inside it",
    Opening.TOO_SHORT: "the trial was too short",
    Opening.STILL_SETTLING: "the trial was too short to judge: increase trial.duration_s",
    Opening.OVERRULED: "the device overruled the law",
    Opening.HIT_WRONGLY: AS_IT_IS,
    # The number of newtons would reveal the effort.
    Opening.PRESSED_LIGHTLY: "pressed too lightly: ask to press harder",
    Opening.PRESSED_HARD: "pressed too hard: ask to press less",
    Opening.CURRENT: "the motor's current differs from its set-point: check delay, leads, amplifier, sensor",
    # Saturation of motor or slew limit reveals effort, which over the penetration is stiffness.
    Opening.IDLE_SATURATION: RIG_LIMIT,
    Opening.SLEW_BOUND: RIG_LIMIT,
}
# Beginning of the text for a value below and above a band.
_OUTSIDE = {
    "impact_speed": (f"{Opening.HIT_WRONGLY}slowly: ", f"{Opening.HIT_WRONGLY}fast: "),
    "press": (Opening.PRESSED_LIGHTLY, Opening.PRESSED_HARD),
}


def explain_outside(name: str, value: float, band: str, unit: str, *, above: bool) -> str:
    """Return a text: impact speed or press of a trial (`name`) was below, or `above`, its required range `band`."""
    return f"{_OUTSIDE[name][above]}{value:.3g} {unit} (required: {band} {unit})"


def summarise_reasons(reasons: Iterable[str], *, blind: bool) -> str:
    """Return the reasons of an invalid trial in one line, without information about the wall if `blind` is True."""
    return "; ".join(dict.fromkeys(_hide(one) if blind else one for one in reasons))


def _hide(reason: str) -> str:
    found = next((advice for opening, advice in _ADVICE.items() if reason.startswith(opening)), HIDDEN)
    return reason if found is AS_IT_IS else found
