"""Where linear theory and hits disagree about walls, and why: which non-linearity must be taken out until they agree.

Theory (`rig.analysis.theory`) calls a wall stable when the spectral radius of the linear loop is below one. Hits call
it stable when at every offset and repeat of the map it is neither unstable, felt, heard nor moved. A wall *differs*
when one calls it stable and the other does not. Why is found by ablation: the same wall is hit on the same rig without

* **friction**: no Coulomb friction on either side;
* **quantum**: `FINER` times as many counts of the encoder;
* **saturation**: effort limits of motor and guard at what the wire carries (32767 quanta), no slew limit;
* **contact**: a wall that does not let go. It is not there until it is touched, so that the hit arrives alike, and from
  then on it is a spring and a damper on both sides.

**The rule.** Of every wall that differs, all sets of one of these are taken out, and if no set makes theory and hits
agree all sets of two, of three, of four. The sets of the first size that has some are the wall's `cures`.

* One cure of one: that is the cause.
* Several cures of one: an interaction, each of these is needed (`EACH`). Without any one of them there is no
  disagreement.
* Cures of two or more only: none is needed by itself, for others do the same (`OTHERS`).
* No cure: `NONE`. What is left then is what the hit has and theory has not beside these four: an end, the hand's own
  motion, thresholds, the quantum of the current.

A hit that shows nothing (invalid) makes nobody agree; a wall whose first hits show nothing is left out and counted.

Shares are areas of the K–B plane with both axes linear: each wall stands for the cell about it, half-way to its
neighbours (in K by ratio), within the map's range. Walls are all rungs of the map's search at all its dampings, beyond
the first failure too. As a check of the method every wall is also hit without all four: what then still differs is no
non-linearity of the rig.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.analysis.theory.lifted import Lifted
from rig.analysis.theory.loop import linear_loop
from rig.config import Experiment, controller
from rig.control.bilateral import clinging_law
from rig.core.drawn import Drawn
from rig.core.errors import PlanError
from rig.core.present import Item, Row, Table, plain, reported
from rig.core.sample import unit_of
from rig.core.shown import Shown
from rig.experiments import sweep
from rig.experiments.hit_simulator import HitSimulator
from rig.experiments.searches import Search, check_values
from rig.experiments.zwidth import MapPlan, Series

FRICTION, QUANTUM, SATURATION, CONTACT = FOUR = ("friction", "quantum", "saturation", "contact")
EACH, OTHERS, NONE = "each of several", "any of several", "none of the four"
CAUSES = (*FOUR, EACH, OTHERS, NONE)
FINER = 256  # counts for one: below a thousandth of the thresholds on every preset
UNBOUND = 1e9  # stands for a slew limit that never binds, in units of the given one

Floats = NDArray[np.float64]
Cure = tuple[str, ...]
Holds = bool | None  # None: the hit does not show it


def cures(agrees: Callable[[Cure], bool]) -> tuple[Cure, ...]:
    """Sets of the smallest size that make theory and hits agree when they are taken out; none if no set does."""
    for size in range(1, len(FOUR) + 1):
        found = tuple(taken for taken in combinations(FOUR, size) if agrees(taken))
        if found:
            return found
    return ()


def cause_of(found: Sequence[Cure]) -> str:
    """Which of `CAUSES` these cures stand for."""
    if not found:
        return NONE
    if len(found[0]) > 1:
        return OTHERS
    return found[0][0] if len(found) == 1 else EACH


def without(experiment: Experiment, taken: Iterable[str]) -> Experiment:
    """The experiment on a rig without these of the four; `CONTACT` is a law's affair (`HitSimulator`)."""
    rig, homing = experiment.rig, experiment.homing
    for one in taken:
        if one == FRICTION:
            rig = replace(rig, mechanics=replace(rig.mechanics, motor_coulomb=0.0, link_coulomb=0.0))
        elif one == QUANTUM:
            encoder = rig.encoder
            finer = (
                replace(encoder, quantum=encoder.resolution / FINER)
                if encoder.counts_per_revolution is None
                else replace(encoder, counts_per_revolution=encoder.counts_per_revolution * FINER)
            )
            rig = replace(rig, encoder=finer)
            homing = replace(homing, tolerance_counts=homing.tolerance_counts * FINER)
        elif one == SATURATION:
            most = controller.I16_MAXIMUM * rig.amplifier.effort_quantum
            lifted = replace(rig.amplifier, effort_limit=max(most, rig.amplifier.effort_limit))
            free = replace(rig.limits, effort=max(most, rig.limits.effort), slew=rig.limits.slew * UNBOUND)
            rig = replace(rig, amplifier=lifted, limits=free)
    return replace(experiment, rig=rig, homing=homing)


