"""Find how long a simulated hand must move to the wall, so that it hits with a required impact speed.

Checks of a protocol and sessions with a simulated hand use it, never a trial with a person.
"""

import math
from dataclasses import replace
from statistics import fmean

from rig.config import Experiment
from rig.experiments.hits.hit_simulator import HitSimulator

QUICKEST_S = 0.05  # chosen: no hand reaches faster
# A hit ends this time after the contact, since only its impact speed is needed.
TOUCH_S = 0.01
HITS = 3  # simulated, each with another tremor and start
# Number of bisections: 8 find the duration to 2 % between `QUICKEST_S` and some seconds.
HALVINGS = 8


def reach_for(experiment: Experiment, speed: float) -> float:
    """Return how long (s) a simulated hand must move to the wall to hit it with `speed` (rad/s or m/s)."""
    room = (
        experiment.trial.duration_s
        - (0.0 if experiment.trial.hold_s else experiment.verdict.tail_s)
        - experiment.operator.begin_s
    )
    quick, slow = math.log(QUICKEST_S), math.log(max(QUICKEST_S, room))
    brief = replace(experiment, trial=replace(experiment.trial, hold_s=TOUCH_S))
    for _ in range(HALVINGS):
        middle = 0.5 * (quick + slow)
        reaching = replace(brief, operator=replace(brief.operator, reach_s=math.exp(middle)))
        if fmean(simulate_hits(reaching)["impact_speed"]) > speed:
            quick = middle
        else:
            slow = middle
    return round(math.exp(quick), 3)


def simulate_hits(experiment: Experiment) -> dict[str, list[float]]:
    """Return impact speeds (rad/s or m/s) and presses (N·m or N) of a simulated hand in some hits on a soft wall."""
    verdicts = [
        HitSimulator(
            replace(experiment, trial=replace(experiment.trial, baseline_s=0.0, foreperiod_s=0.0, seed=seed))
        )
        .hit(experiment.wall.stiffness, experiment.wall.damping)
        .recorded.verdict
        for seed in range(HITS)
    ]
    return {
        "impact_speed": [abs(one.impact_velocity or 0.0) for one in verdicts],
        "press": [experiment.wall.stiffness * one.resting_penetration for one in verdicts],
    }
