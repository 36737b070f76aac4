"""Compare ladder, bisection and grid searches for the stiffness limit: what each would have found on one grid of hits.

A ladder tries rising stiffnesses up to the first failure. A bisection tries few of the stiffnesses and assumes that all
walls above a failure fail, so its result shows whether stability is monotone in K.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from rig.experiments.mapping.interface import TRUE, Passes, ZWidth, limit_of


@dataclass(frozen=True, slots=True)
class GridColumn:
    """Results of all walls at one damping and one encoder offset of a grid.

    Attributes
    ----------
    tried
        True if the wall of a stiffness (N·m/rad) passed; None if unknown.
    ladder, bisection, highest
        Largest stiffness (N·m/rad) that a search with rising stiffnesses up to the first failure would find, that a
        bisection would find, and of all stable walls; 0: no wall.
    islands
        Intervals of stable walls (N·m/rad) above a wall that fails.
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
    """Comparison of three searches (ladder, bisection, grid) for one sampling scheme and ripple criterion.

    Attributes
    ----------
    columns, islands, higher
        Number of columns (damping and encoder offset); number with stable walls above one that fails; number in which a
        bisection ends above the ladder (rising stiffnesses up to the first failure).
    damping_ladder, damping_grid
        Largest damping (N·m·s/rad) at which the ladder finds a wall, and at which any wall is stable.
    """

    scheme: str
    criterion: str
    columns: int
    islands: int
    higher: int
    damping_ladder: float
    damping_grid: float


def ways_of(found: ZWidth, key: str, scheme: int, criterion: str) -> Way:
    """Compare three searches (ladder, bisection, grid) for the sampling scheme with the index `scheme`."""
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
    """Return, for each damping, which walls are stable by one ripple (felt, heard, any), and what searches would find.

    `scheme` is the index of the sampling scheme. Without `offset`, the first encoder offset of the map is used.
    """
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
    walk = replace(found.plan.search, way="bisection").walk([criterion])
    visited: dict[float, Passes] = {}
    try:
        stiffness = next(walk)
        while True:
            visited[stiffness] = tried[stiffness]
            stiffness = walk.send({criterion: tried[stiffness]})
    except StopIteration:
        return visited