class _Column:
    """The walls of one damping under one scheme, on the rig and on rigs without some of the four."""

    def __init__(self, experiments: Sequence[Experiment], judged: str) -> None:
        self._experiments, self._judged = experiments, judged
        self._rigs: dict[tuple[Cure, int], HitSimulator] = {}
        self.hits = self.ticks = 0

    def passes(self, stiffness: float, number: int, taken: Cure = ()) -> Holds:
        """Whether a wall passes at one offset and repeat."""
        experiment = self._experiments[number]
        if (taken, number) not in self._rigs:
            law = clinging_law() if CONTACT in taken else None
            self._rigs[taken, number] = HitSimulator(without(experiment, taken), law=law)
        hit = self._rigs[taken, number].hit(stiffness, experiment.wall.damping)
        self.hits += 1
        self.ticks += hit.ticks
        return (hit.true if self._judged == "true" else hit.recorded).passes("any")

    def holds(self, stiffness: float, taken: Cure = ()) -> Holds:
        """Whether it passes at all of them; the first that does not decides."""
        unknown = False
        for number in range(len(self._experiments)):
            passes = self.passes(stiffness, number, taken)
            if passes is False:
                return False
            unknown |= passes is None
        return None if unknown else True


def hit_column(payload: Mapping[str, Any]) -> list[dict[str, Any]]:
    """One task of the sweep, JSON in and out: all walls of a scheme at a damping, the softest first."""
    experiments = [config.experiment_from_mapping(one, "a task of a map") for one in payload["experiments"]]
    column, first = _Column(experiments, payload["judged"]), experiments[0]
    rungs = Search(**payload["search"]).rungs
    radii = Lifted.of(linear_loop(first)).radius(rungs, first.wall.damping)
    rows: list[dict[str, Any]] = []
    for stiffness, radius in zip(rungs, radii.tolist(), strict=True):
        hits, ticks = column.hits, column.ticks
        linear, holds = radius < 1.0, column.holds(stiffness)
        found: tuple[Cure, ...] | None = None
        if holds is (not linear):
            found = cures(lambda taken, k=stiffness, says=linear: column.holds(k, taken) is says)  # type: ignore[misc]
        rows.append(
            {
                "stiffness": stiffness,
                "radius": radius,
                "holds": holds,
                "cures": found,
                "holds_without": column.passes(stiffness, 0, FOUR),
                "hits": column.hits - hits,
                "ticks": column.ticks - ticks,
            }
        )
    return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class DisagreementPlan:
    """All walls of a map, hit, and those that differ from theory hit again; see the text of this module."""

    map: MapPlan

    work: ClassVar[str] = "rig.experiments.disagreement:hit_column"
    unit: ClassVar[str] = "ticks"

    @property
    def experiment(self) -> Experiment:
        """That of the map."""
        return self.map.experiment

    def check(self) -> None:
        """Raise `PlanError` for another wall than spring and damper, `NotLinearError` for a scheme of that kind."""
        wall = self.experiment.wall
        for key, value, linear in (
            ("law", wall.law, "spring-damper"),
            ("damping_on", wall.damping_on, "both"),
        ):
            if value != linear:
                raise PlanError(
                    f"wall.{key} = {value!r}: linear theory has nothing to say about it",
                    remedy=f"compare a wall with wall.{key} = {linear!r}",
                )
        check_values("dampings", self.map.dampings, "damping", rising=True)
        for scheme in self.map.schemes:
            linear_loop(self.experiment, scheme)

    def tasks(self) -> list[sweep.Task]:
        """One for each scheme and damping."""
        columns: dict[tuple[int, float], list[Series]] = {}
        for one in self.map.series():
            columns.setdefault((one.scheme, one.damping), []).append(one)
        applied = [scheme.applied(self.experiment) for scheme in self.map.schemes]
        return [
            sweep.Task(
                f"{scheme}/{damping!r}",
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
        """Plain values of the map."""
        return self.map.as_mapping()

    def found(self, results: Sequence[Any]) -> Disagreement:
        """What the results of all tasks say."""
        plan = self.map
        columns = [(scheme, damping) for scheme in range(len(plan.schemes)) for damping in plan.dampings]
        across = dict(zip(plan.dampings, np.diff(edges_of(plan.dampings)).tolist(), strict=True))
        along = np.diff(edges_of(plan.search.rungs, by_ratio=True)).tolist()
        return Disagreement(
            plan,
            tuple(
                Wall.of(row, scheme, damping, across[damping] * height)
                for (scheme, damping), rows in zip(columns, results, strict=True)
                for row, height in zip(rows, along, strict=True)
            ),
            hits=sum(row["hits"] for rows in results for row in rows),
        )


def edges_of(values: Sequence[float], *, by_ratio: bool = False) -> Floats:
    """Ends of the cells about rising values, half-way to their neighbours, in K by ratio; a single one has length 1."""
    if len(values) == 1:
        return values[0] + np.array([-0.5, 0.5])
    at = np.asarray(values)
    between = np.sqrt(at[1:] * at[:-1]) if by_ratio else 0.5 * (at[1:] + at[:-1])
    return np.concatenate([at[:1], between, at[-1:]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """One wall: what theory says, what hits say, and why they differ if they do.

    Attributes
    ----------
    scheme, damping, stiffness
        Index of the scheme, B and K.
    area
        Of its cell in the plane.
    radius
        Spectral radius of the linear loop.
    holds
        Whether it is stable by its hits; None where these do not show it.
    holds_without
        The same on the rig without all four.
    cures
        Smallest sets that make both agree; empty where they do, or where no set does.
    cause
        One of `CAUSES`; empty where theory and hits agree or the hits show nothing.
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
    def of(cls, row: Mapping[str, Any], scheme: int, damping: float, area: float) -> Wall:
        """The wall of a row of `hit_column`."""
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
        """Whether theory calls it stable."""
        return self.radius < 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """What differs of some area: its share of that, and the share of each cause in it, the largest first; 0 to 1."""

    share: float
    causes: dict[str, float]

    @classmethod
    def of(cls, whole: Sequence[Wall]) -> Part:
        """The part of these walls that differs."""
        differing = [wall for wall in whole if wall.cause]
        return cls(share=_share(differing, whole), causes=_by(differing, lambda wall: wall.cause))


@dataclass(frozen=True, slots=True, kw_only=True)
class Shares:
    """How far theory goes for one scheme: shares of areas, 0 to 1.

    Attributes
    ----------
    differ
        What differs of the plane.
    fails
        What differs of the walls that theory calls stable: those that fail.
    beyond
        What differs of the walls that hold: those that theory calls unstable.
    sets
        Of what differs, by the cures where there are several: what interacts.
    differ_without
        Of the plane: what differs on the rig without all four.
    stable, holding
        Of the plane: what theory calls stable, and what holds.
    """

    scheme: str
    label: str
    differ: Part
    fails: Part
    beyond: Part
    sets: dict[str, float]
    differ_without: float
    stable: float
    holding: float


@dataclass(frozen=True, slots=True, repr=False)
class Disagreement(Shown, Drawn):
    """Where theory and hits differ, wall by wall.

    Attributes
    ----------
    plan
        The map whose walls were hit.
    walls
        By scheme, damping and stiffness, in this order.
    hits
        How many there were, those on rigs without something included.
    """

    table_name: ClassVar[str] = "walls.parquet"

    plan: MapPlan
    walls: tuple[Wall, ...]
    hits: int

    def of_scheme(self, number: int) -> list[Wall]:
        """Walls of one scheme."""
        return [wall for wall in self.walls if wall.scheme == number]

    def shares(self, number: int) -> Shares:
        """Summarise one scheme."""
        scheme = self.plan.schemes[number]
        known = [wall for wall in self.of_scheme(number) if wall.holds is not None]
        differing = [wall for wall in known if wall.cause]
        stable, holding = [w for w in known if w.linear], [w for w in known if w.holds]
        return Shares(
            scheme=scheme.text,
            label=scheme.label(self.plan.experiment),
            differ=Part.of(known),
            fails=Part.of(stable),
            beyond=Part.of(holding),
            sets=_by([w for w in differing if len(w.cures) > 1], _sets, of=differing),
            differ_without=_share([w for w in known if w.holds_without is (not w.linear)], known),
            stable=_share(stable, known),
            holding=_share(holding, known),
        )

    @reported
    def schemes(self) -> tuple[Shares, ...]:
        """The shares of each scheme."""
        return tuple(self.shares(number) for number in range(len(self.plan.schemes)))

    @reported
    def unknown(self) -> int:
        """How many walls were left out, because their hits show nothing."""
        return sum(wall.holds is None for wall in self.walls)

    def brief(self) -> list[Item]:
        """How much differs under each scheme, and what for."""
        rows = [
            Row(
                shares.label, f"{_percent(shares.differ.share)} of the plane: {_spoken(shares.differ.causes)}"
            )
            for shares in self.schemes
        ]
        rig = self.plan.experiment.rig.name
        return [
            f"where linear theory and {self.hits} hits differ on {rig}, in {len(self.walls)} walls",
            *rows,
        ]

    def detailed(self) -> list[Item]:
        """Both ways to differ, in a table."""
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
        """Every wall as a flat row."""
        for wall in self.walls:
            row = asdict(wall) | {"scheme": self.plan.schemes[wall.scheme].text}
            yield row | {"linear": wall.linear, "cures": _sets(wall)}

    def units(self) -> dict[str, str]:
        """Unit of each column of the table that has one."""
        motion = self.plan.experiment.rig.motion
        return {name: unit_of(name, motion) for name in ("stiffness", "damping")}

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON, without the single walls."""
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


def _share(part: Iterable[Wall], whole: Iterable[Wall]) -> float:
    area = sum(wall.area for wall in whole)
    return sum(wall.area for wall in part) / area if area else 0.0


def _by(
    walls: Sequence[Wall], name: Callable[[Wall], str], of: Sequence[Wall] | None = None
) -> dict[str, float]:
    """Shares of what walls are called, the largest first."""
    areas: dict[str, float] = {}
    for wall in walls:
        areas[name(wall)] = areas.get(name(wall), 0.0) + wall.area
    whole = sum(wall.area for wall in (walls if of is None else of))
    return {what: areas[what] / whole for what in sorted(areas, key=lambda what: -areas[what])}


def _sets(wall: Wall) -> str:
    return "; ".join("+".join(cure) for cure in wall.cures)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def _cells(part: Part) -> list[str]:
    return [_percent(part.causes[cause]) if cause in part.causes else "" for cause in CAUSES]


def _spoken(causes: Mapping[str, float]) -> str:
    said = ", ".join(f"{cause} {_percent(share)}" for cause, share in causes.items())
    return f": {said}" if said else ""
