"""Judge whether impact speed and press of a hit lie in the bands of a protocol, and set those of a simulated hand.

The impact speed is that of the handle at the first contact (`rig.control.verdict`). The press is the mean effort that
pushed the hand out of the wall over the judged tail (`verdict.tail_s`), whatever the law of the wall.
"""

from __future__ import annotations

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

# Key of the protocol: the quantity that it is of, its number in a hit's, and what it is called.
BANDS: Mapping[str, tuple[str, str, str]] = {
    "impact_speed": ("velocity", "impact_velocity", "impact speed"),
    "press": ("effort", "press", "press"),
}


def describe_task(trial: Trial, motion: Motion) -> str:
    """Return the required ranges of impact speed and press as text; empty if the protocol requires none."""
    return ", ".join(
        f"{words} {_words(band)} {unit_of(quantity, motion)}"
        for name, (quantity, _, words) in BANDS.items()
        if (band := getattr(trial, name))
    )


def press_of(recording: Recording, experiment: Experiment) -> float | None:
    """Return the press of a hit (N·m or N); None if the recording has no trial phase."""
    rows = recording.rows
    effort = rows["effort_sent"][rows["phase"] == Phase.TRIAL]
    tail = effort[-round(experiment.verdict.tail_s * experiment.controller.position_rate) :]
    return -experiment.wall.side * float(tail.mean()) if len(tail) else None


def judge_bands(hit: HitOutcome, trial: Trial, motion: Motion) -> HitOutcome:
    """Return the hit with its deviations from the bands; also mark it invalid if the protocol requires that."""
    found = () if hit.automatic == Kind.INVALID else tuple(_outside(hit, trial, motion))
    if not found or trial.outside == "keep":
        return replace(hit, outside=found)
    return replace(
        hit,
        outside=found,
        automatic=str(Kind.INVALID),
        reasons=found,
        passes=dict.fromkeys(hit.passes),
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


def pressing(x: Experiment, trial: Trial) -> dict[str, float]:
    """Return the settings of an experiment that make the simulated hand press with the middle of the band."""
    return {"operator.press": max(0.0, config.press_for(x, middle(trial.press)))} if trial.press else {}


def middle(band: Band) -> float:
    """Return the middle of a band, at which a simulated hand aims."""
    return 0.5 * (band[0] + band[-1])
