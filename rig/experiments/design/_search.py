"""Search for a design: linear theory for all listed schemes, three rounds of simulated hits, and a validation.

`rig.experiments.design.design` is defined here. The validation uses encoder offsets and seeds that the search did not
use. Each stage depends on the stored results of earlier stages: a stopped design resumes in its stage, and its result
is equal to the last bit.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.control import estimators
from rig.core.errors import ConfigError, NoStableWallError
from rig.core.present import plain
from rig.experiments import sweep
from rig.experiments.design import _linear as linear
from rig.experiments.design import _rules as rules
from rig.experiments.design._linear import Linear
from rig.experiments.design._listing import Candidate, LawPlace, listed, places_for
from rig.experiments.design._margin import margin_of
from rig.experiments.design._result import Design, Standing
from rig.experiments.design._rounds import Sweeper, WallGrid, Watch, columns_to
from rig.experiments.design._rules import BoundaryMeasures, Comparison, Measures, Wishes
from rig.experiments.design._whole import Against, PaperSchemes, against_paper
from rig.experiments.mapping._ranges import dampings_for, search_for
from rig.experiments.mapping._rendering import RENDERED
from rig.experiments.mapping._searches import StiffnessSearch, Way
from rig.experiments.mapping.zwidth import ZWidth

# Dampings of the linear stage: the range of the experiment's own scheme times 2 to these powers, first to last.
OCTAVES = (-5, 3)
# Largest factor by which Coulomb friction raises a limit of linear theory (`rig.analysis.theory._loop`).
FRICTION = 2.0
# Encoder offsets that no round uses: at the rounds' offsets the chosen scheme may be better by chance.
HELD_OUT_OFFSETS = (0.225, 0.475, 0.725, 0.975)
# Number added to the trial's seed, and stiffness searches at each offset.
HELD_OUT_SEED, HELD_OUT_REPEATS = 1_000, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One round of simulated hits: number of schemes that enter it, and the walls, offsets and search of each."""

    name: str
    enter: int
    way: Way = "bisection"
    ratio: float
    columns: int
    offsets: tuple[float, ...]


