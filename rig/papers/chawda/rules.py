"""Rules that judge the claims of Chawda et al.: plain numbers in, verdict out, each with its thresholds.

Nothing here knows a rig or a result, so that a test can reach every verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import median

from rig.papers.frame import Finding, Status, over, shown, verdict_over, within

# What the paper says.
DROP, DROP_ADJUSTED, FILTER_HOLDS, BETTER_UP_TO = 250.0, 300.0, 350.0, 150.0  # N·s/m, Fig. 3 and its text

# Thresholds of the rules.
MOST = 0.9  # of readings
STIFFER = 1.05  # or larger, of errors
LIMITED = 0.75  # of the range of damping of the filtered difference
HALF = 0.5  # of its own peak: where a Z-width has dropped
SHARP = 2.0  # from one damping to the next
NEAR_DROP = 1.25
NEAR_WIDTH = 1.5  # K-widths and fidelity against Table I
LEAST_DAMPING = 40.0  # N·s/m: what differs between filters is damping's work
SAME_CONTROL = 0.03
WIDER = 1.2
BETTER_COMMON = 0.05  # share of the error
TRACED = 0.9  # of the columns


def share_of(held: int, total: int, what: str, said: str = "") -> Finding:
    """A claim that holds in some of many readings: reproduced in most, else only with some."""
    share = held / total if total else 0.0
    ours = f"{held} of {total} {what}" + (f"; {said}" if said else "")
    if total and share >= MOST:
        return Finding(status=Status.REPRODUCED, ours=ours)
    if held:
        return Finding(status=Status.ONLY_WITH, ours=ours, condition=f"some readings ({100 * share:.0f} %)")
    return Finding(status=Status.NOT, ours=ours)


def in_order(widths: Sequence[float]) -> bool:
    """Whether each is larger than the next: K-widths in the order that the paper gives."""
    return all(first > second for first, second in pairwise(widths))


def stiffer(cases: Mapping[str, Sequence[float]], step: float = 1.0) -> Finding:
    """Ratios of two limits at several dampings, by case; `step` is the ratio of two rungs of the search."""
    ours = "; ".join(f"{name} {times_of(values)}" for name, values in cases.items())
    return verdict_over({name: mostly_stiffer(values, step) for name, values in cases.items()}, ours)


def mostly_stiffer(ratios: Sequence[float], step: float = 1.0) -> bool:
    """Nowhere softer, and in the median stiffer by more than rounding and more than half a rung."""
    return min(ratios) >= 1.0 / (STIFFER * step) and median(ratios) >= STIFFER * step**0.5


def times_of(values: Sequence[float]) -> str:
    """The range of some ratios."""
    low, high = min(values), max(values)
    return f"× {shown(low)}" if low == high else f"× {shown(low)} to {shown(high)}"


def mostly_larger(cases: Mapping[str, tuple[int, int]], said: str) -> Finding:
    """How often one K-width is the larger of two, of how many readings that tell them apart, by case."""
    ours = "; ".join(f"{name} {above} of {told}" for name, (above, told) in cases.items())
    held = {name: told > 0 and above >= MOST * told for name, (above, told) in cases.items() if told}
    return verdict_over(held, f"{ours} {said}")


def dropped(dampings: Sequence[float], stiffnesses: Sequence[float]) -> float:
    """Damping beyond its peak from which on a Z-width stays below half of the peak; infinite if it does not."""
    peak = max(stiffnesses)
    found = math.inf
    for damping, stiffness in zip(reversed(dampings), reversed(stiffnesses), strict=True):
        if stiffness >= HALF * peak:
            break
        found = damping
    return found if peak > 0.0 else dampings[0]


def sharpness(stiffnesses: Sequence[float]) -> float:
    """Largest fall from one damping to the next, as a ratio."""
    return max((over(high, low) for high, low in pairwise(stiffnesses)), default=1.0)


def limited(ranges: Mapping[str, float], filtered: float, unit: str = "N·s/m") -> Finding:
    """Range of damping of Levant's differentiator, by case, against that of the filtered difference."""
    ours = (
        "; ".join(f"{name} {shown(value)}" for name, value in ranges.items())
        + f" against {shown(filtered)} {unit}"
    )
    return verdict_over({name: value <= LIMITED * filtered for name, value in ranges.items()}, ours)


def drops_at(drops: Mapping[str, tuple[float, float]], others: Sequence[float], most: float) -> Finding:
    """Where Z-widths drop (ours, the paper's), and where they do over all gains that were tried."""
    finite = [value for value in others if math.isfinite(value)]
    beyond = len(others) - len(finite)
    over_gains = (
        f"over {len(others)} pairs of gains {shown(min(finite))} to {shown(max(finite))}" if finite else ""
    )
    ours = "; ".join(f"{name} {_drop(value, most)}" for name, (value, _) in drops.items())
    if over_gains:
        ours += f"; {over_gains} N·s/m" + (f", {beyond} beyond {shown(most)}" if beyond else "")
    return verdict_over(
        {name: within(value, target, NEAR_DROP) for name, (value, target) in drops.items()}, ours
    )


def _drop(value: float, most: float) -> str:
    return f"{shown(value)} N·s/m" if math.isfinite(value) else f"beyond {shown(most)} N·s/m"


def near_table(ours: Mapping[str, float], paper: Mapping[str, float]) -> bool:
    """Whether every number is within `NEAR_WIDTH` of the paper's."""
    return all(within(ours[name], paper[name], NEAR_WIDTH) for name in paper)


def both_fit(by_band: Mapping[float, tuple[bool, bool]], said: str) -> Finding:
    """Whether some upper edge of the band gives both widths and fidelity of Table I."""
    fits = {f"a band up to {high:g} Hz": widths and errors for high, (widths, errors) in by_band.items()}
    return verdict_over(fits, said) if any(fits.values()) else Finding(status=Status.NOT, ours=said)


def wider(ratios: Mapping[str, float]) -> Finding:
    """Simulated widths over the paper's measured ones, by estimator."""
    ours = "; ".join(f"{name} × {shown(value)}" for name, value in ratios.items())
    return verdict_over({name: value >= WIDER for name, value in ratios.items()}, ours)


def controlled(found: Mapping[str, float], must: float, unit: str) -> Finding:
    """Numbers that theory fixes."""
    ours = "; ".join(f"{name} {shown(value, 4)}" for name, value in found.items())
    cases = {name: within(value, must, 1.0 + SAME_CONTROL) for name, value in found.items()}
    return verdict_over(cases, f"{ours}; theory {shown(must, 4)} {unit}")


def lower(gains: Mapping[str, Sequence[float]]) -> Finding:
    """Share of the error that one estimator saves at common walls, by case and measurement; below zero it adds."""
    ours = "; ".join(
        f"{name} {100 * min(values):+.2g} to {100 * max(values):+.2g} %" for name, values in gains.items()
    )
    return verdict_over(
        {name: min(values) >= BETTER_COMMON for name, values in gains.items()}, f"saves {ours}"
    )


def traced(above: int, below: int, unseen: int, columns: int, said: str) -> Finding:
    """Dampings at which the boundary search ends on an island, below the edge, or never comes to."""
    wrong = above + below + unseen
    ours = f"{said}; of {columns} dampings {above} end on an island, {below} below the edge, {unseen} unseen"
    if wrong <= (1.0 - TRACED) * columns:
        return Finding(status=Status.REPRODUCED, ours=ours)
    if wrong < columns:
        return Finding(status=Status.ONLY_WITH, ours=ours, condition="maps without speckle")
    return Finding(status=Status.NOT, ours=ours)
