"""Measure how often the mixed model finds a difference that does not exist, with its exact likelihood.

    python -m tests.benchmarks.null_studies            # what `rig/session/README.md` says of likelihood ratios
    python -m tests.benchmarks.null_studies 8          # with so many participants alone

2000 studies for each number of participants: two conditions at three dampings, the mean of five repeats of each. People
differ by 20 in all, each has 20 of their own in each condition at each damping and 15 in each condition, and repeats
scatter by 12. Every participant has every cell and order is the same for all, so that the likelihood falls apart into
four strata (people, people × condition, people × damping, residual) with a closed form. That statsmodels finds the same
optimum is shown by ``tests/extras/study/test_session_statistics.py``.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

Floats = NDArray[np.float64]
Stratum = tuple[bool, bool]  # whether it lies across conditions, across dampings

CONDITIONS, DAMPINGS, REPEATS, STUDIES = 2, 3, 5, 2000
PEOPLE = (8, 12, 20)
BETWEEN, OF_CONDITION, OF_CELL, SCATTER = 20.0, 15.0, 20.0, 12.0
STRATA: tuple[Stratum, ...] = ((False, False), (True, False), (False, True), (True, True))
FACTORS: dict[str, tuple[Stratum, ...]] = {  # strata in which the reduced model has no mean
    "condition, at any damping": ((True, False), (True, True)),
    "damping, in any condition": ((False, True), (True, True)),
    "condition × damping": ((True, True),),
}


@dataclass(frozen=True)
class Fit:
    """Twice the negative log likelihood at its least, but for a constant, and variances of the strata."""

    deviance: float
    variances: dict[Stratum, float]


def study(people: int, drawn: np.random.Generator) -> Floats:
    """Means over repeats of a study without differences, shape (people, conditions, dampings)."""
    return np.asarray(
        drawn.normal(0.0, BETWEEN, (people, 1, 1))
        + drawn.normal(0.0, OF_CONDITION, (people, CONDITIONS, 1))
        + drawn.normal(0.0, OF_CELL, (people, CONDITIONS, DAMPINGS))
        + drawn.normal(0.0, SCATTER / math.sqrt(REPEATS), (people, CONDITIONS, DAMPINGS))
    )


def in_strata(means: Floats) -> dict[Stratum, Floats]:
    """Return the values in orthonormal contrasts, with shape (people, contrasts) for each stratum."""
    turned = np.einsum("pcb,ic,jb->pij", means, _contrasts(CONDITIONS), _contrasts(DAMPINGS))
    parts = {False: slice(0, 1), True: slice(1, None)}
    return {
        (condition, damping): turned[:, parts[condition], parts[damping]].reshape(len(means), -1)
        for condition, damping in STRATA
    }


def _contrasts(count: int) -> Floats:
    """Return an orthonormal matrix whose first row is the mean."""
    rows = np.linalg.qr(np.column_stack([np.ones(count), np.eye(count)[:, : count - 1]]))[0].T
    return np.asarray(rows)


def fit(values: dict[Stratum, Floats], without: Sequence[Stratum] = (), *, reml: bool = False) -> Fit:
    """Maximise the likelihood over non-negative variances; strata in `without` have no mean."""
    squares, sizes = np.zeros(4), np.zeros(4)
    for place, stratum in enumerate(STRATA):
        of = values[stratum]
        squares[place] = (of**2 if stratum in without else (of - of.mean(axis=0)) ** 2).sum()
        sizes[place] = (len(of) - reml) * of.shape[1]
    # of residual, person, person × condition, person × damping, in each stratum
    shares = np.array([
        [1.0, CONDITIONS * DAMPINGS, DAMPINGS, CONDITIONS],
        [1.0, 0.0, DAMPINGS, 0.0],
        [1.0, 0.0, 0.0, CONDITIONS],
        [1.0, 0.0, 0.0, 0.0],
    ])  # fmt: skip

    def deviance(variances: Floats) -> float:
        return float((sizes * np.log(variances) + squares / variances).sum())

    free = squares / sizes
    parts = np.linalg.solve(shares, free)
    if (parts < 0.0).any():
        scale = free[3]
        bounds = [(1e-9, None), *[(0.0, None)] * 3]
        found = min(
            (
                optimize.minimize(
                    lambda x: deviance(scale * (shares @ x)),
                    np.array([1.0, start, start, start]),
                    method="L-BFGS-B",
                    bounds=bounds,
                    options={"ftol": 1e-13},
                )
                for start in (0.01, 1.0)
            ),
            key=lambda one: float(one.fun),
        )
        free = scale * (shares @ found.x)
    return Fit(deviance(free), dict(zip(STRATA, free.tolist(), strict=True)))


def main(arguments: Sequence[str]) -> None:
    print("| participants |", " | ".join(FACTORS), "| intervals at a damping | over all dampings |")
    for people in [int(one) for one in arguments] or PEOPLE:
        drawn = np.random.default_rng(people)
        found = dict.fromkeys(FACTORS, 0)
        held = {"at a damping": 0, "over all": 0}
        t = float(stats.t.ppf(0.975, people - 1))
        for _ in range(STUDIES):
            means = study(people, drawn)
            values = in_strata(means)
            whole = fit(values)
            for factor, without in FACTORS.items():
                statistic = fit(values, without).deviance - whole.deviance
                degrees = sum(values[stratum].shape[1] for stratum in without)
                found[factor] += bool(stats.chi2.sf(statistic, degrees) < 0.05)
            variances = fit(values, reml=True).variances
            between = 2.0 * variances[True, False] / DAMPINGS
            within = 2.0 * variances[True, True] * (DAMPINGS - 1) / DAMPINGS
            difference = (means[:, 1] - means[:, 0]).mean(axis=0)
            held["at a damping"] += bool(abs(difference[0]) <= t * math.sqrt((between + within) / people))
            held["over all"] += bool(abs(difference.mean()) <= t * math.sqrt(between / people))
        shares = [*found.values(), *held.values()]
        print(f"| {people} |", " | ".join(f"{100 * one / STUDIES:.1f} %" for one in shares), "|", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
