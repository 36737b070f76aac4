"""Compare linear theory and hits for all walls of a map: where they differ, why, and on which share of the K–B plane.

Theory (`rig.analysis.theory`) calls a wall stable if the spectral radius of the linear loop is below one. Hits call a
wall stable if at every encoder offset and repeat of the map it is not unstable and has no velocity, effort or position
ripple above the limits. A wall *differs* if only one of both calls it stable; `rig.extras.papers.disagreement.ablation`
finds the cause. A wall whose hits are invalid is left out and counted.

Shares are areas of the K–B plane with linear axes. The cell of a wall ends half-way to its neighbours (in K by ratio),
within the map's range. Walls are all stiffnesses of the map's search at all its dampings, also above the first failure.
As a check, every wall is also hit without all four non-linearities: a remaining difference has another cause than a
non-linearity of the rig.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.theory import linear_loop
from rig.config import Experiment
from rig.core.errors import PlanError
from rig.core.present import Item, Row, Table, plain, reported
from rig.core.sample import unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments import sweep
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import MapPlan, Series, check_values
from rig.experiments.trials.results import make_directory
from rig.extras.papers.disagreement.ablation import CAUSES, Cure, Holds, cause_of, hit_column

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)  # without slots: `tasks` is cached
class DisagreementPlan:
    """Plan of a computation that hits all walls of a map, and again the walls that linear theory judges differently."""

    map: MapPlan

    unit: ClassVar[str] = "ticks"

    @property
    def experiment(self) -> Experiment:
        """The experiment (rig, controller, trial) whose walls are hit."""
        return self.map.experiment

    def _check(self) -> None:
        wall = self.experiment.wall
        for key, value, linear in (
            ("law", wall.law, "spring-damper"),
            ("damping_on", wall.damping_on, "both"),
        ):
            if value != linear:
                raise PlanError(
                    f"wall.{key} = {value!r} is not covered by linear theory",
                    remedy=f"set wall.{key} = {linear!r}",
                )
        check_values("dampings", self.map.dampings, "damping", rising=True)
        for scheme in self.map.schemes:
            linear_loop(self.experiment, scheme)

    @cached_property
    def tasks(self) -> list[sweep.Task]:
        """Tasks of the computation, one for each sampling scheme and damping of the map.

        Raises `PlanError` for a wall that linear theory does not cover, `NotLinearError` for a non-linear scheme.
        """
        self._check()
        columns: dict[tuple[int, float], list[Series]] = {}
        for one in self.map.series():
            columns.setdefault((one.scheme, one.damping), []).append(one)
        applied = [scheme.applied(self.experiment) for scheme in self.map.schemes]
        return [
            sweep.Task(
                f"{scheme}/{damping!r}",
                hit_column,
                {
                    "experiments": [
                        config.as_mapping(self.map.experiment_of(one, applied[scheme])) for one in series
                    ],
                    "search": asdict(self.map.search),
                    "judged": self.map.judged,
                },
                weight=float(self.map.schemes[scheme].position_rate),
            )
            for (scheme, damping), series in columns.items()
        ]

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan of the map as lists and numbers, for JSON."""
        return self.map.as_mapping()

    def found(self, results: Sequence[Any]) -> Disagreement:
        """Compare linear theory and simulated hits for all walls, from the results of all tasks in their order."""
        plan = self.map
        columns = [(scheme, damping) for scheme in range(len(plan.schemes)) for damping in plan.dampings]
        across = dict(zip(plan.dampings, np.diff(edges_of(plan.dampings)).tolist(), strict=True))
        along = np.diff(edges_of(plan.search.rungs, by_ratio=True)).tolist()
        return Disagreement(
            plan,
            tuple(
                ComparedWall.of(row, scheme, damping, across[damping] * height)
                for (scheme, damping), rows in zip(columns, results, strict=True)
                for row, height in zip(rows, along, strict=True)
            ),
            hits=sum(row["hits"] for rows in results for row in rows),
        )


