"""Map the Z-width in the time domain: find by hits for which walls (K, B) a rig is stable with each sampling scheme.

`_maps`, `_zwidth_rig` and designs use this module. A map consists of independent *series*. A series has one sampling
scheme, damping, encoder offset and repeat, and searches the stiffness limit (`rig.experiments.mapping._searches`). Each
map has limits for all criteria (felt: velocity ripple; heard: effort ripple; any: also position ripple); its table has
the numbers of recorded and true signals. Source: Koul et al. 2013, section III and Fig. 6.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from rig import config
from rig.config import Experiment
from rig.config.schemes import Scheme, describe_cutoffs
from rig.control.judging import NUMBERS, UNITS
from rig.control.verdict import CRITERIA, INVALID, Measured, Objection, objections
from rig.core.errors import PlanError
from rig.core.present import Item, Row, Table, plain, written
from rig.core.sample import unit_of
from rig.core.shown import Drawn, Shown
from rig.experiments import sweep
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.experiments.mapping._rendering import RENDERED, rendered_share
from rig.experiments.mapping._searches import (
    Extent,
    Outcomes,
    StiffnessLimit,
    StiffnessSearch,
    check_values,
    drive,
    limit_of,
)
from rig.experiments.trials.plan import stands_for_device

Judged = Literal["true", "recorded"]
# Default distances of position zero from the edge of its encoder cell (counts).
OFFSETS = (0.1, 0.6)
TRUE = "_true"  # suffix of columns with the simulation's true values, as in recordings
# Reason for an invalid hit whose numbers contain no objection.
_BEFORE = "guard tripped before the wall"


@dataclass(frozen=True, slots=True)
class Series:
    """One stiffness search of a map: index of its scheme, damping (SI), encoder offset (counts), repeat number."""

    scheme: int
    damping: float
    offset: float
    repeat: int

    @property
    def key(self) -> str:
        """Return the unique name of this stiffness search in the file of finished searches."""
        return f"{self.scheme}/{self.damping!r}/{self.offset!r}/{self.repeat}"


@dataclass(frozen=True, kw_only=True)  # without slots: `tasks` is cached
class MapPlan:
    """A plan of a map of stable walls, found by hits.

    Attributes
    ----------
    experiment
        Rig, trial and thresholds; the map of stable walls varies its controller and its wall's stiffness and damping.
    schemes
        Sampling schemes, one curve each.
    dampings
        Dampings of the walls (N·m·s/rad or N·s/m).
    search
        Range of stiffnesses, and the method of the search.
    offsets
        Distances of position zero from the lower edge of its encoder cell (counts, 0 to below 1), which influence if a
        stiff wall vibrates.
    repeats
        Number of series (stiffness searches) for each scheme, damping and encoder offset; they differ in the exact
        start and in a hand's tremor.
    judged
        Signals that are judged: ``"recorded"``, as for a single hit, or ``"true"``, the truth of the simulation.
    criteria
        Criteria for each of which a limit is searched, with additional hits: "felt", "heard", "any" ripple.
    """

    experiment: Experiment
    schemes: tuple[Scheme, ...]
    dampings: tuple[float, ...]
    search: StiffnessSearch
    offsets: tuple[float, ...] = OFFSETS
    repeats: int = 1
    judged: Judged = "recorded"
    criteria: tuple[str, ...] = CRITERIA

    unit: ClassVar[str] = "ticks"

    def __post_init__(self) -> None:
        """Raise `PlanError` if schemes, dampings or offsets are empty, repeated or invalid, or `repeats` is below 1."""
        check_values("schemes", [scheme.text for scheme in self.schemes], "scheme")
        check_values("dampings", self.dampings, "damping")
        check_values("offsets", self.offsets, "offsets", below=1.0)
        if self.repeats < 1:
            raise PlanError(f"`repeats` = {self.repeats} must be at least 1", remedy="give 1 or more")

    def series(self) -> list[Series]:
        """Return all stiffness searches of the map, sorted by sampling scheme, damping, encoder offset and repeat."""
        return [
            Series(number, damping, offset, repeat)
            for number in range(len(self.schemes))
            for damping in self.dampings
            for offset in self.offsets
            for repeat in range(self.repeats)
        ]

    def experiment_of(self, series: Series, under: Experiment | None = None) -> Experiment:
        """Return the experiment of one stiffness search (`series`) of the map; the wall's stiffness is not set.

        `under` is the plan's experiment with the sampling scheme of the series already applied; None: apply it here.
        """
        changes = {
            "rig.encoder.offset": series.offset,
            "trial.seed": self.experiment.trial.seed + series.repeat,
            "wall.damping": series.damping,
        }
        applied = self.schemes[series.scheme].applied(self.experiment) if under is None else under
        return config.override(applied, changes, "the map")

    @cached_property
    def tasks(self) -> list[sweep.Task]:
        """Return a function call for each stiffness search; raise `ConfigError` if an experiment is invalid."""
        applied = [scheme.applied(self.experiment) for scheme in self.schemes]
        return [
            sweep.Task(
                series.key,
                run_series,
                {
                    "experiment": config.as_mapping(self.experiment_of(series, applied[series.scheme])),
                    "search": asdict(self.search),
                    "judged": self.judged,
                    "criteria": list(self.criteria),
                },
                weight=float(self.schemes[series.scheme].position_rate),
            )
            for series in self.series()
        ]

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan of the map of walls as JSON values by name, from which `from_mapping` restores the plan."""
        own = {"search": asdict(self.search), "schemes": [scheme.text for scheme in self.schemes]}
        named = {
            name: getattr(self, name) for name in ("dampings", "offsets", "repeats", "judged", "criteria")
        }
        return {**plain(named), **own, "experiment": config.as_mapping(self.experiment)}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> MapPlan:
        """Return the plan of a map of walls from JSON values; `where` names their source in error messages."""
        return cls(
            experiment=config.experiment_from_mapping(mapping["experiment"], where),
            schemes=tuple(Scheme.parse(text) for text in mapping["schemes"]),
            dampings=tuple(mapping["dampings"]),
            search=StiffnessSearch(**mapping["search"]),
            offsets=tuple(mapping["offsets"]),
            repeats=mapping["repeats"],
            judged=mapping["judged"],
            criteria=tuple(mapping["criteria"]),
        )

    def found(self, results: Sequence[Any]) -> ZWidth:
        """Return the map of stable walls, computed from the hits of all searches in the order of `tasks`."""
        return ZWidth.of(self, results)


