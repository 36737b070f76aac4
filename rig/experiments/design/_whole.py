"""Compare all listed sampling schemes with the scheme of a paper, in every measure of that paper.

`_search` calls this module if `paper` is requested. The statement that no listed scheme is as good as the paper's
requires a result for each listed scheme: a complete map, or a failed hit at a wall that a measure requires.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rig.config import Experiment, presets
from rig.config.schemes import Scheme
from rig.control import estimators
from rig.core.errors import ConfigError
from rig.core.present import Table, plain, written
from rig.core.sample import unit_of
from rig.experiments.design import _rules as rules
from rig.experiments.design._listing import Candidate
from rig.experiments.design._rounds import Sweeper, WallGrid, columns_to
from rig.experiments.design._rules import OF_A_PAPER, OF_TABLE_ONE, BoundaryMeasures
from rig.experiments.mapping._ranges import (
    PAPERS_SCHEMES,
    SHARE,
    dampings_for,
    default_grid,
    frequency_plan,
    search_for,
)
from rig.experiments.mapping._rendering import RENDERED
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.table_one import PAPERS_RIG, SchemeWidths, tuned_numbers
from rig.experiments.mapping.zwidth import ZWidth

KOUL = ("koul-rigid", "koul-compliant")
# All schemes are tested at the same walls: COLUMNS dampings, denser near zero, up to a little above the linear range of
# the paper's schemes, and BEYOND times this range for the peak. A value that reaches the last wall is marked ≥.
COLUMNS, BEYOND = 12, (2.0, 4.0, 8.0)
RATIO, OFFSETS = 1.15, (0.1, 0.6)
BATCH = 8
STATED = ("order", "window_limit")
# Grid of the impedances: numbers of stiffnesses and dampings, and highest over lowest stiffness.
STIFFNESSES, DAMPINGS, SPAN = 26, 8, 40.0

NAMES = {
    "undamped": "K at B = 0",
    "stiffness": "K peak",
    "damping": "B range",
    "k_width": "K-width, frequency domain",
    "b_width": "B-width, frequency domain",
    "worst_fidelity": "largest fidelity error",
    "tuned": "numbers to tune",
}
UNITS = {
    "undamped": "stiffness",
    "stiffness": "stiffness",
    "damping": "damping",
    "k_width": "stiffness",
    "b_width": "damping",
    "worst_fidelity": "damping",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSchemes:
    """A paper's sampling schemes on its rig, and the names of the measures by which the paper judges them."""

    schemes: tuple[Scheme, ...]
    measures: tuple[str, ...]

    @classmethod
    def of(cls, rig: str) -> PaperSchemes:
        """Return schemes and compared measures of the paper on a rig; raise `ConfigError` without such a paper."""
        if rig in KOUL:
            return cls(schemes=(Scheme.of(presets.load(rig)),), measures=OF_A_PAPER)
        if rig == PAPERS_RIG:
            schemes = tuple(map(Scheme.parse, PAPERS_SCHEMES))
            return cls(schemes=schemes, measures=(*OF_A_PAPER, *OF_TABLE_ONE))
        raise ConfigError(
            f"{rig} is not the rig of a paper, so `paper` cannot be used",
            remedy=f"choose one of {', '.join((*KOUL, PAPERS_RIG))}, or leave `paper` out",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedScheme:
    """A sampling scheme of which all walls were tested: its measures by name; those in `capped` are lower bounds."""

    candidate: Candidate
    label: str
    values: Mapping[str, float]
    capped: tuple[str, ...]

    def shown(self, name: str) -> str:
        """Return the value of the measure `name` as text, after "≥" if the value is only a lower bound."""
        return ("≥ " if name in self.capped else "") + written(self.values[name], 3)

    def misses(self, other: MappedScheme) -> list[str]:
        """Return the names of the measures in which this sampling scheme is worse than the other scheme."""
        return [
            name
            for name, value in self.values.items()
            if not rules.reaches(name, value, other.values[name], RATIO)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Against:
    """A comparison of one sampling scheme of a paper with all listed schemes.

    Attributes
    ----------
    paper
        Scheme of the paper.
    listed
        Number of listed schemes, without the scheme of the paper.
    ruled_out
        For each measure the number of schemes that cannot reach it, as one failed hit (or the count of tuned values)
        shows.
    measured
        Schemes that were not ruled out and whose stable walls were all searched, the best first.
    open
        Number of schemes that were neither ruled out nor searched, because a scheme as good as the paper's was found.
    """

    paper: MappedScheme
    listed: int
    ruled_out: Mapping[str, int]
    measured: tuple[MappedScheme, ...]
    open: int

    @property
    def best(self) -> MappedScheme | None:
        """Return the searched sampling scheme that is worse than the paper's in the fewest measures; None without one.

        Of several such schemes return the one with the largest product of K peak and range of B.
        """
        return self.measured[0] if self.measured else None

    @property
    def as_good(self) -> bool:
        """Return True if a listed sampling scheme is as good as the paper's scheme in every measure."""
        return self.best is not None and not self.best.misses(self.paper)

    @property
    def text(self) -> str:
        """Return a sentence: a listed scheme is as good as the paper's, or how many were ruled out."""
        if self.best is not None and self.as_good:
            return f"{self.best.label} is as good as {self.paper.label} in every measure"
        return (
            f"none of the {self.listed} other schemes is as good as {self.paper.label} in every measure: single hits "
            f"rule out {sum(self.ruled_out.values())}, {len(self.measured)} were mapped"
        )

    def table(self, motion: str) -> Table:
        """Return a table, a row for each measure: paper's sampling scheme, best listed scheme, schemes ruled out."""
        best, missed = self.best, [] if self.best is None else self.best.misses(self.paper)
        rows = []
        for name in self.paper.values:
            unit = f" ({unit_of(UNITS[name], motion)})" if name in UNITS else ""  # type: ignore[arg-type]
            found = "–" if best is None else best.shown(name)
            verdict = "–" if best is None else "misses" if name in missed else "as good"
            out = f"{self.ruled_out.get(name, 0)}"
            rows.append((NAMES[name] + unit, self.paper.shown(name), found, verdict, out))
        head = ("measure", self.paper.label, best.label if best else "none left", "verdict", "ruled out")
        return Table(head, rows, self.text)

    def as_mapping(self) -> dict[str, Any]:
        """Return the comparison with a paper's sampling scheme as JSON values by name."""

        def as_facts(one: MappedScheme) -> dict[str, Any]:
            return {
                "scheme": one.candidate.scheme.text,
                "label": one.label,
                "values": plain(one.values),
                "capped": list(one.capped),
            }

        return {
            "paper": as_facts(self.paper),
            "listed": self.listed,
            "ruled_out": dict(self.ruled_out),
            "measured": [as_facts(one) | {"misses": one.misses(self.paper)} for one in self.measured],
            "open": self.open,
            "as_good": self.as_good,
            "text": self.text,
        }


def against_paper(
    experiment: Experiment, candidates: Sequence[Candidate], run: Sweeper
) -> tuple[Against, ...]:
    """Compare each scheme of the rig's paper with all `candidates`; sort these by linear theory, the best first."""
    return _Whole(experiment, PaperSchemes.of(experiment.rig.name), run).compare(candidates)


class _Whole:
    def __init__(self, experiment: Experiment, paper: PaperSchemes, run: Sweeper) -> None:
        self._experiment, self._paper, self._run = experiment, paper, run
        self._search = search_for(experiment, "ladder", ratio=RATIO, schemes=paper.schemes)
        reach = dampings_for(experiment, paper.schemes, columns=2)[-1]
        self._dampings = (*columns_to(reach, COLUMNS), *(reach * times for times in BEYOND))
        self._impedances = bool(set(OF_TABLE_ONE) & set(paper.measures))
        self._walls: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
        if self._impedances:
            k, b = default_grid(experiment, paper.schemes)
            self._walls = (
                tuple(np.geomspace(k[-1] / SHARE / SPAN, k[-1] / SHARE, STIFFNESSES).tolist()),
                tuple(np.linspace(0.0, b[-1] / SHARE, DAMPINGS).tolist()),
            )

    def compare(self, candidates: Sequence[Candidate]) -> tuple[Against, ...]:
        experiment = self._experiment
        own = [
            Candidate(
                scheme=scheme,
                loop=experiment.controller.loop,
                delay_ticks=experiment.rig.simulation.computation_delay_ticks,
            )
            for scheme in self._paper.schemes
        ]
        measured = self._map_whole("paper", own)
        return tuple(self._against(n, paper, candidates) for n, paper in enumerate(measured))

    def _against(self, number: int, paper: MappedScheme, candidates: Sequence[Candidate]) -> Against:
        name = f"whole set {number + 1}"
        left = [one for one in candidates if not one.same_law(paper.candidate, self._experiment)]
        listed, ruled_out = len(left), dict[str, int]()
        # A limit is the stiffest wall below which every wall is stable, so that a failed wall at the stiffness that a
        # measure requires rules a scheme out without any other hit. The wall must fail at all encoder offsets; an
        # invalid hit rules out nothing.
        for measure, keep in self._sieves(name, paper.values):
            kept = keep(left)
            ruled_out[measure] = ruled_out.get(measure, 0) + len(left) - len(kept)
            left = kept
        found: list[MappedScheme] = []
        # In batches, the most promising by theory first: stop as soon as one scheme is as good as the paper's.
        while len(found) < len(left) and all(one.misses(paper) for one in found):
            batch = left[len(found) : len(found) + BATCH]
            found += self._map_whole(f"{name} from {len(found)}", batch)
        found.sort(key=lambda one: (len(one.misses(paper)), -one.values["damping"] * one.values["stiffness"]))
        return Against(
            paper=paper,
            listed=listed,
            ruled_out=ruled_out,
            measured=tuple(found),
            open=len(left) - len(found),
        )

    def _sieves(
        self, name: str, asked: Mapping[str, float]
    ) -> Iterator[tuple[str, Callable[[Sequence[Candidate]], list[Candidate]]]]:
        """Yield the name of a measure, and a function that removes the candidates which cannot reach the paper's value.

        `asked` has the values of the paper's sampling scheme by measure.
        """
        softest = self._search.lowest
        reach = next(b for b in self._dampings if rules.reaches("damping", b, asked["damping"], RATIO))
        # Any stable wall at or above the required damping shows that the range is reached.
        beyond = [b for b in self._dampings if b >= reach]
        # In the order in which the tests rule out most schemes for the fewest hits; counting tuned values needs no hit.
        if "tuned" in asked:
            yield "tuned", lambda left: [one for one in left if self._count_tuned(one) <= asked["tuned"]]
        if asked["undamped"] > 0.0:  # else every scheme reaches it
            yield "undamped", lambda left: self._keep_undamped(name, left, asked["undamped"])
        if asked["damping"] > 0.0:
            yield "damping", lambda left: self._hold(f"{name} range", left, beyond, softest)
        if asked["stiffness"] > 0.0:
            rung = self._rung("stiffness", asked["stiffness"])
            yield (
                "stiffness",
                lambda left: self._hold(f"{name} peak", left, self._dampings, rung),
            )

    def _keep_undamped(self, name: str, left: Sequence[Candidate], asked: float) -> list[Candidate]:
        """Return the candidates with which a wall of stiffness `asked` (SI) is stable without damping."""

        def law(one: Candidate) -> tuple[Any, ...]:
            return one.loop, one.delay_ticks, one.scheme.position_rate

        first = {law(one): one for one in left}
        held = self._hold(f"{name} undamped", list(first.values()), [0.0], self._rung("undamped", asked))
        laws = {law(one) for one in held}
        return [one for one in left if law(one) in laws]

    def _rung(self, name: str, asked: float) -> float:
        """Return the lowest tested stiffness (SI) that is as good as `asked` in the measure `name`, to one step."""
        return next(k for k in self._search.rungs if rules.reaches(name, k, asked, RATIO))

    def _hold(
        self, stage: str, left: Sequence[Candidate], dampings: Sequence[float], stiffness: float
    ) -> list[Candidate]:
        """Return the candidates with which a wall of this stiffness is stable at one of `dampings` or more."""
        if not left:
            return []
        one_rung = StiffnessSearch(way="grid", lowest=stiffness, highest=1.5 * stiffness, ratio=2.0)
        grid = WallGrid(dampings=tuple(dampings), search=one_rung, offsets=OFFSETS)
        cases = [(one.condition(self._experiment), one.scheme, grid) for one in left]
        maps = self._run.map_each(stage, cases)
        return [
            one
            for one, found in zip(left, maps, strict=True)
            if any(
                boundary.rendered >= RENDERED and any(limit.failed_at is None for limit in boundary.limits)
                for boundary in found.curve(0, "any")
            )
        ]

    def _map_whole(self, stage: str, some: Sequence[Candidate]) -> list[MappedScheme]:
        """Find all stable walls of the schemes by hits, and all passive walls if the paper judges impedances."""
        grid = WallGrid(dampings=self._dampings, search=self._search, offsets=OFFSETS)
        conditions = [one.condition(self._experiment) for one in some]
        cases = [(condition, one.scheme, grid) for condition, one in zip(conditions, some, strict=True)]
        maps = self._run.map_each(f"{stage} hits", cases)
        widths: Sequence[SchemeWidths | None] = [None] * len(some)
        if self._impedances:
            plans = [
                frequency_plan(condition, (one.scheme,), stiffnesses=self._walls[0], dampings=self._walls[1])
                for condition, one in zip(conditions, some, strict=True)
            ]
            widths = [SchemeWidths.of(found, 0) for found in self._run.each(f"{stage} impedances", plans)]
        return [
            MappedScheme(
                candidate=one,
                label=one.scheme.label(condition),
                values=self._values(one, found, width),
                capped=self._list_capped(found, width),
            )
            for condition, one, found, width in zip(conditions, some, maps, widths, strict=True)
        ]

    def _values(self, one: Candidate, found: ZWidth, width: SchemeWidths | None) -> dict[str, float]:
        curve = found.curve(0, "any")
        values = asdict(BoundaryMeasures.of([b.damping for b in curve], [b.counted for b in curve]))
        if width is not None:
            together = width.together
            values |= {
                "k_width": together.stiffness,
                "b_width": together.damping,
                "worst_fidelity": together.worst_fidelity,
                "tuned": float(self._count_tuned(one)),
            }
        return {name: values[name] for name in self._paper.measures}

    def _list_capped(self, found: ZWidth, width: SchemeWidths | None) -> tuple[str, ...]:
        hit = found.width(0, "any")
        reached = {
            "undamped": hit.undamped_capped,
            "stiffness": hit.capped,
            "damping": hit.range_capped,
            "k_width": width is not None and width.together.stiffness_capped,
            "b_width": width is not None and width.together.damping_capped,
        }
        return tuple(name for name in self._paper.measures if reached.get(name, False))

    def _count_tuned(self, one: Candidate) -> int:
        """Return the number of tuned settings of an estimator; an order or window at its default does not count."""
        controller = one.applied(self._experiment).controller
        defaults = {
            setting.name: setting.default for setting in estimators.get(controller.estimator).settings
        }
        stated = {
            name: value
            for name, value in controller.parameters.items()
            if not (name in STATED and value == defaults[name])
        }
        return len(tuned_numbers(controller.estimator, stated))