def edges_of(values: Sequence[float], *, by_ratio: bool = False) -> Floats:
    """Return the n + 1 edges of cells around n rising values: the ends, and the middles between neighbours.

    The middle is the geometric mean if `by_ratio` is True. The cell of a single value is 1 wide.
    """
    if len(values) == 1:
        return values[0] + np.array([-0.5, 0.5])
    at = np.asarray(values)
    # Each wall stands for the cell about it, half-way to its neighbours, in K by ratio; within the map's range.
    between = np.sqrt(at[1:] * at[:-1]) if by_ratio else 0.5 * (at[1:] + at[:-1])
    return np.concatenate([at[:1], between, at[-1:]])


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedWall:
    """One wall: result of theory, result of the hits, and the cause if they differ.

    Attributes
    ----------
    scheme, damping, stiffness
        Index of the sampling scheme in the map, damping B and stiffness K (SI units).
    area
        Area of the wall's cell in the K–B plane (product of the units of K and B).
    radius
        Spectral radius of the linear loop; below 1 the loop is stable.
    holds
        True if the hits call the wall stable; None if a hit is invalid.
    holds_without
        True if a hit on the rig without all four non-linearities calls the wall stable.
    cures
        Smallest sets whose removal makes theory and hits agree; empty if they agree anyway, or if no set does.
    cause
        One of `rig.extras.papers.disagreement.ablation.CAUSES`; empty where theory and hits agree or a hit is invalid.
    """

    scheme: int
    damping: float
    stiffness: float
    area: float
    radius: float
    holds: Holds
    holds_without: Holds
    cures: tuple[Cure, ...]
    cause: str

    @classmethod
    def of(cls, row: Mapping[str, Any], scheme: int, damping: float, area: float) -> ComparedWall:
        """Build a wall from a dict of `rig.extras.papers.disagreement.ablation.hit_column`."""
        found = None if row["cures"] is None else tuple(tuple(cure) for cure in row["cures"])
        return cls(
            scheme=scheme,
            damping=damping,
            stiffness=row["stiffness"],
            area=area,
            radius=row["radius"],
            holds=row["holds"],
            holds_without=row["holds_without"],
            cures=found or (),
            cause="" if found is None else cause_of(found),
        )

    @property
    def linear(self) -> bool:
        """True if linear theory calls the wall stable."""
        return self.radius < 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseShare:
    """Share (0 to 1) of an area where theory and simulated hits differ, and that of each cause in it, largest first."""

    share: float
    causes: dict[str, float]

    @classmethod
    def of(cls, whole: Sequence[ComparedWall]) -> CauseShare:
        """Compute, for the walls `whole`, the share of their area where theory and hits differ, and the causes."""
        differing = [wall for wall in whole if wall.cause]
        return cls(share=_share(differing, whole), causes=_shares_by(differing, lambda wall: wall.cause))


@dataclass(frozen=True, slots=True, kw_only=True)
class Shares:
    """Agreement of theory and simulated hits for one sampling scheme, as shares of areas of the K–B plane (0 to 1).

    Attributes
    ----------
    differ
        Differing walls, as a share of the plane.
    fails
        Walls that fail by hits, as a share of the walls that theory calls stable.
    beyond
        Walls that theory calls unstable, as a share of the walls that are stable by hits.
    sets
        Walls with several cures (removals that end the difference), as a share of the differing area, by combination.
    differ_without
        Walls that differ on the rig without all four non-linearities, as a share of the plane.
    stable, holding
        Walls that are stable by theory, and walls that are stable by hits, as shares of the plane.
    """

    scheme: str
    label: str
    differ: CauseShare
    fails: CauseShare
    beyond: CauseShare
    sets: dict[str, float]
    differ_without: float
    stable: float
    holding: float