def run_series(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Simulate the hits of one stiffness search; return the measured results of each hit, as JSON values."""
    # The result depends on the payload only, so that a map is equal to the last bit on one core, on many cores and on a
    # cluster, and a stopped map can resume.
    experiment = config.restore_experiment(payload["experiment"])
    simulator = HitSimulator(experiment)
    rows: list[dict[str, Any]] = []

    def hit(stiffness: float) -> Outcomes:
        done = simulator.hit(stiffness, experiment.wall.damping)
        rows.append({"stiffness": stiffness} | row_of(done.recorded, "") | row_of(done.true, TRUE))
        return outcomes_of(rows[-1], payload["judged"])

    drive(StiffnessSearch(**payload["search"]).walk(payload["criteria"]), hit)
    return rows


@dataclass(frozen=True, slots=True)
class Boundary:
    """Stiffness limit of one sampling scheme at one damping by one ripple criterion, over encoder offsets and repeats.

    Attributes
    ----------
    stiffness, deviation
        Mean and standard deviation of the limits of all series (stiffness searches; N·m/rad or N/m). A limit of 0 is
        included; the deviation of a single limit is 0.
    lowest, highest
        Lowest and highest limit of the series (N·m/rad or N/m).
    capped
        Number of series that ended before a wall failed: if above 0, the mean is a lower bound.
    unknown
        Number of invalid hits.
    limits
        Limit of each series.
    rendered
        Fraction of the damping that remains below the effort limit in slow motion (0 to 1).
    """

    scheme: int
    damping: float
    criterion: str
    stiffness: float
    deviation: float
    lowest: float
    highest: float
    capped: int
    unknown: int
    limits: tuple[StiffnessLimit, ...]
    rendered: float = 1.0

    @property
    def counted(self) -> float:
        """Return the stiffness limit (N·m/rad or N/m); 0 if the effort limit cuts more than 20 % of the damping."""
        return self.stiffness if self.rendered >= RENDERED else 0.0

    @classmethod
    def of(
        cls,
        scheme: int,
        damping: float,
        criterion: str,
        limits: Sequence[StiffnessLimit],
        *,
        rendered: float = 1.0,
    ) -> Boundary:
        """Return mean and scatter of the stiffness limits of one sampling scheme, damping and ripple criterion."""
        stiffness = np.array([limit.stiffness for limit in limits])
        return cls(
            scheme=scheme,
            damping=damping,
            criterion=criterion,
            stiffness=float(stiffness.mean()),
            deviation=float(stiffness.std(ddof=1)) if len(limits) > 1 else 0.0,
            lowest=float(stiffness.min()),
            highest=float(stiffness.max()),
            capped=sum(limit.capped for limit in limits),
            unknown=sum(limit.unknown for limit in limits),
            limits=tuple(limits),
            rendered=rendered,
        )


@dataclass(frozen=True, slots=True)
class Width:
    """Extent of a scheme's stable walls, without dampings of which the effort limit cuts more than 20 %.

    Attributes
    ----------
    stiffness_undamped
        Limit at B = 0 (N·m/rad or N/m); None if the map does not include B = 0, 0 if no wall passed at B = 0.
    stiffness_peak, damping_at_peak
        Largest limit (N·m/rad or N/m), and its damping (N·m·s/rad or N·s/m).
    damping_range
        Largest damping at which a wall passes (N·m·s/rad or N·s/m).
    area
        Area under the curve, up to `damping_range`.
    capped, undamped_capped, range_capped
        True if peak, limit at B = 0, and range are only lower bounds, because the search or the map ended before a wall
        failed.
    holes
        Dampings below `damping_range` at which no wall passed; the area is then a lower bound.
    not_rendered
        Dampings that were left out because the effort limit cuts more than 20 % of them.
    lowest
        Lowest stiffness that was tried (N·m/rad or N/m); if no wall passed, the limit is below this stiffness.
    """

    stiffness_undamped: float | None
    stiffness_peak: float
    damping_at_peak: float
    damping_range: float
    area: float
    capped: bool
    undamped_capped: bool
    range_capped: bool
    holes: tuple[float, ...]
    not_rendered: tuple[float, ...]
    lowest: float


@dataclass(frozen=True, slots=True, repr=False)
class ZWidth(Shown, Drawn):
    """A finished map of stable walls: its plan, its stiffness limits, and the outcome and numbers of all hits."""

    table_name: ClassVar[str] = "hits.parquet"

    plan: MapPlan
    boundaries: tuple[Boundary, ...]
    hits: int
    series: Sequence[list[dict[str, Any]]]  # rows of `run_series`, in the order of `MapPlan.series`
    on_device: bool = False  # every hit ran over a link

    @property
    def cutoffs(self) -> str | None:
        """Return a sentence if schemes that state no filter cut-off get different default cut-offs; else None."""
        return describe_cutoffs(self.plan.schemes, self.plan.experiment)

    @property
    def of_device_loop(self) -> bool:
        """Return True if the host's control law was simulated although the experiment runs the law on the device."""
        return self.plan.experiment.controller.loop == "device" and not self.on_device

    @classmethod
    def of(cls, plan: MapPlan, series: Sequence[list[dict[str, Any]]], *, on_device: bool = False) -> ZWidth:
        """Return the map of stable walls, with limits computed from the hits of all stiffness searches (`series`)."""
        limits: dict[tuple[int, float, str], list[StiffnessLimit]] = {}
        hits = 0
        applied = [scheme.applied(plan.experiment) for scheme in plan.schemes]
        for one, rows in zip(plan.series(), series, strict=True):
            hits += len(rows)
            for criterion in plan.criteria:
                column = (one.scheme, one.damping, criterion)
                limits.setdefault(column, []).append(limit_of(_collect_tried(rows, criterion, plan.judged)))
        boundaries = tuple(
            Boundary.of(*column, found, rendered=rendered_share(applied[column[0]], column[1]))
            for column, found in limits.items()
        )
        return cls(plan, boundaries, hits, series, on_device)

    def curve(self, scheme: int, criterion: str) -> list[Boundary]:
        """Return a scheme's stiffness limits by ascending damping, for the ripple `criterion` (felt, heard, any)."""
        found = [b for b in self.boundaries if (b.scheme, b.criterion) == (scheme, criterion)]
        return sorted(found, key=lambda boundary: boundary.damping)

    def width(self, scheme: int, criterion: str) -> Width:
        """Return the extent of a scheme's stable walls (peak K, range of B) for a ripple (felt, heard, any)."""
        curve = self.curve(scheme, criterion)
        peak = max(curve, key=lambda boundary: boundary.counted)
        extent = Extent.of([b.damping for b in curve], [b.counted for b in curve])
        dropped = tuple(b.damping for b in curve if b.rendered < RENDERED)
        return Width(
            stiffness_undamped=curve[0].stiffness if curve[0].damping == 0.0 else None,
            stiffness_peak=peak.counted,
            damping_at_peak=peak.damping,
            damping_range=extent.damping,
            area=extent.area,
            capped=any(b.capped for b in curve if b.rendered >= RENDERED),
            undamped_capped=curve[0].damping == 0.0 and curve[0].capped > 0,
            range_capped=curve[-1].counted > 0.0,
            holes=tuple(b for b in extent.holes if b not in dropped),
            not_rendered=dropped,
            lowest=self.plan.search.lowest,
        )

    def invalid(self) -> dict[str, int]:
        """Return the number of invalid hits for each reason, the most common reason first."""
        limits, why = config.verdict_thresholds(self.plan.experiment), Counter[str]()
        suffix, column = TRUE if self.plan.judged == "true" else "", _passes("any", self.plan.judged)
        for rows in self.series:
            for row in rows:
                if row[column] is None:
                    numbers: Any = {name: row[name + suffix] for name in NUMBERS.names or ()}
                    found = Objection(int(objections(numbers, limits))) & INVALID
                    why.update([str(reason.name).lower().replace("_", " ") for reason in found] or [_BEFORE])
        return dict(why.most_common())

    def brief(self) -> list[Item]:
        """Return the lines of a short report: largest stiffness and damping of each sampling scheme's stable walls."""
        experiment = self.plan.experiment
        stiffness, damping = (unit_of(name, experiment.rig.motion) for name in ("stiffness", "damping"))
        rows = []
        for number, scheme in enumerate(self.plan.schemes):
            width = self.width(number, "any")
            least, beyond = ("≥ " if capped else "" for capped in (width.capped, width.range_capped))
            peak = f"K up to {least}{written(width.stiffness_peak)} {stiffness}"
            text = f"{peak}, B up to {beyond}{written(width.damping_range)} {damping}"
            rows.append(Row(scheme.label(experiment), text))
        notes = [] if self.cutoffs is None else [self.cutoffs]
        by = "; judged by the simulation's truth" if self.plan.judged == "true" else ""
        return [
            f"Z-width of {experiment.rig.name}: {self.hits} hits, neither felt, heard nor moved{by}",
            *rows,
            *notes,
        ]

    def detailed(self) -> list[Item]:
        """Return a full report: the short report, and a table of each sampling scheme's limit at each damping."""
        experiment = self.plan.experiment
        stiffness, damping = (unit_of(name, experiment.rig.motion) for name in ("stiffness", "damping"))
        curves = [self.curve(number, "any") for number in range(len(self.plan.schemes))]
        labels = (scheme.label(experiment) for scheme in self.plan.schemes)
        head = (f"B ({damping})", *(f"K ({stiffness}), {label}" for label in labels))
        rows = [[limits[0].damping, *(b.stiffness for b in limits)] for limits in zip(*curves, strict=True)]
        return [*self.brief(), Table(head, rows, words=0)]

    def table(self) -> Iterator[dict[str, Any]]:
        """Yield a row for each hit: scheme, damping, encoder offset, repeat, stiffness, verdicts and all numbers."""
        for one, rows in zip(self.plan.series(), self.series, strict=True):
            of_series = asdict(one) | {"scheme": self.plan.schemes[one.scheme].text}
            for row in rows:
                yield of_series | row

    def units(self) -> dict[str, str]:
        """Return the unit of each column of the table by name, without the columns that have no unit."""
        quantities: dict[str, Any] = {"damping": "damping", "stiffness": "stiffness", "offset": "count"}
        for name, quantity in UNITS.items():
            quantities[name] = quantities[name + TRUE] = quantity
        return {
            name: unit_of(quantity, self.plan.experiment.rig.motion) for name, quantity in quantities.items()
        }

    def as_mapping(self) -> dict[str, Any]:
        """Return plan, limits and extents of the stable walls as JSON values by name, without the single hits."""
        plan = self.plan
        labels = [scheme.label(plan.experiment) for scheme in plan.schemes]
        return {
            "rig": plan.experiment.rig.name,
            "motion": plan.experiment.rig.motion,
            "trial": plan.experiment.trial.kind,
            "schemes": [
                {
                    "scheme": scheme.text,
                    "label": labels[number],
                    "widths": {name: plain(self.width(number, name)) for name in plan.criteria},
                    "curves": {name: plain(self.curve(number, name)) for name in plan.criteria},
                }
                for number, scheme in enumerate(plan.schemes)
            ],
            "search": asdict(plan.search),
            "offsets": list(plan.offsets),
            "repeats": plan.repeats,
            "judged": plan.judged,
            "hits": self.hits,
            "invalid": self.invalid(),
            "cutoffs": self.cutoffs,
            "note": stands_for_device(self.plan.experiment) if self.of_device_loop else None,
            "experiment": config.as_mapping(plan.experiment),
        }


def row_of(measured: Measured, suffix: str) -> dict[str, Any]:
    """Return the columns of a hit by name: kind of verdict, whether each ripple criterion passed, all numbers.

    `suffix` is appended to each name: "" for recorded signals, `TRUE` for true signals.
    """
    passes = (measured.passes(criterion) for criterion in CRITERIA)
    return dict(zip(_columns(suffix), (str(measured.kind), *passes, *measured.numbers.item()), strict=True))


def outcomes_of(row: Mapping[str, Any], judged: Judged) -> Outcomes:
    """Return by ripple criterion (felt, heard, any) if the hit in `row` passed: True, False, or None if invalid."""
    return {criterion: row[_passes(criterion, judged)] for criterion in CRITERIA}


@cache
def _columns(suffix: str) -> tuple[str, ...]:
    names = ("kind", *(f"passes_{criterion}" for criterion in CRITERIA), *(NUMBERS.names or ()))
    return tuple(name + suffix for name in names)


def _passes(criterion: str, judged: Judged) -> str:
    return f"passes_{criterion}" + (TRUE if judged == "true" else "")


def _collect_tried(
    rows: Iterable[Mapping[str, Any]], criterion: str, judged: Judged
) -> dict[float, bool | None]:
    column = _passes(criterion, judged)
    return {row["stiffness"]: row[column] for row in rows}