ROUNDS = (
    Round(name="first hits", enter=160, ratio=1.5, columns=6, offsets=(0.1,)),
    Round(name="second hits", enter=16, ratio=1.15, columns=8, offsets=(0.1, 0.6)),
    # Bisection assumes that a wall stiffer than a failing one fails, too, which does not hold near the largest damping.
    # So the last round, which decides, tests upwards from the softest wall.
    Round(name="last hits", enter=4, way="ladder", ratio=1.05, columns=9, offsets=(0.1, 0.35, 0.6, 0.85)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRequest:
    """A request to find the best sampling scheme for a rig.

    Attributes
    ----------
    experiment
        Rig, trial and thresholds; all other sampling schemes are compared with the experiment's own scheme.
    wishes
        Goal and requirements that the recommended scheme must meet (`rig.experiments.design._rules`).
    places
        Where the law may run (host, device). If empty: where the experiment runs it, at most at its position rate.
    schemes
        Schemes to search; if empty, those of `rig.experiments.design._listing`.
    rounds
        Rounds of simulated hits, each with fewer schemes and more walls.
    paper
        True to compare also the schemes of the rig's paper with all listed schemes (`rig.experiments.design._whole`).
    """

    experiment: Experiment
    wishes: Wishes = field(default_factory=Wishes)
    places: tuple[LawPlace, ...] = ()
    schemes: tuple[Scheme, ...] = ()
    rounds: tuple[Round, ...] = field(default_factory=lambda: ROUNDS)
    paper: bool = False

    def as_mapping(self) -> dict[str, Any]:
        """Return the fields that determine the result of the search as JSON values; `paper` is left out."""
        return {
            "experiment": config.as_mapping(self.experiment),
            "wishes": plain(self.wishes),
            "places": plain(self.places),
            "schemes": [scheme.text for scheme in self.schemes],
            "rounds": plain(self.rounds),
        }


def directory_for(request: DesignRequest, where: Path) -> Path:
    """Return the directory inside `where` for the files of a design; its name hashes all that determines the result."""
    described = json.dumps([sweep.code_version(), request.as_mapping()], sort_keys=True)
    digest = sha256(described.encode()).hexdigest()[:8]
    return where / f"design-{request.experiment.rig.name}-{digest}"


def design(
    request: DesignRequest,
    directory: Path | None = None,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Watch | None = None,
) -> Design:
    """Find the sampling scheme that meets the requirements for a rig best.

    Parameters
    ----------
    request
        Rig, requirements and schemes to search.
    directory
        Directory that stores finished tasks; a stopped design resumes from it. None: not stored.
    scheduler, workers, watch
        Address of a Dask scheduler; number of threads; function that is called with the name of the stage and its
        progress.

    Raises
    ------
    NoStableWallError
        No sampling scheme has a stable wall whose damping is rendered.
    UnmetError
        No listed scheme meets the requirements; the message names the limiting one.
    ConfigError
        A scheme of `request.schemes` is invalid, `paper` is set and no paper describes the rig, or the scheduler is not
        found.
    StoppedError
        Ctrl-C was pressed; finished tasks stay in the directory.
    """
    run = Sweeper(directory=directory, scheduler=scheduler, workers=workers, watch=watch)
    return _Search(request, run).design()


@dataclass(slots=True)
class _Search:
    request: DesignRequest
    run: Sweeper

    def design(self) -> Design:
        experiment, wishes = self.request.experiment, self.request.wishes
        if self.request.paper:
            # Raise for a rig without a paper before the search, which may run for hours.
            PaperSchemes.of(experiment.rig.name)
        asked = [
            experiment.controller.estimator,
            *(one.estimator for one in self.request.schemes if one.estimator),
        ]
        if fed := [name for name in asked if estimators.get(name).uses_effort]:
            raise ConfigError(
                f"the estimator {fed[0]} uses the motor's effort; a design can only compare estimators that use counts "
                "alone",
                remedy="design with other estimators (controller.estimator, --scheme), then compare by `rig zwidth`",
            )
        places = self.request.places or places_for(experiment)
        own = Candidate.own(experiment, places)
        others = listed(experiment, places, self.request.schemes)
        candidates = [own, *(one for one in others if not one.same_law(own, experiment))]
        reach = dampings_for(experiment, (own.scheme,), columns=2)[-1]
        dampings = (0.0, *(reach * 2.0**octave for octave in range(OCTAVES[0], OCTAVES[1] + 1)))
        known = dict(
            zip([one.key for one in candidates], self._run_linear_stage(candidates, dampings), strict=True)
        )
        shares = [wishes.of_path(one.noise, one.fidelity_hz, one.cost) for one in known.values()]
        rules.refuse_unmet(wishes, shares)
        entering = [one for one, share in zip(candidates, shares, strict=True) if rules.fulfilled(share)]
        along = dampings
        entering = self._rank_promising(entering, known, along, known[own.key])
        kept = entering[: self.request.rounds[0].enter]

        rounds: list[list[Standing]] = []
        entrants = kept
        for number, stage in enumerate(self.request.rounds):
            if number:
                entrants = [one.candidate for one in rounds[-1]][: stage.enter]
                dampings = columns_to(_damping_reach(rounds[-1]), stage.columns)
            else:
                top = max(known[one.key].measures(dampings, quiet=False).damping for one in entrants)
                dampings = _octaves(min(2.0 * top, dampings[-1]) or dampings[-1], stage.columns)
            # The experiment's own scheme takes part in every round, so that the last one compares both by the same
            # walls.
            if own.key not in {one.key for one in entrants}:
                entrants = [*entrants, own]
            rounds.append(self._hit(stage, entrants, dampings, known, own))
        finalists = self._with_wall(rounds[-1])
        rules.refuse_unmet(wishes, [one.shares for one in finalists])

        best, of_own = finalists[0], _find_standing(finalists, own)
        if best.measures.stiffness <= 0.0:
            lowest = search_for(experiment, schemes=[one.candidate.scheme for one in finalists]).lowest
            raise NoStableWallError(
                f"none of {len(candidates)} sampling schemes has a stable wall with K = {lowest:.4g} or more: a ripple "
                "is above its limit, or the effort limit cuts more than 20 % of the wall's damping",
                remedy="push harder (`effort`, `operator`), raise the limits of the ripples of velocity (`felt`), "
                "effort (`heard`) and position (`moved`), or use a finer encoder",
            )
        held_out = None if best is of_own else self._compare_held_out(best, of_own, dampings)
        if held_out is not None and not held_out.no_worse and self._may_be_own(of_own, places):
            best = of_own
        against: tuple[Against, ...] = ()
        if self.request.paper:
            against = against_paper(
                experiment, self._rank_promising(candidates, known, along, known[own.key]), self.run
            )
        damping, limit = _margin_point(best, wishes)
        return Design(
            experiment=experiment,
            wishes=wishes,
            places=places,
            listed=len(candidates),
            kept=len(kept),
            standings=tuple(rounds[-2] if len(rounds) > 1 else rounds[-1]),
            finalists=tuple(finalists),
            recommended=best,
            own=of_own,
            held_out=held_out,
            margin=margin_of(best.candidate, experiment, damping, limit, self.run),
            step=self.request.rounds[max(0, len(rounds) - 2)].ratio,
            hits=self.run.hits,
            against=against,
        )

    def _may_be_own(self, own: Standing, places: Sequence[LawPlace]) -> bool:
        """Return True if the experiment's own scheme meets the requirements and can run at one of `places`."""
        applied = own.candidate.applied(self.request.experiment)
        return rules.fulfilled(own.shares) and any(
            place.loop == own.candidate.loop and place.allows(applied) for place in places
        )

    def _run_linear_stage(self, candidates: Sequence[Candidate], dampings: Sequence[float]) -> list[Linear]:
        search = search_for(self.request.experiment, schemes=[one.scheme for one in candidates])
        k = np.geomspace(search.lowest, search.highest, linear.STIFFNESSES).tolist()
        tasks, order = linear.tasks(self.request.experiment, candidates, dampings, k)
        return linear.results(self.run.run(linear.STAGE, tasks), order)

    def _rank_promising(
        self,
        candidates: Sequence[Candidate],
        known: Mapping[str, Linear],
        dampings: Sequence[float],
        own: Linear,
    ) -> list[Candidate]:
        """Return the candidates sorted by linear theory, the best first."""
        wishes = self.request.wishes

        def value(one: Candidate, quiet: bool) -> tuple[float, ...]:
            path, shares = known[one.key], {}
            if wishes.wall is not None:
                limit = float(np.interp(wishes.wall[1], dampings, path.stable))
                # Friction may raise the limit by this factor: do not drop a scheme here that hits may accept.
                shares["wall"] = FRICTION * limit / wishes.wall[0]
            measures = path.measures(dampings, quiet=quiet)
            return rules.key(wishes, measures, shares, own.measures(dampings, quiet=quiet).area)

        # Both rankings in turn: limits at which a toggling count stays unnoticed are too low, limits without it too
        # high.
        rankings = [
            sorted(candidates, key=lambda one: value(one, quiet=True), reverse=True),
            sorted(candidates, key=lambda one: value(one, quiet=False), reverse=True),
        ]
        return list({one.key: one for pair in zip(*rankings, strict=True) for one in pair}.values())

    def _hit(
        self,
        stage: Round,
        entrants: Sequence[Candidate],
        dampings: Sequence[float],
        known: Mapping[str, Linear],
        own: Candidate,
    ) -> list[Standing]:
        """Find the stable walls of one round's sampling schemes by simulated hits; return the schemes, best first."""
        experiment, wishes = self.request.experiment, self.request.wishes
        b = sorted({*dampings, wishes.wall[1]} if wishes.wall else set(dampings))
        schemes = [one.scheme for one in entrants]
        search = search_for(experiment, stage.way, ratio=stage.ratio, schemes=schemes)
        grid = WallGrid(dampings=tuple(b), search=search, offsets=stage.offsets)
        cases = [(one.condition(experiment), one.scheme, grid) for one in entrants]
        maps = self.run.map_each(stage.name, cases)
        found = [
            self._make_standing(one, known[one.key], of_one, stage.ratio)
            for one, of_one in zip(entrants, maps, strict=True)
        ]
        own_area = _find_standing(found, own).measures.area
        return sorted(
            found, key=lambda one: rules.key(wishes, one.measures, one.shares, own_area), reverse=True
        )

    def _make_standing(self, candidate: Candidate, path: Linear, found: ZWidth, step: float) -> Standing:
        wishes, experiment = self.request.wishes, self.request.experiment
        boundary = tuple(found.curve(0, "any"))
        measures = Measures(
            **asdict(BoundaryMeasures.of([b.damping for b in boundary], [b.counted for b in boundary])),
            noise=path.noise,
            fidelity_hz=path.fidelity_hz,
            cost=path.cost,
        )
        shares = wishes.of_path(path.noise, path.fidelity_hz, path.cost)
        if wishes.wall is not None:
            stiffness, damping = wishes.wall
            (there,) = (b for b in boundary if b.damping == damping)
            shares["wall"] = min(1.0, there.lowest * step / stiffness, there.rendered / RENDERED)
        return Standing(
            candidate=candidate,
            label=candidate.scheme.label(candidate.condition(experiment)),
            measures=measures,
            shares=shares,
            boundary=boundary,
            stands_in=path.stands_in,
        )

    def _with_wall(self, finalists: list[Standing]) -> list[Standing]:
        """Simulate hits on the requested wall for each scheme of the last round; return the schemes with the result."""
        wall = self.request.wishes.wall
        if wall is None:
            return finalists
        experiment, (stiffness, damping) = self.request.experiment, wall
        # The ratio exceeds the range, so that the search tests one stiffness: the requested wall.
        one_rung = StiffnessSearch(way="grid", lowest=stiffness, highest=1.5 * stiffness, ratio=2.0)
        offsets = (*self.request.rounds[-1].offsets, *HELD_OUT_OFFSETS)
        grid = WallGrid(dampings=(damping,), search=one_rung, offsets=offsets)
        work = [(one.candidate.condition(experiment), one.candidate.scheme, grid) for one in finalists]
        found = []
        for one, of_one in zip(finalists, self.run.map_each("wished wall", work), strict=True):
            (boundary,) = of_one.curve(0, "any")
            holds = boundary.lowest > 0.0 and boundary.rendered >= RENDERED
            share = 1.0 if holds else min(one.shares["wall"], 0.99)
            found.append(replace(one, shares={**one.shares, "wall": share}))
        return sorted(found, key=lambda one: rules.fulfilled(one.shares), reverse=True)

    def _compare_held_out(self, best: Standing, own: Standing, dampings: Sequence[float]) -> Comparison:
        """Compare two schemes by simulated hits with encoder offsets and seeds that the search did not use."""
        searched = self.request.experiment
        changes = {"trial.seed": searched.trial.seed + HELD_OUT_SEED}
        experiment = config.override(searched, changes, "the comparison")
        last = self.request.rounds[-1]
        grid = WallGrid(
            dampings=tuple(dampings),
            search=search_for(
                experiment, last.way, ratio=last.ratio, schemes=[best.candidate.scheme, own.candidate.scheme]
            ),
            offsets=HELD_OUT_OFFSETS,
            repeats=HELD_OUT_REPEATS,
        )
        pair = (best.candidate, own.candidate)
        maps = self.run.map_each("held out", [(one.condition(experiment), one.scheme, grid) for one in pair])
        name = rules.measure_of(self.request.wishes.goal)
        return Comparison(
            *(tuple(getattr(one, name) for one in _measure_each_series(found)) for found in maps)
        )


def _measure_each_series(found: ZWidth) -> list[BoundaryMeasures]:
    """Return the measures of the stable walls separately for each encoder offset and repeat."""
    curve = found.curve(0, "any")
    dampings = [b.damping for b in curve]
    return [
        BoundaryMeasures.of(dampings, [b.limits[pair].stiffness * (b.rendered >= RENDERED) for b in curve])
        for pair in range(len(curve[0].limits))
    ]


def _find_standing(standings: Sequence[Standing], candidate: Candidate) -> Standing:
    return next(one for one in standings if one.candidate.key == candidate.key)


def _octaves(top: float, columns: int) -> tuple[float, ...]:
    return (0.0, *(top * 2.0**-n for n in reversed(range(columns - 1))))


def _damping_reach(standings: Sequence[Standing]) -> float:
    """Return the lowest tested damping above all dampings with a stable wall, or the largest one (SI units)."""
    dampings = [b.damping for b in standings[0].boundary]
    last = max(one.measures.damping for one in standings)
    return next((b for b in dampings if b > last), dampings[-1])


def _margin_point(best: Standing, wishes: Wishes) -> tuple[float, float]:
    """Return the damping at which robustness is tested, and the best scheme's limit of K there (SI units)."""
    if wishes.wall is not None:
        return wishes.wall[1], max(b.lowest for b in best.boundary if b.damping == wishes.wall[1])
    peak = max(best.boundary, key=lambda boundary: boundary.counted)
    return peak.damping, peak.stiffness
