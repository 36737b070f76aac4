"""Compute by linear theory the largest stable stiffness of each listed sampling scheme and damping, with delay and lag.

`_search` calls this module for its first stage. Schemes must not be chosen by theory alone, because theory neglects
quantisation and friction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.theory import Lifted, LinearLoop, NotLinearError, linear_loop, resolve
from rig.config import Experiment
from rig.config.schemes import STAND_IN, Scheme, usual_settings
from rig.experiments.design import _paths as paths
from rig.experiments.design._listing import Candidate
from rig.experiments.design._rules import BoundaryMeasures, Measures
from rig.experiments.mapping._rendering import RENDERED, rendered_share
from rig.experiments.sweep import Task

STAGE = "linear theory"
STIFFNESSES, CHUNK = 40, 4

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """Results of linear theory for one sampling scheme: stiffness limits, and the numbers of its velocity estimate.

    Attributes
    ----------
    stable
        Largest stable K at each damping (N·m/rad or N/m).
    quiet
        Largest stable K at each damping with an effort ripple within the verdict's limit, too, while an encoder count
        toggles at rest (N·m/rad or N/m).
    stands_in
        True if the filter `STAND_IN` replaces an estimator that is not linear.
    """

    stable: tuple[float, ...]
    quiet: tuple[float, ...]
    noise: float
    fidelity_hz: float
    cost: float | None
    stands_in: bool

    def measures(self, dampings: Sequence[float], *, quiet: bool) -> Measures:
        """Return the scheme's peak K, range of B, noise and more, from the limits `quiet` or `stable` at `dampings`."""
        found = BoundaryMeasures.of(dampings, self.quiet if quiet else self.stable)
        return Measures(**asdict(found), noise=self.noise, fidelity_hz=self.fidelity_hz, cost=self.cost)


def tasks(
    experiment: Experiment, candidates: Sequence[Candidate], dampings: Sequence[float], k: Sequence[float]
) -> tuple[list[Task], list[int]]:
    """Return calls that compute linear theory for all candidates, and for each of their results the candidate's index.

    `k` are stiffnesses (N·m/rad or N/m), `dampings` in N·m·s/rad or N·s/m. A call computes all candidates (sampling
    schemes) with the same estimator settings and velocity rate, which share a linear model.
    """
    # Sorted by estimator: the candidates of a task share its realisation.
    order = sorted(range(len(candidates)), key=lambda i: (_estimator_key(candidates[i]), i))
    mapping = config.as_mapping(experiment)
    found = [
        Task(
            key,
            of_estimator,
            {
                "experiment": mapping,
                "candidates": [
                    {name: getattr(candidates[i], name) for name in ("loop", "delay_ticks", "board")}
                    | {"scheme": candidates[i].scheme.text}
                    for i in some
                ],
                "dampings": list(dampings),
                "stiffnesses": list(k),
            },
            weight=float(len(some)),
        )
        for key, some in (
            (key, list(group)) for key, group in groupby(order, lambda i: _estimator_key(candidates[i]))
        )
    ]
    return found, order


def results(done: Sequence[Sequence[Mapping[str, Any]]], order: Sequence[int]) -> list[Linear]:
    """Sort the results of all calls from `tasks` by candidate; `order` is the second result of `tasks`."""
    rows = [
        Linear(**{**row, "stable": tuple(row["stable"]), "quiet": tuple(row["quiet"])})
        for one in done
        for row in one
    ]
    return [row for _, row in sorted(zip(order, rows, strict=True), key=lambda pair: pair[0])]


def of_estimator(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compute linear theory for all sampling schemes with one estimator; arguments and results are JSON values."""
    experiment = config.restore_experiment(payload["experiment"])
    k, b = np.array(payload["stiffnesses"]), np.array(payload["dampings"])
    first: LinearLoop | None = None
    stands_in, noise, rows = False, None, []
    for given in payload["candidates"]:
        candidate = Candidate(**{**given, "scheme": Scheme.parse(given["scheme"])})
        applied = candidate.applied(experiment)
        resolution = applied.rig.encoder.resolution
        if noise is None:
            noise = paths.noise(applied.controller, resolution)
        scheme = _use_usual_filter(candidate.scheme) if stands_in else candidate.scheme
        subject = resolve(candidate.condition(experiment))
        realised = None if first is None else first.estimator
        try:
            loop = linear_loop(subject, scheme, estimator=realised)
        except NotLinearError:
            stands_in = True
            loop = linear_loop(subject, _use_usual_filter(candidate.scheme))
        first = first or loop
        rendered = np.array([rendered_share(applied, float(damping)) for damping in b]) >= RENDERED
        stable = _stable(Lifted.of(loop), k, b) & rendered
        # Theory neglects the encoder's quantum, which removes nearly all damping of a fast uniform wall, so the first
        # limits are too high. The second limits (`quiet`) admit only walls whose effort ripple stays below the
        # verdict's threshold while the count toggles at random at rest: too low. A scheme that is good by either stays.
        ripple = np.hypot(0.5 * resolution * k[:, None], noise * b)
        heard = config.verdict_thresholds(applied).heard_effort
        rows.append(
            {
                "stable": _limits(stable, k),
                "quiet": _limits(stable & (ripple <= heard), k),
                "noise": noise,
                "fidelity_hz": paths.fidelity_hz(
                    applied.controller, resolution, applied.rig.amplifier.lag_s, loop.delay_ticks
                ),
                "cost": paths.cost(applied.controller, candidate.board),
                "stands_in": stands_in,
            }
        )
    return rows


def _stable(lifted: Lifted, k: Floats, b: Floats) -> NDArray[np.bool_]:
    """Return True for stable walls, shape (K, B), and False without a test for walls far above an unstable one."""
    stable = np.zeros((len(k), len(b)), np.bool_)
    left = np.arange(len(b))
    for some in np.array_split(np.arange(len(k)), max(1, len(k) // CHUNK)):
        found = lifted.stable(k[some, None], b[left])
        stable[np.ix_(some, left)] = found
        # Walls stiffer than an unstable wall are not tested: a limit requires that all softer walls are stable.
        left = left[found.all(axis=0)]
        if not len(left):
            break
    return stable


def _limits(stable: NDArray[np.bool_], k: Floats) -> list[float]:
    """Return the largest K of each column of `stable` up to which all walls are stable; 0 if the first is unstable."""
    count = np.logical_and.accumulate(stable, axis=0).sum(axis=0)
    return np.where(count > 0, k[np.maximum(count - 1, 0)], 0.0).tolist()  # type: ignore[no-any-return]


def _use_usual_filter(scheme: Scheme) -> Scheme:
    # Its limits only: noise and fidelity are those of the estimator.
    rate = scheme.velocity_rate
    usual = usual_settings(STAND_IN, rate)
    return replace(scheme, estimator=STAND_IN, parameters=usual, slow_velocity_rate=None, slow_below=0.0)


def _estimator_key(candidate: Candidate) -> str:
    scheme = candidate.scheme
    return f"{scheme.velocity_rate} Hz {replace(scheme, position_rate=scheme.velocity_rate, prediction=None).text}"
