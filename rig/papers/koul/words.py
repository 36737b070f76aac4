"""How the report on Koul et al. says numbers and conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.experiments.zwidth import Width, ZWidth
from rig.papers.frame import over, shown
from rig.papers.koul.results import Koul
from rig.papers.koul.rigs import SCHEMES

ORDER = list(SCHEMES)
JUDGED = (
    "Judged on the simulation's truth. A wall holds when it is not unstable and not felt (5 mm/s rms at the handle, "
    "30 to 500 Hz), not heard (1 N rms ripple), or none of felt, heard and moved (0.125 mm peak to peak) = any."
)
FLOAT = "Velocity in floating point, counts and current quantised as on the wire, no computation delay."
SAME = 0.05  # a change by less is none


def how(found: ZWidth) -> str:
    """Rig, hand, search and offsets of a map."""
    plan = found.plan
    trial = plan.experiment.trial
    hand = f"{plan.experiment.operator.grip} hand" if trial.kind == "human" else "automated"
    return (
        f"{plan.experiment.rig.name}, {hand}, {plan.search.way} from {plan.search.lowest:g} to "
        f"{plan.search.highest:.4g} N·m/rad with rungs {percent(plan.search.ratio)} apart, "
        f"{len(plan.dampings)} dampings, encoder offsets {', '.join(map(str, plan.offsets))}, one repeat each"
    )


def offsets(koul: Koul) -> str:
    """The encoder offsets of ranges and maps."""
    return f"encoder offsets {', '.join(map(str, koul.scale.offsets))}"


def percent(ratio: float) -> str:
    """How far two rungs of a ratio are apart."""
    return f"{100 * (ratio - 1):.2g} %"


def at_least(value: float, capped: bool) -> str:
    """A limit; with a sign when it is only a cap."""
    return f"{'≥ ' if capped else ''}{shown(value)}"


def peak_of(width: Width) -> str:
    """The stiffest wall of a map."""
    return at_least(width.stiffness_peak, width.capped)


def of_linear(value: float, linear: float) -> str:
    """A value, and its ratio to linear theory in brackets."""
    return f"{shown(value)} ({shown(over(value, linear))})"


def growth(stiffness: Sequence[float], rates: Sequence[int]) -> float:
    """The last stiffness over that at 20 kHz."""
    return stiffness[-1] / stiffness[list(rates).index(20_000)]


def signed(ratio: float) -> str:
    """A ratio as a change in percent."""
    return f"{100 * (ratio - 1):+.0f} %" if np.isfinite(ratio) else "from nothing"


def word(ratios: Sequence[float]) -> str:
    """What ideas do to an area: one word for all of them."""
    if all(r > 1.0 + SAME for r in ratios):
        return "widens"
    if all(r < 1.0 - SAME for r in ratios):
        return "narrows"
    if all(abs(r - 1.0) <= SAME for r in ratios):
        return "does not change"
    return "changes, now this way and now that,"
