"""Z-width in the time domain: for which walls (K, B) a rig stays stable, scheme by scheme, by hitting them.

A map is a set of independent *climbs*: one scheme, one damping, one encoder offset, one repeat, and a search through
the stiffnesses (`rig.experiments.ladder`). A climb is decided by its description alone, so a map is the same to the
last bit on one core, on many, or on a cluster, and a stopped one goes on where it was.

A wall fails under a criterion when its hit is unstable, or when what the criterion names (felt, heard, any) exceeds its
threshold; every map holds all three. In simulation the truth decides unless the recorded signals are asked for; the
table has the numbers of both.

Source: Koul et al. 2013, section III (K raised until unstable, five repeats averaged) and Fig. 6.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rig import config
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.control.measure import NUMBERS
from rig.control.verdict import CRITERIA, INVALID, Measured, Objection, objections
from rig.core.errors import PlanError
from rig.experiments import sweep
from rig.experiments.hit_simulator import HitSimulator
from rig.experiments.ladder import Limit, Outcomes, Search, limit_of
from rig.experiments.plan import STANDS_FOR_DEVICE

Judged = Literal["true", "recorded"]
TRUE = "_true"  # how columns of the simulation's truth end, as in recordings
_BEFORE = "guard tripped before the wall"  # what the numbers of a hit do not show


@dataclass(frozen=True, slots=True)
class Climb:
    """One search through the stiffnesses: number of its scheme, damping, encoder offset, number of the repeat."""

    scheme: int
    damping: float
    offset: float
    repeat: int

    @property
    def key(self) -> str:
        """Its name in a journal."""
        return f"{self.scheme}/{self.damping!r}/{self.offset!r}/{self.repeat}"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPlan:
    """What to map.

    Attributes
    ----------
    experiment
        Rig, trial and thresholds; its controller and its wall's K and B are what the map varies.
    schemes
        One curve each.
    dampings
        B of each column of walls (N·m·s/rad or N·s/m).
    search
        Stiffnesses and the way through them.
    offsets
        Where position zero lies in its encoder cell (count): one count decides whether a stiff wall buzzes.
    repeats
        Climbs of each damping and offset; they differ in where exactly the handle starts, and in a hand's tremor.
    judged
        Whose signals decide: the simulation's truth, or what a rig records.
    """

    experiment: Experiment
    schemes: tuple[Scheme, ...]
    dampings: tuple[float, ...]
    search: Search
    offsets: tuple[float, ...] = (0.1, 0.6)
    repeats: int = 1
    judged: Judged = "true"

    def __post_init__(self) -> None:
        """Raise `PlanError` for a map without climbs, or with the same one twice."""
        _check_values("schemes", [scheme.text for scheme in self.schemes], "--scheme")
        _check_values("dampings", self.dampings, "--damping", 0.0, math.inf)
        _check_values("offsets", self.offsets, "--offsets", 0.0, 1.0)
        if self.repeats < 1:
            raise PlanError(f"{self.repeats} repeats (--repeats)", remedy="give 1 or more")

    def climbs(self) -> list[Climb]:
        """Every climb, in the order of schemes, dampings, offsets, repeats."""
        return [
            Climb(number, damping, offset, repeat)
            for number in range(len(self.schemes))
            for damping in self.dampings
            for offset in self.offsets
            for repeat in range(self.repeats)
        ]

    def experiment_of(self, climb: Climb, under: Experiment | None = None) -> Experiment:
        """The experiment of a climb but for its stiffness; `under` is what its scheme makes of the plan's, if known."""
        changes = {
            "rig.encoder.offset": climb.offset,
            "trial.seed": self.experiment.trial.seed + climb.repeat,
            "wall.damping": climb.damping,
        }
        applied = self.schemes[climb.scheme].applied(self.experiment) if under is None else under
        return config.override(applied, changes, "the map")

    def tasks(self) -> list[sweep.Task]:
        """The climbs as they are sent to whoever runs them."""
        applied = [scheme.applied(self.experiment) for scheme in self.schemes]
        return [
            sweep.Task(
                climb.key,
                {
                    "experiment": config.as_mapping(self.experiment_of(climb, applied[climb.scheme])),
                    "search": asdict(self.search),
                    "judged": self.judged,
                },
                weight=float(self.schemes[climb.scheme].position_rate),
            )
            for climb in self.climbs()
        ]


