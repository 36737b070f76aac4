"""What limits the gain of the disturbance observer on koul-rigid? One change at a time.

    python -m tests.benchmarks.observer_gain            # the table; four minutes of one core

Areas by the rule of the ranking on koul-rigid without variations, at the offsets 0.1 and 0.8, each estimator tuned
under the same change: the observer over the better of two estimators of the counts alone, which the ranking finds best.
"""

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment
from rig.devices.simulated import SimulatedHit
from rig.extras.papers.ranking import measure, rule
from rig.extras.papers.ranking.rule import ESTIMATORS, Ground, Pair

RIG, OFFSETS = "koul-rigid", (0.1, 0.8)
PLAIN, OBSERVER = ("fdm-butterworth", "tracking"), "disturbance"
WITH_END_MASS = 1.02e-3  # kg·m²: what the observer was given in a hand too, whose handle has no end mass
CHANGES: dict[str, dict[str, Any]] = {
    "as ranked": {},
    "effort limit × 5": {"rig.limits.effort": 6.5, "rig.amplifier.effort_limit": 6.5},
    "no Coulomb friction": {"rig.mechanics.motor_coulomb": 0.0},
    "no lag": {"rig.amplifier.lag_s": 0.0},
    "no end mass": {"rig.mechanics.end_mass": 0.0},
}
ranked = rule.counts


def felt(hit: SimulatedHit, stiffness: float, damping: float) -> bool:
    """Return True if a wall is rendered as the rule of the ranking demands, and its true velocity passes *felt*."""
    fits = ranked(replace(hit, recorded=hit.true), stiffness, damping)
    return hit.true.passes("felt") is True and fits


def stable(hit: SimulatedHit, stiffness: float, damping: float) -> bool:
    """Return True if a wall passes *heard*, rendered or not."""
    return hit.recorded.passes("heard") is True


def area(x: Experiment, grip: str, offset: float) -> float:
    ground, rungs = Ground.of(RIG), measure._search(RIG, grip).rungs
    return measure.area_under(measure.series(x, 0, offset, RIG, grip)["limits"], ground.dampings(), rungs[0])


def areas(estimator: str, changes: dict[str, Any], inertia: float | None) -> tuple[float, dict[str, float]]:
    """Return the tuned value, and the area (geometric mean of the offsets) without a hand and in each grip."""
    ground, pair, grid = Ground.of(RIG), Pair(estimator), ESTIMATORS[estimator].grid(20_000)

    def best_area(settings: rule.Settings, grip: str, offset: float) -> float:
        own = {"inertia": inertia} if inertia and estimator == OBSERVER and grip != "none" else {}
        x = ground.experiment(pair, {**settings, **own}, grip, 0)
        return math.log(area(config.override(x, changes, "the benchmark"), grip, offset))

    def tuning(settings: rule.Settings) -> float:
        return sum(best_area(settings, grip, rule.TUNING_OFFSET) for grip in rule.TUNING_CONDITIONS)

    best = max(grid[::3], key=tuning)
    means = {grip: math.exp(np.mean([best_area(best, grip, o) for o in OFFSETS])) for grip in rule.CONDITIONS}
    return float(next(iter(best.values()))), means


def row(name: str, changes: dict[str, Any], inertia: float | None = None) -> None:
    every = {one: areas(one, changes, inertia) for one in (*PLAIN, OBSERVER)}
    own, cells = every[OBSERVER][1], []
    for grip in rule.CONDITIONS:
        best = max(PLAIN, key=lambda one: every[one][1][grip])
        cells.append(f"{own[grip] / every[best][1][grip]:.2f} over {best}")
    tuned = ", ".join(f"{one} {value:.3g}" for one, (value, _) in every.items())
    print(f"| {name} | {' | '.join(cells)} | {tuned} |", flush=True)


def main() -> None:
    print(f"| change | {' | '.join(rule.CONDITIONS)} | tuned |\n|---|---|---|---|---|---|", flush=True)
    row("inertia with the end mass in a hand", {}, WITH_END_MASS)
    for name, changes in CHANGES.items():
        row(name, changes)
    for name, judged in (("any stable wall counts", stable), ("felt also", felt)):
        rule.counts = judged
        row(name, {})


if __name__ == "__main__":
    sys.exit(main())
