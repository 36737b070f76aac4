"""What the reproduction of the paddle computed, what its page asks of it, and all of it as plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rig.core.deferred import stats
from rig.experiments.zwidth import ZWidth
from rig.papers.paddle import data, rigs, rules
from rig.papers.paddle.rules import Curves
from rig.realtime.source_files import code_version

CRITERION = "any"


@dataclass(frozen=True, slots=True)
class Fit:
    """The rig that fits three measured curves best, and its prediction of the fourth.

    Attributes
    ----------
    left_out
        The estimator that is predicted.
    rig
        Number of the rig.
    fitted, predicted, mean
        Rms differences (N/m) over the measured dampings: of the three, of the fourth, and of the mean of the three
        measured curves from the fourth.
    """

    left_out: str
    rig: int
    fitted: float
    predicted: float
    mean: float


@dataclass(frozen=True, kw_only=True)
class Paddle:
    """Everything that was computed: the curves of every rig, in the order of `drawn`.

    Attributes
    ----------
    scale
        How fine.
    drawn
        The rigs.
    curves
        Their limits (N/m), by estimator.
    capped
        How many limits are only lower bounds.
    told
        Undamped limits (N/m) when the estimate itself is judged, by estimator.
    hits
        How many walls were hit.
    """

    scale: rigs.Scale
    drawn: tuple[rigs.Rig, ...]
    curves: tuple[Curves, ...]
    capped: int
    told: tuple[Mapping[str, float], ...]
    hits: int

    @cached_property
    def plausible(self) -> list[int]:
        """Places of the plausible rigs."""
        return [
            place for place, curves in enumerate(self.curves) if rules.plausible(curves, self.scale.dampings)
        ]

    @property
    def plausible_curves(self) -> list[Curves]:
        """Their curves."""
        return [self.curves[place] for place in self.plausible]

    @cached_property
    def fits(self) -> tuple[Fit, ...]:
        """Three curves fitted and the fourth predicted, in turn; over all rigs, plausible or not."""
        return tuple(_fit(name, self.drawn, self.curves, self.scale.dampings) for name in data.ESTIMATORS)

    @cached_property
    def decides(self) -> list[tuple[str, float]]:
        """What goes with Levant's lead over the plausible rigs: Spearman's coefficient, the strongest first."""
        leads = [rules.lead(curves) for curves in self.plausible_curves]
        if len(leads) < 3:
            return []
        found = [(name, _rank(self._values(name), leads)) for name in (*rigs.PRIORS, "delay")]
        return sorted(found, key=lambda one: -abs(one[1]))

    @property
    def chance(self) -> float:
        """What the largest coefficient of `decides` exceeds in one of twenty such lists of unrelated quantities."""
        free = len(self.plausible) - 2
        t = float(stats.t.isf(0.05 / len(self.decides) / 2, free))
        return t / float(np.hypot(t, free**0.5))

    def thirds(self, name: str) -> list[tuple[float, float, int, int]]:
        """Plausible rigs in three parts by a quantity: its bounds, how many, and in how many Levant leads or ties."""
        values, step = np.array(self._values(name)), self.scale.ratio
        parts = np.array_split(np.argsort(values, kind="stable"), 3)
        rows = []
        for places in parts:
            some = [self.plausible_curves[place] for place in places]
            counts = rules.count_leads(some, step)
            rows.append(
                (
                    float(values[places].min()),
                    float(values[places].max()),
                    len(some),
                    counts["ahead"] + counts["tie"],
                )
            )
        return rows

    def _values(self, name: str) -> list[float]:
        found = [self.drawn[place] for place in self.plausible]
        return [float(rig.delay) if name == "delay" else rig.values[name] for rig in found]


def curves_of(found: ZWidth) -> Curves:
    """The limits of a map, by estimator."""
    return {
        name: [boundary.stiffness for boundary in found.curve(number, CRITERION)]
        for number, name in enumerate(data.ESTIMATORS)
    }


def capped_of(found: ZWidth) -> int:
    """How many limits of a map are only lower bounds."""
    return sum(boundary.capped > 0 for boundary in found.boundaries if boundary.criterion == CRITERION)


def _rank(values: Sequence[float], leads: Sequence[float]) -> float:
    if len(set(values)) < 2 or len(set(leads)) < 2:
        return 0.0
    return float(stats.spearmanr(values, leads).statistic)


def _fit(left_out: str, drawn: Sequence[rigs.Rig], found: Sequence[Curves], dampings: Sequence[float]) -> Fit:
    others = [name for name in data.ESTIMATORS if name != left_out]

    def error(curves: Curves, names: Sequence[str]) -> float:
        differences = [
            k - data.measured(name, b) for name in names for k, b in zip(curves[name], dampings, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(differences))))

    best = min(range(len(found)), key=lambda place: error(found[place], others))
    means = [np.mean([data.measured(name, b) for name in others]) for b in dampings]
    return Fit(
        left_out,
        drawn[best].number,
        error(found[best], others),
        error(found[best], [left_out]),
        error({left_out: [float(k) for k in means]}, [left_out]),
    )


def numbers(paddle: Paddle) -> dict[str, Any]:
    """Every number in plain values."""
    return {
        "dampings": list(paddle.scale.dampings),
        "rigs": [
            {
                **rig.values,
                "delay": rig.delay,
                "gains": rig.gains,
                "curves": curves,
                "told": told,
            }
            for rig, curves, told in zip(paddle.drawn, paddle.curves, paddle.told, strict=True)
        ],
        "plausible": [paddle.drawn[place].number for place in paddle.plausible],
        "decides": paddle.decides,
        "fits": [asdict(fit) for fit in paddle.fits],
        "capped": paddle.capped,
    }


def provenance(paddle: Paddle) -> dict[str, Any]:
    """What the numbers come from, the same on every machine."""
    return {
        "haptic-rig": code_version(),
        "scale": asdict(paddle.scale),
        "seed": rigs.SEED,
        "hits": paddle.hits,
        "priors": {name: asdict(prior) for name, prior in rigs.PRIORS.items()},
        "measured": {name: list(curve) for name, curve in data.CURVES.items()},
    }