def _check_values(
    name: str, values: Sequence[Any], option: str, least: float = 0.0, below: float = math.inf
) -> None:
    """Some values, none twice, and numbers within least ≤ value < below."""
    if not values:
        raise PlanError(f"no {name} ({option}): nothing to map", remedy="give at least one")
    twice = next((value for value, times in Counter(values).items() if times > 1), None)
    if twice is not None:
        raise PlanError(f"{name} ({option}): {twice} stands there twice", remedy="give each once")
    wrong = [value for value in values if isinstance(value, int | float) and not least <= value < below]
    if wrong:
        raise PlanError(
            f"{name} ({option}): {wrong[0]:g} is out of range",
            remedy=f"choose at least {least:g}" + ("" if below == math.inf else f" and less than {below:g}"),
        )


def run_climb(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Run one climb in simulation; payload and result are JSON: a row for each hit, in the order of hits."""
    experiment = config.experiment_from_mapping(payload["experiment"], "a task of a map")
    simulator = HitSimulator(experiment)
    rows: list[dict[str, Any]] = []

    def hit(stiffness: float) -> Outcomes:
        done = simulator.hit(stiffness, experiment.wall.damping)
        rows.append({"stiffness": stiffness} | row_of(done.recorded, "") | row_of(done.true, TRUE))
        return outcomes_of(rows[-1], payload["judged"])

    hit_all(Search(**payload["search"]), hit)
    return rows


def hit_all(search: Search, hit: Callable[[float], Outcomes]) -> None:
    """Hit walls as a search wants them, until it ends."""
    walk = search.walk(CRITERIA)
    stiffness = next(walk)
    while True:
        try:
            stiffness = walk.send(hit(stiffness))
        except StopIteration:
            return


@dataclass(frozen=True, slots=True)
class Boundary:
    """The limit of one scheme at one damping under one criterion, over offsets and repeats.

    Attributes
    ----------
    stiffness, deviation
        Mean and standard deviation of the limits (N·m/rad or N/m); 0 counts as a limit, the deviation of one is 0.
    lowest, highest
        Of the limits.
    capped
        How many climbs ended before their wall did: the mean is then a lower bound.
    unknown
        How many hits said nothing.
    limits
        Of each climb, with its islands.
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
    limits: tuple[Limit, ...]

    @classmethod
    def of(cls, scheme: int, damping: float, criterion: str, limits: Sequence[Limit]) -> Boundary:
        """Summarise limits."""
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
        )


@dataclass(frozen=True, slots=True)
class Width:
    """A curve in four numbers: what the papers compare."""

    stiffness_undamped: float | None  # at B = 0; None when the map does not have that column
    stiffness_peak: float
    damping_at_peak: float
    damping_range: float  # largest damping up to which every column holds some wall
    area: float  # under the curve, up to damping_range
    capped: bool  # the peak is only a lower bound: somewhere the search ended before the wall did
    undamped_capped: bool = False  # so is the value at B = 0
    range_capped: bool = False  # so is the range: it reaches to the last column


