"""Rules for Chawda, Celik and O'Malley (2015), from the abstract alone.

They were committed before the first full run; that a prediction needs a rig with a best cut-off was added after a
coarse run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.papers.rules import Ruling, judge, judge_settable

CLEARLY = 1.1  # by what factor the widest Z-width exceeds those at the ends of the cut-offs: more than a rung
ERROR = 0.2  # of every parameter of an identified model


def exists(areas: Mapping[tuple[str, ...], Sequence[float]]) -> Ruling:
    """Some cut-off between the lowest and the highest gives clearly the widest Z-width.

    `areas` of the Z-width over the cut-offs, by encoder and criterion; an encoder can be chosen.
    """
    held = {case: inside(of) for case, of in areas.items()}
    return judge_settable(held, [0], gains=[(", ".join(case), gain(of)) for case, of in areas.items()])


def predicts(areas: Sequence[float], models: Mapping[str, Sequence[float]]) -> Ruling:
    """The best cut-off of each model that misses the rig by `ERROR` is that of the rig, or its neighbour.

    `areas` of the Z-width over the cut-offs, of the rig and of each model. Where the rig has no best cut-off between
    the ends of the list, there is nothing to predict.
    """
    best = place_of_best(areas)
    near = {name: abs(place_of_best(of) - best) <= 1 for name, of in models.items()}
    return judge({"the rig has one": inside(areas), **near})


def gain(areas: Sequence[float]) -> float:
    """The widest Z-width over the wider of those at the ends; infinite when both are empty."""
    ends = max(areas[0], areas[-1])
    return max(areas) / ends if ends > 0.0 else float("inf")


def place_of_best(areas: Sequence[float]) -> int:
    """Place of the widest Z-width."""
    return max(range(len(areas)), key=areas.__getitem__)


def inside(areas: Sequence[float]) -> bool:
    """Whether the widest lies clearly between the ends."""
    return 0 < place_of_best(areas) < len(areas) - 1 and gain(areas) >= CLEARLY