@dataclass(frozen=True, slots=True, repr=False)
class Disagreement(Shown, Drawn):
    """Comparison of linear theory and simulated hits, wall by wall.

    `plan` is the map whose walls were hit, `walls` are sorted by scheme, damping and stiffness, `hits` is the number of
    hits, also of those on rigs without some non-linearities.
    """

    table_name: ClassVar[str] = "walls.parquet"

    plan: MapPlan
    walls: tuple[ComparedWall, ...]
    hits: int

    def of_scheme(self, number: int) -> list[ComparedWall]:
        """Return the compared walls of the sampling scheme with this index."""
        return [wall for wall in self.walls if wall.scheme == number]

    def shares(self, number: int) -> Shares:
        """Return, for one scheme, where only theory or only hits call a wall stable, as shares of the K–B plane."""
        scheme = self.plan.schemes[number]
        known = [wall for wall in self.of_scheme(number) if wall.holds is not None]
        differing = [wall for wall in known if wall.cause]
        stable, holding = [wall for wall in known if wall.linear], [wall for wall in known if wall.holds]
        return Shares(
            scheme=scheme.text,
            label=scheme.label(self.plan.experiment),
            differ=CauseShare.of(known),
            fails=CauseShare.of(stable),
            beyond=CauseShare.of(holding),
            sets=_shares_by([wall for wall in differing if len(wall.cures) > 1], _join_sets, of=differing),
            differ_without=_share([wall for wall in known if wall.holds_without is (not wall.linear)], known),
            stable=_share(stable, known),
            holding=_share(holding, known),
        )

    @reported
    def schemes(self) -> tuple[Shares, ...]:
        """Where only theory or only hits call a wall stable, as shares of the K–B plane, for each sampling scheme."""
        return tuple(self.shares(number) for number in range(len(self.plan.schemes)))

    @reported
    def unknown(self) -> int:
        """Number of walls that are left out because a simulated hit on them is invalid."""
        return sum(wall.holds is None for wall in self.walls)

    def brief(self) -> list[Item]:
        """Return a heading, and for each sampling scheme the differing share of the K–B plane with its causes."""
        rows = [
            Row(
                shares.label,
                f"{_percent(shares.differ.share)} of the plane{_phrase_causes(shares.differ.causes)}",
            )
            for shares in self.schemes
        ]
        rig = self.plan.experiment.rig.name
        return [
            f"where linear theory and {self.hits} hits differ on {rig}, in {len(self.walls)} walls",
            *rows,
        ]

    def detailed(self) -> list[Item]:
        """Return a heading and a table: where theory and simulated hits differ, as shares of the K–B plane."""
        head = ("scheme", "what differs", "share", *CAUSES)
        rows = [
            ["" if number else shares.label, what, _percent(part.share), *_cells(part)]
            for shares in self.schemes
            for number, (what, part) in enumerate(
                (
                    ("of the plane", shares.differ),
                    ("stable in theory, fails", shares.fails),
                    ("holds, not in theory", shares.beyond),
                )
            )
        ]
        return [self.brief()[0], Table(head, rows, words=2)]

    def table(self) -> Iterator[dict[str, Any]]:
        """Yield a dict for every wall, a row of the table file."""
        for wall in self.walls:
            row = asdict(wall) | {"scheme": self.plan.schemes[wall.scheme].text}
            yield row | {"linear": wall.linear, "cures": _join_sets(wall)}

    def units(self) -> dict[str, str]:
        """Return the units of the table's columns ``stiffness`` and ``damping``."""
        motion = self.plan.experiment.rig.motion
        return {name: unit_of(name, motion) for name in ("stiffness", "damping")}

    def as_mapping(self) -> dict[str, Any]:
        """Return settings and shares for JSON, without the results of single walls."""
        plan = self.plan
        return {
            "rig": plan.experiment.rig.name,
            "schemes": plain(self.schemes),
            "walls": len(self.walls),
            "unknown": self.unknown,
            "hits": self.hits,
            "dampings": list(plan.dampings),
            "search": asdict(plan.search),
            "offsets": list(plan.offsets),
            "repeats": plan.repeats,
            "judged": plan.judged,
            "experiment": config.as_mapping(plan.experiment),
        }


def _share(part: Iterable[ComparedWall], whole: Iterable[ComparedWall]) -> float:
    area = sum(wall.area for wall in whole)
    return sum(wall.area for wall in part) / area if area else 0.0


def _shares_by(
    walls: Sequence[ComparedWall],
    name: Callable[[ComparedWall], str],
    of: Sequence[ComparedWall] | None = None,
) -> dict[str, float]:
    """Sum areas of walls by `name(wall)`; return each as a share of the area of `of` (None: `walls`), largest first."""
    areas: dict[str, float] = {}
    for wall in walls:
        areas[name(wall)] = areas.get(name(wall), 0.0) + wall.area
    whole = sum(wall.area for wall in (walls if of is None else of))
    return {what: areas[what] / whole for what in sorted(areas, key=lambda what: -areas[what])}


def _join_sets(wall: ComparedWall) -> str:
    return "; ".join("+".join(cure) for cure in wall.cures)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def _cells(part: CauseShare) -> list[str]:
    return [_percent(part.causes[cause]) if cause in part.causes else "" for cause in CAUSES]


def _phrase_causes(causes: Mapping[str, float]) -> str:
    parts = ", ".join(f"{cause} {_percent(share)}" for cause, share in causes.items())
    return f": {parts}" if parts else ""


def compare_into(
    plan: DisagreementPlan,
    directory: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> Disagreement:
    """Compare theory and hits; write the table of walls and the summary into `directory`.

    A stopped comparison resumes from the journal (finished results) in this directory.
    """
    # Without a plan file, which `maps.map_into` would write, programs do not show the directory as a map.
    make_directory(directory)
    found = maps.zwidth(
        plan, journal=directory / maps.JOURNAL, scheduler=scheduler, workers=workers, watch=watch
    )
    maps.write_map(found, directory)
    return found
