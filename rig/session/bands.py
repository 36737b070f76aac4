"""Bands of impact speed and press: what a protocol asks of a hand, what it did, and what a simulated one is told.

The impact speed is that of the handle at the first contact (`rig.control.verdict`). The press is the mean effort that
pushed the hand out of the wall over the judged tail (`verdict.tail_s`): what the hand pressed with, less the rig's
friction, whatever the law of the wall.

In an unstable wall the effort is the wall's own, and tells nothing of the hand: the press is not judged there, for to
repeat such trials would throw unstable walls away. The impact speed, which no wall has part in, always is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from statistics import fmean

from rig import config
from rig.config import Experiment
from rig.control.verdict import Kind
from rig.core.sample import Motion, Phase, unit_of
from rig.experiments.hit_simulator import HitSimulator
from rig.recording.data import Recording
from rig.session.protocol import Band, Trial
from rig.session.reasons import outside
from rig.session.trial import Hit

# Key of the protocol: the quantity that it is of, its number in a hit's, and what it is called.
BANDS: Mapping[str, tuple[str, str, str]] = {
    "impact_speed": ("velocity", "impact_velocity", "impact speed"),
    "press": ("effort", "press", "press"),
}
QUICKEST_S = 0.05  # chosen: no hand reaches faster
TOUCH_S = 0.01  # after the contact: nothing more is needed for a speed
HITS = 3  # simulated, each with another tremor and start
HALVINGS = 8  # of the durations of a reach: to 2 % from `QUICKEST_S` to some seconds


def asked(trial: Trial, motion: Motion) -> str:
    """What a protocol asks of the hand, in words; empty for nothing."""
    return ", ".join(
        f"{words} {_words(band)} {unit_of(quantity, motion)}"
        for name, (quantity, _, words) in BANDS.items()
        if (band := getattr(trial, name))
    )


def press_of(recording: Recording, experiment: Experiment) -> float | None:
    """Press of a hit (N·m or N); None of one without a trial."""
    rows = recording.rows
    effort = rows["effort_sent"][rows["phase"] == Phase.TRIAL]
    tail = effort[-round(experiment.verdict.tail_s * experiment.controller.position_rate) :]
    return -experiment.wall.side * float(tail.mean()) if len(tail) else None


def judged(hit: Hit, trial: Trial, motion: Motion) -> Hit:
    """The hit with what of it lies outside the bands, and invalid because of that where the protocol says so."""
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


def _outside(hit: Hit, trial: Trial, motion: Motion) -> Iterator[str]:
    for name, (quantity, number, _) in BANDS.items():
        band, value = getattr(trial, name), hit.numbers.get(number)
        if not band or value is None or (name == "press" and hit.automatic == Kind.UNSTABLE):
            continue
        value = abs(value)
        if not band[0] <= value <= band[-1]:
            yield outside(name, value, _words(band), unit_of(quantity, motion), above=value > band[-1])


def _words(band: Band) -> str:
    return " to ".join(f"{end:g}" for end in band)


def pressing(x: Experiment, trial: Trial) -> dict[str, float]:
    """What a simulated hand is told of the press, as keys of the experiment of a wall: the middle of the band."""
    return {"operator.press": max(0.0, config.press_for(x, _middle(trial.press)))} if trial.press else {}


def reach_for(x: Experiment, trial: Trial) -> float:
    """Duration of the reach (s) with which a simulated hand hits nearest to the middle of the band.

    It is found by simulated hits, within what the trial has room for.
    """
    room = x.trial.duration_s - (0.0 if x.trial.hold_s else x.verdict.tail_s) - x.operator.begin_s
    quick, slow = math.log(QUICKEST_S), math.log(max(QUICKEST_S, room))
    brief = replace(x, trial=replace(x.trial, hold_s=TOUCH_S))
    for _ in range(HALVINGS):
        middle = 0.5 * (quick + slow)
        reaching = replace(brief, operator=replace(brief.operator, reach_s=math.exp(middle)))
        if fmean(simulated(reaching)["impact_speed"]) > _middle(trial.impact_speed):
            quick = middle
        else:
            slow = middle
    return round(math.exp(quick), 3)


def _middle(band: Band) -> float:
    return 0.5 * (band[0] + band[-1])


def simulated(x: Experiment) -> dict[str, list[float]]:
    """What a simulated hand does in some hits of a soft wall (units of the rig); no speed where it never comes there.

    The press is that of the wall's spring at the resting penetration, which in a soft wall is the mean effort.
    """
    verdicts = [
        HitSimulator(replace(x, trial=replace(x.trial, baseline_s=0.0, foreperiod_s=0.0, seed=seed)))
        .hit(x.wall.stiffness, x.wall.damping)
        .recorded.verdict
        for seed in range(HITS)
    ]
    return {
        "impact_speed": [abs(one.impact_velocity or 0.0) for one in verdicts],
        "press": [x.wall.stiffness * one.resting_penetration for one in verdicts],
    }
