"""Why a trial is invalid, in words for a blinded operator: what to do differently, and nothing of the wall.

The log has the reasons as `rig.control.verdict` and `rig.experiments.trials.judgement` wrote them. Saturation of the
motor or of the slew limit reveals effort, which over the penetration is stiffness: a blinded operator reads of a rig
limit. A settling time, a calm wall, a number of ticks (the rate) reveal wall or condition too. Reasons that are not
listed here are hidden.
"""

from __future__ import annotations

from collections.abc import Iterable

RIG_LIMIT = "rig limit"
HIDDEN = "for a reason that is hidden from a blinded operator"
AS_IT_IS = ""
# Beginning of a reason: what a blinded operator reads.
_ADVICE = {
    "from contact on, ": AS_IT_IS,  # samples lost, late ticks
    "the wall was never touched": AS_IT_IS,
    "the wall was touched at ": AS_IT_IS,  # in the baseline, in older logs
    "a false start": AS_IT_IS,
    "the run ended early: ": AS_IT_IS,
    "the first contact lies in the tail": "the wall was touched too late",
    "the wall was not touched in the tail": "the handle was outside the wall at the end: ask to stay inside it",
    "the hand left ": "the hand left the wall before the end and did not come back: ask to stay inside it",
    "only ": "the trial was too short",
    "still settling ": "the trial was too short to judge: increase trial.duration_s",
    "the device overruled the law ": "the device overruled the law",
    "hit too ": AS_IT_IS,
    "pressed too lightly: ": "pressed too lightly: ask to press harder",  # in numbers it would be effort
    "pressed too hard: ": "pressed too hard: ask to press less",
    "the measured current ": "the motor's current differs from its set-point: check delay, leads, amplifier, sensor",
    "saturated ": RIG_LIMIT,
    "the slew limit ": RIG_LIMIT,
}
# Of a band: what is too little, and what too much.
_OUTSIDE = {
    "impact_speed": ("hit too slowly", "hit too fast"),
    "press": ("pressed too lightly", "pressed too hard"),
}


def explain_outside(name: str, value: float, band: str, unit: str, *, above: bool) -> str:
    """Why a trial lies outside a band of the protocol (`rig.session.planning._bands`)."""
    return f"{_OUTSIDE[name][above]}: {value:.3g} {unit} (required: {band} {unit})"


def summarise_reasons(reasons: Iterable[str], *, blind: bool) -> str:
    """The reasons of an invalid trial in one line: as they are, or as a blinded operator may read them."""
    return "; ".join(dict.fromkeys(_hide(one) if blind else one for one in reasons))


def _hide(reason: str) -> str:
    found = next((advice for start, advice in _ADVICE.items() if reason.startswith(start)), HIDDEN)
    return reason if found is AS_IT_IS else found
