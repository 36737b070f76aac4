"""Undamped walls judged by the velocity estimate, as a course's own firmware judges them.

Without damping no estimate enters a wall, and the handle moves alike under all of them: whoever measures other limits
has judged by the estimate itself. The firmware of a public project on such a paddle does: it raises the stiffness while
the motor pushes, and stops when the estimated velocity has changed its sign more than `MOST_TURNS` times in a second,
by more than `LEAST_TURN` each (10°/s at 75 mm).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.config.schemes import Scheme
from rig.control.estimators import estimate
from rig.experiments.compare import Start, simulate
from rig.experiments.searches import Search

TOLD = "rig.papers.paddle.parts:told"

MOST_TURNS = 10  # in a second
LEAST_TURN = 0.013  # m/s
JUDGED_S = 0.5  # the last part of the push, after the impact


def told(payload: Mapping[str, Any]) -> list[float]:
    """Stiffest undamped wall at which an estimate is still quiet (N/m), by scheme: upwards, to the first that fails."""
    experiment = config.experiment_from_mapping(payload["experiment"], "a rig")
    schemes = [Scheme.parse(text) for text in payload["schemes"]]
    found = [0.0] * len(schemes)
    quiet = [True] * len(schemes)
    for stiffness in Search(**payload["search"]).rungs:
        counts = _counts(config.override(experiment, {"wall.stiffness": stiffness, "wall.damping": 0.0}))
        for place, scheme in enumerate(schemes):
            quiet[place] = quiet[place] and not oscillates(
                _velocity(experiment, scheme, counts), _judged(experiment)
            )
            if quiet[place]:
                found[place] = stiffness
        if not any(quiet):
            break
    return found


def oscillates(velocity: NDArray[np.float64], judged: int) -> bool:
    """Whether the last samples of an estimate turn round too often; see the head of this file."""
    tail = velocity[-judged:]
    turned = (np.sign(tail[1:]) != np.sign(tail[:-1])) & (np.abs(np.diff(tail)) > LEAST_TURN)
    return float(turned.sum()) > MOST_TURNS * JUDGED_S


def _counts(experiment: config.Experiment) -> NDArray[np.int64]:
    _, _, trace = simulate(experiment, Start.of(experiment), experiment.rig.encoder.offset)
    return np.asarray(trace.counts, dtype=np.int64)


def _velocity(
    experiment: config.Experiment, scheme: Scheme, counts: NDArray[np.int64]
) -> NDArray[np.float64]:
    controller = scheme.applied(experiment).controller
    resolution = experiment.rig.encoder.resolution
    period_s = 1.0 / controller.velocity_rate
    return estimate(controller.estimator, counts, period_s, resolution=resolution, **controller.parameters)


def _judged(experiment: config.Experiment) -> int:
    return round(JUDGED_S * experiment.controller.position_rate)
