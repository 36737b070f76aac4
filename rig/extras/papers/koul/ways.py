"""Ladder, bisection and grid through the same walls: what each would have answered, from the hits of one grid.

A ladder is the part of a grid below its first failure. A bisection visits few of the rungs and assumes that
everything above a failure fails, so where it ends shows whether stability was monotone in K.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rig.experiments.mapping.interface import TRUE, Passes, ZWidth, limit_of


@dataclass(frozen=True, slots=True)
class GridColumn:
    """One damping at one encoder offset of a grid.

    Attributes
    ----------
    tried
        Whether the wall of each stiffness passed.
    ladder, bisection, highest
        Where a ladder and a bisection end, and the stiffest stable wall of all (N·m/rad; 0 for none).
    islands
        Stiffer stable walls beyond one that fails.
    """

    damping: float
    offset: float
    tried: Mapping[float, Passes]
    ladder: float
    bisection: float
    highest: float
    islands: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Way:
    """How ladder, bisection and grid differ over the columns of one scheme under one criterion.

    Attributes
    ----------
    columns, islands, higher
        How many columns; in how many of them stiffer walls are stable beyond one that fails, and in how many a
        bisection ends above the ladder.
    damping_ladder, damping_grid
        Largest damping at which the ladder finds a wall, and at which any wall is stable.
    """

    scheme: str
    criterion: str
    columns: int
    islands: int
    higher: int
    damping_ladder: float
    damping_grid: float


def ways_of(found: ZWidth, key: str, scheme: int, criterion: str) -> Way:
    """Compare the ways over all offsets of a grid."""
    every = [
        column for offset in found.plan.offsets for column in columns(found, scheme, criterion, offset=offset)
    ]
    return Way(
        scheme=key,
        criterion=criterion,
        columns=len(every),
        islands=sum(bool(column.islands) for column in every),
        higher=sum(column.bisection > column.ladder for column in every),
        damping_ladder=max((column.damping for column in every if column.ladder > 0.0), default=0.0),
        damping_grid=max((column.damping for column in every if column.highest > 0.0), default=0.0),
    )


def columns(found: ZWidth, scheme: int, criterion: str, *, offset: float | None = None) -> list[GridColumn]:
    """Columns of a grid of one scheme under one criterion, by damping, at the first encoder offset or at this one."""
    plan = found.plan
    wanted = plan.offsets[0] if offset is None else offset
    made = []
    for one, rows in zip(plan.series(), found.series, strict=True):
        if (one.scheme, one.offset, one.repeat) != (scheme, wanted, 0):
            continue
        tried = {row["stiffness"]: row[f"passes_{criterion}{TRUE}"] for row in rows}
        limit = limit_of(tried)
        walked = _bisect(found, tried, criterion)
        made.append(
            GridColumn(
                damping=one.damping,
                offset=wanted,
                tried=tried,
                ladder=limit.stiffness,
                bisection=limit_of(walked).stiffness,
                highest=max((k for k, passes in tried.items() if passes), default=0.0),
                islands=limit.islands,
            )
        )
    return made


def _bisect(found: ZWidth, tried: Mapping[float, Passes], criterion: str) -> dict[float, Passes]:
    """Return the rungs that a bisection would have visited."""
    walk = replace(found.plan.search, way="bisection").walk([criterion])
    visited: dict[float, Passes] = {}
    try:
        stiffness = next(walk)
        while True:
            visited[stiffness] = tried[stiffness]
            stiffness = walk.send({criterion: tried[stiffness]})
    except StopIteration:
        return visited