@dataclass(frozen=True, slots=True)
class ZWidth:
    """A finished map: its plan, the boundaries, and every hit, climb by climb (read again from the journal, if any)."""

    plan: MapPlan
    boundaries: tuple[Boundary, ...]
    hits: int
    climbs: Sequence[list[dict[str, Any]]]  # rows of `run_climb`, in the order of `MapPlan.climbs`
    on_device: bool = False  # every hit ran over a link

    @property
    def of_device_loop(self) -> bool:
        """Whether simulated hits under the host's law stand for a law on the device."""
        return self.plan.experiment.controller.loop == "device" and not self.on_device

    @classmethod
    def of(cls, plan: MapPlan, climbs: Sequence[list[dict[str, Any]]], *, on_device: bool = False) -> ZWidth:
        """Find the boundaries in the hits of every climb."""
        limits: dict[tuple[int, float, str], list[Limit]] = {}
        hits = 0
        for climb, rows in zip(plan.climbs(), climbs, strict=True):
            hits += len(rows)
            for criterion in CRITERIA:
                column = (climb.scheme, climb.damping, criterion)
                limits.setdefault(column, []).append(limit_of(_tried(rows, criterion, plan.judged)))
        boundaries = tuple(Boundary.of(*column, found) for column, found in limits.items())
        return cls(plan, boundaries, hits, climbs, on_device)

    def curve(self, scheme: int, criterion: str) -> list[Boundary]:
        """Boundaries of one scheme under one criterion, by damping."""
        found = [b for b in self.boundaries if (b.scheme, b.criterion) == (scheme, criterion)]
        return sorted(found, key=lambda boundary: boundary.damping)

    def width(self, scheme: int, criterion: str) -> Width:
        """Summarise one curve."""
        curve = self.curve(scheme, criterion)
        peak = max(curve, key=lambda boundary: boundary.stiffness)
        holds: list[Boundary] = []
        for boundary in curve:
            if boundary.stiffness <= 0.0:
                break
            holds.append(boundary)
        area = np.trapezoid([b.stiffness for b in holds], [b.damping for b in holds]) if holds else 0.0
        return Width(
            stiffness_undamped=curve[0].stiffness if curve[0].damping == 0.0 else None,
            stiffness_peak=peak.stiffness,
            damping_at_peak=peak.damping,
            damping_range=holds[-1].damping if holds else 0.0,
            area=float(area),
            capped=any(b.capped for b in curve),
            undamped_capped=curve[0].damping == 0.0 and curve[0].capped > 0,
            range_capped=len(holds) == len(curve),
        )

    def silent(self) -> dict[str, int]:
        """Why hits said nothing, with how many each, the most common reason first."""
        limits, why = config.verdict_thresholds(self.plan.experiment), Counter[str]()
        suffix, column = TRUE if self.plan.judged == "true" else "", _passes("any", self.plan.judged)
        for rows in self.climbs:
            for row in rows:
                if row[column] is None:
                    numbers: Any = {name: row[name + suffix] for name in NUMBERS.names or ()}
                    found = Objection(int(objections(numbers, limits))) & INVALID
                    why.update([str(reason.name).lower().replace("_", " ") for reason in found] or [_BEFORE])
        return dict(why.most_common())

    def table(self) -> Iterator[dict[str, Any]]:
        """Every hit as a flat row: scheme, damping, offset, repeat, stiffness, kinds and numbers."""
        for climb, rows in zip(self.plan.climbs(), self.climbs, strict=True):
            of_climb = asdict(climb) | {"scheme": self.plan.schemes[climb.scheme].text}
            for row in rows:
                yield of_climb | row

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON: the plan, the boundaries and the widths, without the single hits."""
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
                    "widths": {name: asdict(self.width(number, name)) for name in CRITERIA},
                    "curves": {
                        name: [_boundary_mapping(b) for b in self.curve(number, name)] for name in CRITERIA
                    },
                }
                for number, scheme in enumerate(plan.schemes)
            ],
            "search": asdict(plan.search),
            "offsets": list(plan.offsets),
            "repeats": plan.repeats,
            "judged": plan.judged,
            "hits": self.hits,
            "silent": self.silent(),
            "note": STANDS_FOR_DEVICE if self.of_device_loop else None,
            "experiment": config.as_mapping(plan.experiment),
        }


def zwidth(
    plan: MapPlan,
    *,
    journal: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> ZWidth:
    """Map a simulated rig.

    Parameters
    ----------
    plan
        What to map.
    journal
        File that keeps finished climbs; one of the same plan is gone on with.
    scheduler, workers, watch
        As in `rig.experiments.sweep.run`.

    Raises
    ------
    ConfigError
        A scheme that cannot run on this rig, or a journal of another plan.
    StoppedError
        Ctrl-C; what is done stays in the journal.
    """
    results = sweep.run(
        "rig.experiments.zwidth:run_climb",
        plan.tasks(),
        journal=journal,
        scheduler=scheduler,
        workers=workers,
        unit="ticks",
        watch=watch,
    )
    return ZWidth.of(plan, results)


def row_of(measured: Measured, suffix: str) -> dict[str, Any]:
    """Columns of one side of a hit: kind, what passes, and every number."""
    passes = (measured.passes(criterion) for criterion in CRITERIA)
    return dict(zip(_columns(suffix), (str(measured.kind), *passes, *measured.numbers.item()), strict=True))


def outcomes_of(row: Mapping[str, Any], judged: Judged) -> Outcomes:
    """What a row says under each criterion, by the signals that decide."""
    return {criterion: row[_passes(criterion, judged)] for criterion in CRITERIA}


@cache
def _columns(suffix: str) -> tuple[str, ...]:
    names = ("kind", *(f"passes_{criterion}" for criterion in CRITERIA), *(NUMBERS.names or ()))
    return tuple(name + suffix for name in names)


def _passes(criterion: str, judged: Judged) -> str:
    return f"passes_{criterion}" + (TRUE if judged == "true" else "")


def _tried(rows: Iterable[Mapping[str, Any]], criterion: str, judged: Judged) -> dict[float, bool | None]:
    column = _passes(criterion, judged)
    return {row["stiffness"]: row[column] for row in rows}


def _boundary_mapping(boundary: Boundary) -> dict[str, Any]:
    mapping = asdict(boundary)
    for name in ("scheme", "criterion"):
        del mapping[name]
    return mapping
