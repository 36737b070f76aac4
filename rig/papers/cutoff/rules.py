"""Rules for Chawda, Celik and O'Malley (2015), from the abstract alone; written before the first result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.papers.rules import Ruling, judge, judge_settable

CLEARLY = 1.1  # by what factor the widest Z-width exceeds those at the ends of the cut-offs: more than a rung
ERROR = 0.2  # of every parameter of an identified model


def exists(areas: Mapping[tuple[str, ...], Sequence[float]]) -> Ruling:
    """Some cut-off between the lowest and the highest gives clearly the widest Z-width.

    `areas` of the Z-width over the cut-offs, by encoder and criterion; an encoder can be chosen.
    """
    held = {case: _inside(of) for case, of in areas.items()}
    return judge_settable(held, [0], gains=[(", ".join(case), gain(of)) for case, of in areas.items()])


def predicts(best: int, found: Mapping[str, int]) -> Ruling:
    """The best cut-off of each model that misses the rig by `ERROR` is that of the rig, or its neighbour.

    `best` and `found` are places in the list of cut-offs.
    """
    return judge({name: abs(place - best) <= 1 for name, place in found.items()})


def gain(areas: Sequence[float]) -> float:
    """The widest Z-width over the wider of those at the ends; infinite when both are empty."""
    ends = max(areas[0], areas[-1])
    return max(areas) / ends if ends > 0.0 else float("inf")


def place_of_best(areas: Sequence[float]) -> int:
    """Place of the widest Z-width."""
    return max(range(len(areas)), key=areas.__getitem__)


def _inside(areas: Sequence[float]) -> bool:
    return 0 < place_of_best(areas) < len(areas) - 1 and gain(areas) >= CLEARLY
