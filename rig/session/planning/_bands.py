"""Check that impact speed and press of a hit lie within the protocol's required ranges, and adjust a simulated hand.

The impact speed is the speed of the handle at the first contact (`rig.control.verdict`). The press is the mean effort
with which the wall pushed the hand outwards in the last part of the hit (`verdict.tail_s`), for any control law. Trials
of a session and checks of a protocol use it. It must not run a trial.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from rig import config
from rig.config import Experiment
from rig.control.verdict import Kind
from rig.core.sample import Motion, Phase, unit_of
from rig.recording.data import Recording
from rig.session.planning._protocol import Band, Trial
from rig.session.planning._reasons import explain_outside
from rig.session.planning._trial import HitOutcome

# For each key of the protocol: the physical quantity, the key of the value in `HitOutcome.numbers`, the printed name.
BANDS: Mapping[str, tuple[str, str, str]] = {
    "impact_speed": ("velocity", "impact_velocity", "impact speed"),
    "press": ("effort", "press", "press"),
}


def describe_task(trial: Trial, motion: Motion) -> str:
    """Return the ranges of impact speed and press that ``[trial]`` requires, as text with units; "" without any."""
    return ", ".join(
        f"{words} {_words(band)} {unit_of(quantity, motion)}"
        for name, (quantity, _, words) in BANDS.items()
        if (band := getattr(trial, name))
    )


def press_of(recording: Recording, experiment: Experiment) -> float | None:
    """Return the press of a hit (N·m or N); None if the recording has no trial phase.

    The press is the mean effort with which the wall pushed the hand outwards in the last part of the hit.
    """
    rows = recording.rows
    effort = rows["effort_sent"][rows["phase"] == Phase.TRIAL]
    tail = effort[-round(experiment.verdict.tail_s * experiment.controller.position_rate) :]
    return -experiment.wall.side * float(tail.mean()) if len(tail) else None


def judge_bands(hit: HitOutcome, trial: Trial, motion: Motion) -> HitOutcome:
    """Return the hit with a text for each missed range (impact speed, press).

    If ``[trial]`` requires the ranges, a hit outside of them is marked invalid, so that it is repeated.
    """
    found = () if hit.automatic == Kind.INVALID else tuple(_outside(hit, trial, motion))
    if not found or trial.outside == "keep":
        return replace(hit, outside=found)
    return replace(
        hit, outside=found, automatic=str(Kind.INVALID), reasons=found, passes=dict.fromkeys(hit.passes)
    )


def _outside(hit: HitOutcome, trial: Trial, motion: Motion) -> Iterator[str]:
    for name, (quantity, number, _) in BANDS.items():
        band, value = getattr(trial, name), hit.numbers.get(number)
        # In an unstable wall the effort comes from the wall and not from the hand: to judge the press there would
        # discard unstable walls. The impact speed, which no wall affects, is always judged.
        if not band or value is None or (name == "press" and hit.automatic == Kind.UNSTABLE):
            continue
        value = abs(value)
        if not band[0] <= value <= band[-1]:
            yield explain_outside(
                name, value, _words(band), unit_of(quantity, motion), above=value > band[-1]
            )


def _words(band: Band) -> str:
    return " to ".join(f"{end:g}" for end in band)


def pressing(experiment: Experiment, trial: Trial) -> dict[str, float]:
    """Return ``operator.press`` of a simulated hand for the middle of the required range; {} without a range."""
    return (
        {"operator.press": max(0.0, config.press_for(experiment, middle(trial.press)))} if trial.press else {}
    )


def middle(band: Band) -> float:
    """Return the middle of a range (lowest and highest value), at which a simulated hand aims."""
    return 0.5 * (band[0] + band[-1])
