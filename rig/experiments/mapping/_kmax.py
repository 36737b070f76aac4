"""Map the stiffest stable undamped wall against the sampling rate: Koul et al. 2013, Fig. 5.

`rig zwidth` and the reproduced papers use this module. The map is a Z-width map with a uniform sampling scheme for each
rate and B = 0, where the estimator has no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.control.verdict import CRITERIA
from rig.core.shown import Drawn
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import Boundary, MapPlan, ZWidth

RATES = (100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)  # Hz, the paper's range


@dataclass(frozen=True, slots=True)
class KMax(Drawn):
    """A curve of the largest stable K at B = 0 over the sampling rate (Hz), from simulated hits on walls."""

    rates: tuple[int, ...]
    map: ZWidth

    @staticmethod
    def is_of(plan: MapPlan) -> bool:
        """Return True if a map of walls has B = 0 only, and uniform sampling schemes in ascending order of rates."""
        rates = [scheme.position_rate for scheme in plan.schemes]
        uniform = all(scheme.position_rate == scheme.velocity_rate for scheme in plan.schemes)
        return plan.dampings == (0.0,) and uniform and rates == sorted(set(rates))

    @classmethod
    def of(cls, found: ZWidth) -> KMax:
        """Return the curve from a finished map of walls with B = 0 only and uniform sampling schemes (`is_of`)."""
        return cls(tuple(scheme.position_rate for scheme in found.plan.schemes), found)

    def curve(self, criterion: str) -> list[Boundary]:
        """Return the stiffness limit per sampling rate by a ripple: "felt" (velocity), "heard" (effort) or "any"."""
        return [self.map.curve(number, criterion)[0] for number in range(len(self.rates))]

    def saturation(self, criterion: str) -> float | None:
        """Return K_max (stiffest stable wall) at the highest sampling rate divided by K_max at 20 kHz.

        None if no rate exceeds 20 kHz, if 20 kHz is missing, or if a limit is 0 or a lower bound.
        """
        if 20_000 not in self.rates or self.rates[-1] <= 20_000:
            return None
        curve = self.curve(criterion)
        reference, last = curve[self.rates.index(20_000)], curve[-1]
        if reference.stiffness <= 0.0 or reference.capped or last.capped:
            return None
        return last.stiffness / reference.stiffness

    def as_mapping(self) -> dict[str, Any]:
        """Return stiffness limits and their ratio at high rates (`saturation`) as JSON values by name."""
        mapping = self.map.as_mapping()
        for rate, scheme in zip(self.rates, mapping["schemes"], strict=True):
            scheme["rate_hz"] = rate
        return {**mapping, "saturation": {name: self.saturation(name) for name in CRITERIA}}


def undamped_schemes(rates: Sequence[int] = RATES) -> tuple[Scheme, ...]:
    """Return a uniform sampling scheme for each rate (Hz), in ascending order."""
    return tuple(
        Scheme(position_rate=rate, velocity_rate=rate, estimator="fdm") for rate in sorted(set(rates))
    )


def kmax_plan(
    experiment: Experiment,
    search: StiffnessSearch,
    *,
    rates: Sequence[int] = RATES,
    offsets: Sequence[float] = (0.1, 0.6),
    repeats: int = 1,
) -> MapPlan:
    """Return the plan of a map of stable walls at B = 0, with a uniform sampling scheme for each rate (Hz)."""
    return MapPlan(
        experiment=experiment,
        schemes=undamped_schemes(rates),
        dampings=(0.0,),
        search=search,
        offsets=tuple(offsets),
        repeats=repeats,
    )
