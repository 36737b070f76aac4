"""Differences between conditions over participants: a linear mixed model of their limits, by statsmodels.

    K = mean(condition, damping) + order + block
        + participant + participant × condition + participant × damping + residual

A value is the mean over the repeats of a participant in a cell (a condition at a damping): repeats of one person are no
more people, and what a person has of their own in a cell belongs to the residual. Condition and damping are factors,
each pair with a mean of its own. *Order* (place in the block) and *block* are straight lines that take out what order
and fatigue do; they are no findings (those are in `rig.session.analysis.effects`), and one that cannot be told from
conditions and participants is left out. The random parts of condition and damping are there where there are several
dampings and several conditions; else they are the residual.

Means and differences are REML estimates with Student's intervals, which for two conditions are the paired test. Degrees
of freedom are participants − 1, or what values leave beside participants and fixed parts where that is less (a
crossover whose order is taken out leaves participants − 2).

Whether a factor matters at all is a likelihood ratio of ML fits, from eight participants on. Without any difference, in
2000 simulated studies of 2 conditions × 3 dampings × 5 repeats in which each person has a cell of their own (SD 20,
participant × condition 15, residual 12), p was below 0.05 for the condition, the damping and their interaction in 9, 8
and 8 % with 8 participants, 9, 7 and 8 % with 12, 7, 6 and 7 % with 20. Repeats that count as people gave 57, 89 and
60 % with 8. With one damping and two conditions it is 12, 9, 8 and 7 % with 4, 6, 8 and 12 participants, by the paired
test that it amounts to. Intervals of differences held zero in 97 % of 150 studies of the first kind with 8
participants, at a damping and over all of them.

A cell of which most limits are censored is left out: its mean is the end of the levels, and it scatters as little as
that. There is no model for censored values (Tobit).

statsmodels comes with the extra ``haptic-rig[report]`` and is imported on use. Without it, or where the model cannot be
had, the reason is said, and the paired tests of `rig.session.analysis.kmax` remain.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import mixed_linear_model, stats
from rig.session.analysis.kmax import NONE_BEYOND, Beyond, Bound, Cell, beyond_of, bound_of, holm
from rig.session.analysis.rows import Measure, Observed

Floats = NDArray[np.float64]

LEAST_PARTICIPANTS = 3
FEW_PARTICIPANTS = 6
ENOUGH_PARTICIPANTS = 8  # for likelihood ratios
PARTS = ("participant", "participant × condition", "participant × damping")  # random
_OPTIMISERS = ["bfgs", "lbfgs", "powell"]
_NOTHING = 0.01  # of log likelihood: a variance that gains no more is none
_ZERO = 0.01  # of the residual's variance: an optimiser that stops at less has found zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """A number of the model with its interval of 95 %; NaN for terms that are only taken out."""

    name: str
    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Contrast:
    """`condition` less `against`, at a damping, or over the dampings that both have (None).

    `holm`, `bound` and `beyond` as in `rig.session.analysis.kmax.Paired`.
    """

    condition: str
    against: str
    damping: float | None
    difference: float
    low: float
    high: float
    p: float
    holm: float
    bound: Bound
    beyond: Beyond


@dataclass(frozen=True, slots=True, kw_only=True)
class LikelihoodRatio:
    """Whether a factor matters: twice the log ratio of likelihoods, against χ² with so many degrees of freedom.

    "condition, at any damping" asks for the condition and its interaction at once, and so does damping; "condition ×
    damping" asks for the interaction alone.
    """

    factor: str
    statistic: float
    degrees: int
    p: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixed:
    """The model of one measure.

    Attributes
    ----------
    problem
        Why there is no model; empty when there is one. All that follows is empty then.
    notes
        What must be known beside the numbers.
    participants, runs, beyond
        That it is of; and how many of its limits are censored, and enter with the end of the levels.
    degrees
        Of freedom, of all intervals.
    means
        Of each condition and damping, at the middle of order and block; the name is (condition, damping).
    slopes
        Of order and block, in stiffness for each place and each block; taken out, so they have no interval.
    contrasts
        Differences.
    tests
        Likelihood ratios; none below `ENOUGH_PARTICIPANTS`.
    deviations
        Standard deviation of each random part (`PARTS`, as far as they can be told; 0 where the estimate is zero), and
        of the residual.
    """

    measure: Measure
    problem: str = ""
    notes: tuple[str, ...] = ()
    participants: int = 0
    runs: int = 0
    beyond: Beyond = NONE_BEYOND
    degrees: int = 0
    means: tuple[tuple[Cell, Term], ...] = ()
    slopes: tuple[Term, ...] = ()
    contrasts: tuple[Contrast, ...] = ()
    tests: tuple[LikelihoodRatio, ...] = ()
    deviations: tuple[tuple[str, float], ...] = ()


def mixed(values: Sequence[Observed], measure: Measure, conditions: Sequence[str]) -> Mixed:
    """Fit the model to limits by a measure; never raises, says what is in the way.

    `conditions` are in the order in which they are compared: each with those before it.
    """
    data = _Data.of(values, conditions)
    problem = _problem(data)
    if problem:
        return Mixed(measure=measure, problem=problem)
    model = _fitted(data)
    if isinstance(model, str):
        return Mixed(measure=measure, problem=model)
    contrasts = _contrasts(data, model)
    size, cells = len(model.mean), len(data.cells)
    return Mixed(
        measure=measure,
        notes=(*model.notes, *_notes(data, contrasts, measure)),
        participants=data.participants,
        runs=data.runs,
        beyond=sum((data.beyond[cell] for cell in data.cells), NONE_BEYOND),
        degrees=model.degrees,
        means=tuple((cell, model.term(_name(cell), _unit(size, i))) for i, cell in enumerate(data.cells)),
        slopes=tuple(
            Term(name=name, value=float(model.mean[cells + i])) for i, name in enumerate(model.covariates)
        ),
        contrasts=contrasts,
        tests=_tests(data, model),
        deviations=model.deviations,
    )


# ------------------------------------------------------------------------------------------------ what is modelled


@dataclass(frozen=True)
class _Data:
    """Arrays of equal length, an element for each participant and cell; of cells whose limits are mostly known."""

    limits: Floats  # means over repeats, as the following two
    order: Floats
    block: Floats
    codes: tuple[str, ...]
    of_cell: tuple[Cell, ...]
    conditions: tuple[str, ...]  # in the order in which they are compared
    beyond: dict[Cell, Beyond]  # of all cells, also those that are left out
    runs: int  # behind the limits

    @classmethod
    def of(cls, values: Sequence[Observed], conditions: Sequence[str]) -> _Data:
        """Means, participant by participant."""
        beyond = beyond_of((one.condition, one.damping, one.limit) for one in values)
        groups: dict[tuple[str, Cell], list[Observed]] = {}
        for one in sorted(values, key=lambda one: one.participant):
            cell = (one.condition, one.damping)
            if not beyond[cell].mostly:
                groups.setdefault((one.participant, cell), []).append(one)
        return cls(
            limits=np.array([_mean(one.limit.value for one in of) for of in groups.values()]),
            order=np.array([_mean(one.order for one in of) for of in groups.values()]),
            block=np.array([_mean(one.block for one in of) for of in groups.values()]),
            codes=tuple(code for code, _ in groups),
            of_cell=tuple(cell for _, cell in groups),
            conditions=tuple(conditions),
            beyond=beyond,
            runs=sum(one.runs for of in groups.values() for one in of),
        )

    @property
    def participants(self) -> int:
        """How many."""
        return len(set(self.codes))

    @property
    def cells(self) -> list[Cell]:
        """Pairs of condition and damping that the model has, in order."""
        return self._sorted(self.of_cell)

    @property
    def left_out(self) -> list[Cell]:
        """Those of which most limits are censored."""
        return self._sorted(cell for cell, beyond in self.beyond.items() if beyond.mostly)

    def _sorted(self, cells: Iterable[Cell]) -> list[Cell]:
        return sorted(set(cells), key=lambda cell: (self.conditions.index(cell[0]), cell[1]))

    @property
    def parts(self) -> tuple[str, ...]:
        """Random parts that can be told: of a factor, where each person has it at several values of the other one."""
        told = [PARTS[0]]
        for part, place in ((PARTS[1], 0), (PARTS[2], 1)):
            pairs = {(code, cell[place]) for code, cell in zip(self.codes, self.of_cell, strict=True)}
            several = len({cell[place] for cell in self.of_cell}) > 1
            if several and len(pairs) < len(self.codes):
                told.append(part)
        return tuple(told)

    @property
    def people(self) -> Floats:
        """A column for each participant."""
        return _indicators(self.codes, sorted(set(self.codes)))


def _mean(values: Iterable[float]) -> float:
    of = list(values)
    return sum(of) / len(of)


def _indicators(keys: Sequence[Any], values: Sequence[Any]) -> Floats:
    """A column for each value: 1 where a limit has it."""
    return np.array([[float(key == value) for value in values] for key in keys])


def _problem(data: _Data) -> str:
    """Why there can be no model; empty when there can."""
    problem = ""
    if data.left_out and not data.cells:
        problem = "most limits lie beyond the levels"
    elif data.participants < LEAST_PARTICIPANTS:
        problem = (
            f"{data.participants} participant{'' if data.participants == 1 else 's'} with a limit, where "
            f"differences between people need {LEAST_PARTICIPANTS} or more"
        )
    elif len(data.cells) < 2:
        problem = "there are no two conditions or dampings to compare"
        if data.left_out:
            problem = f"most limits lie beyond the levels, save those of {_name(data.cells[0])}"
    elif _degrees(data, _indicators(data.of_cell, data.cells)) < 1:
        problem = (
            f"{len(data.limits)} values are too few for {data.participants} participants and {len(data.cells)} "
            "conditions and dampings"
        )
    elif float(np.ptp(data.limits)) == 0.0:
        problem = "all limits are alike"
    elif not _installed():
        problem = "statsmodels is not installed: pip install 'haptic-rig[report]'"
    return problem


def _installed() -> bool:
    try:
        return bool(mixed_linear_model.MixedLM)
    except ImportError:
        return False


def _degrees(data: _Data, design: Floats) -> int:
    """Degrees of freedom of a difference within participants: what people leave, or values where that is less."""
    taken = int(np.linalg.matrix_rank(np.column_stack([design, data.people])))
    return min(data.participants - 1, len(data.limits) - taken)


# ------------------------------------------------------------------------------------------------ the fit


@dataclass(frozen=True)
class _Model:
    """A fit: fixed effects (cells, then covariates) with their covariance, in units of stiffness."""

    mean: Floats
    covariance: Floats
    covariates: tuple[str, ...]
    parts: tuple[str, ...]
    deviations: tuple[tuple[str, float], ...]
    degrees: int
    notes: tuple[str, ...]

    def term(self, name: str, weights: Floats) -> Term:
        """A linear combination of the fixed effects."""
        value = float(weights @ self.mean)
        half = float(stats.t.ppf(0.975, self.degrees)) * self.deviation(weights)
        return Term(name=name, value=value, low=value - half, high=value + half)

    def p(self, weights: Floats) -> float:
        """Two-sided p that a linear combination is zero."""
        deviation = self.deviation(weights)
        if deviation == 0.0:
            return math.nan
        return float(2.0 * stats.t.sf(abs(float(weights @ self.mean)) / deviation, self.degrees))

    def deviation(self, weights: Floats) -> float:
        """Standard error of a linear combination."""
        return math.sqrt(max(float(weights @ self.covariance @ weights), 0.0))


def _fitted(data: _Data) -> _Model | str:
    """The model, or a sentence that says why there is none."""
    design, covariates, notes = _design(data, _indicators(data.of_cell, data.cells))
    middle, scale = float(data.limits.mean()), float(data.limits.std())
    cells = len(data.cells)
    fit, parts = _structured(data, design)
    if fit is None:
        return "the mixed model did not converge; the paired tests remain"
    mean = np.asarray(fit.fe_params, dtype=np.float64) * scale
    mean[:cells] += middle
    size = len(mean)
    residual = float(fit.scale)
    variances = dict(zip(parts, [float(np.asarray(fit.cov_re)[0, 0]), *fit.vcomp], strict=True))
    told = {part: value if value >= _ZERO * residual else 0.0 for part, value in variances.items()}
    none = [part for part in data.parts if told.get(part, 0.0) == 0.0]
    if none:
        notes = (*notes, f"the variance of {' and of '.join(none)} is estimated as zero")
    return _Model(
        mean=mean,
        covariance=np.asarray(fit.cov_params(), dtype=np.float64)[:size, :size] * scale**2,
        covariates=covariates,
        parts=parts,
        deviations=(
            *((part, math.sqrt(told.get(part, 0.0)) * scale) for part in data.parts),
            ("what is left", math.sqrt(residual) * scale),
        ),
        degrees=_degrees(data, design),
        notes=notes,
    )


def _design(data: _Data, factors: Floats) -> tuple[Floats, tuple[str, ...], tuple[str, ...]]:
    """Columns of the factors and of the covariates that can be told from them and from people; and what could not."""
    design = factors
    names: list[str] = []
    notes: list[str] = []
    for name, values in (("order", data.order), ("block", data.block)):
        if float(np.ptp(values)) == 0.0:
            continue
        wider = np.column_stack([design, values - values.mean()])
        ranks = [int(np.linalg.matrix_rank(np.column_stack([one, data.people]))) for one in (design, wider)]
        if ranks[1] > ranks[0] and len(data.limits) > ranks[1]:
            design, names = wider, [*names, name]
        else:
            notes.append(f"{name} cannot be told from the conditions and participants, and is left out")
    return design, tuple(names), tuple(notes)


def _structured(data: _Data, design: Floats) -> tuple[Any, tuple[str, ...]]:
    """The fit with as many of the random parts as converge, and these parts; None where that would lose something."""
    best = -math.inf
    for parts in _simpler(data.parts):
        fit = _fit(data, design, parts)
        if fit is None:
            continue
        if _converged(fit):
            return (fit, parts) if best - float(fit.llf) <= _NOTHING else (None, ())
        best = max(best, float(fit.llf))
    return None, ()


def _simpler(parts: tuple[str, ...]) -> list[tuple[str, ...]]:
    """All sets of random parts, the largest first; the participant is in all of them."""
    further = parts[1:]
    return [
        (parts[0], *some) for count in range(len(further), -1, -1) for some in combinations(further, count)
    ]


def _fit(data: _Data, design: Floats, parts: Sequence[str], *, reml: bool = True) -> Any:
    """A fit by statsmodels of limits in units of their deviation, None when it breaks down."""
    limits = (data.limits - data.limits.mean()) / data.limits.std()
    codes = np.array(data.codes)
    names: list[str] = []
    labels: list[list[list[str]]] = []
    columns: list[list[Floats]] = []
    for part in parts[1:]:
        keys = np.array([cell[PARTS.index(part) - 1] for cell in data.of_cell])
        each = [keys[codes == code] for code in dict.fromkeys(data.codes)]  # sorted, as `_Data.of` has them
        names.append(part)
        labels.append([[str(value) for value in np.unique(of)] for of in each])
        columns.append([np.asarray(of[:, None] == np.unique(of), dtype=np.float64) for of in each])
    components = mixed_linear_model.VCSpec(names, labels, columns) if names else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what they say is looked up: `_converged`
        try:
            model = mixed_linear_model.MixedLM(
                limits, design, codes, exog_re=np.ones((len(limits), 1)), exog_vc=components
            )
            fit = model.fit(reml=reml, method=_OPTIMISERS)
            return fit if math.isfinite(float(fit.llf)) and np.isfinite(fit.cov_params()).any() else None
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            return None


def _converged(fit: Any) -> bool:
    return fit is not None and bool(fit.converged)


# ------------------------------------------------------------------------------------------------ what it says


def _contrasts(data: _Data, model: _Model) -> tuple[Contrast, ...]:
    cells = data.cells
    conditions = [name for name in data.conditions if name in {condition for condition, _ in cells}]
    dampings: list[float | None] = [*sorted({damping for _, damping in cells})]
    if len(dampings) > 1:
        dampings.append(None)
    found: list[Contrast] = []
    for damping in dampings:
        for against, condition in combinations(conditions, 2):
            weights = _difference(data, len(model.mean), condition, against, damping)
            if weights is None:
                continue
            term = model.term("", weights)
            of = [cell for cell, weight in zip(cells, weights, strict=False) if weight]
            behind = {cell: data.beyond[cell] for cell in of}
            found.append(
                Contrast(
                    condition=condition,
                    against=against,
                    damping=damping,
                    difference=term.value,
                    low=term.low,
                    high=term.high,
                    p=model.p(weights),
                    holm=math.nan,
                    bound=bound_of(behind, condition, against),
                    beyond=sum(behind.values(), NONE_BEYOND),
                )
            )
    corrected = holm([one.p for one in found])
    return tuple(replace(one, holm=p) for one, p in zip(found, corrected, strict=True))


def _difference(data: _Data, size: int, condition: str, against: str, damping: float | None) -> Floats | None:
    """Weights of the fixed effects for a difference.

    None without a damping in common; for their mean with fewer than two, or where one of them had to be left out.
    """
    of = {name: {b for other, b in data.beyond if other == name} for name in (condition, against)}
    both = {damping} if damping is not None else of[condition] & of[against]
    cells = data.cells
    wanted = [(name, b) for name in (condition, against) for b in both]
    if len(both) < (2 if damping is None else 1) or not set(wanted) <= set(cells):
        return None
    weights = np.zeros(size)
    for cell in wanted:
        weights[cells.index(cell)] = (1.0 if cell[0] == condition else -1.0) / len(both)
    return weights


def _tests(data: _Data, model: _Model) -> tuple[LikelihoodRatio, ...]:
    """Likelihood ratios of the full model against those without condition, damping, and their interaction."""
    if data.participants < ENOUGH_PARTICIPANTS:
        return ()
    conditions, dampings = zip(*data.of_cell, strict=True)
    by_condition = _indicators(conditions, sorted(set(conditions)))
    by_damping = _indicators(dampings, sorted(set(dampings)))
    lines = {"order": data.order, "block": data.block}
    covariates = [lines[name] - lines[name].mean() for name in model.covariates]

    def with_lines(factors: Floats) -> Floats:
        return np.column_stack([factors, *covariates])

    full = with_lines(_indicators(data.of_cell, data.cells))
    several = by_condition.shape[1] > 1 and by_damping.shape[1] > 1
    reduced = {
        "condition" + (", at any damping" if several else ""): by_damping,
        "damping" + (", in any condition" if several else ""): by_condition,
        "condition × damping": np.column_stack([by_condition, by_damping[:, 1:]]),
    }
    whole = _fit(data, full, model.parts, reml=False)
    told = [
        _likelihood_ratio(data, model, factor, whole, full, with_lines(of)) for factor, of in reduced.items()
    ]
    return tuple(test for test in told if test is not None)


def _likelihood_ratio(
    data: _Data, model: _Model, factor: str, whole: Any, full: Floats, reduced: Floats
) -> LikelihoodRatio | None:
    """None where the factor cannot be told from the rest, or a fit does not converge."""
    rank = int(np.linalg.matrix_rank(reduced))
    degrees = full.shape[1] - rank
    if degrees <= 0 or rank < reduced.shape[1] or not _converged(whole):
        return None
    fit = _fit(data, reduced, model.parts, reml=False)
    if not _converged(fit):
        return None
    statistic = max(2.0 * (float(whole.llf) - float(fit.llf)), 0.0)
    return LikelihoodRatio(
        factor=factor, statistic=statistic, degrees=degrees, p=float(stats.chi2.sf(statistic, degrees))
    )


def _notes(data: _Data, contrasts: Sequence[Contrast], measure: Measure) -> list[str]:
    told = []
    if measure != "rule":
        told.append(
            "K50 is told from all verdicts of a participant under a condition at a damping, one value for each"
        )
    if data.participants < FEW_PARTICIPANTS:
        told.append(
            f"{data.participants} participants: the variance between people is hardly known, and p and intervals "
            "are rough"
        )
    if data.participants < ENOUGH_PARTICIPANTS:
        told.append(
            f"likelihood ratios of factors are left out: with fewer than {ENOUGH_PARTICIPANTS} participants they find "
            "differences too often"
        )
    for cell in data.left_out:
        beyond = data.beyond[cell]
        told.append(
            f"{beyond.count} of {beyond.limits} limits of {_name(cell)} lie beyond the levels, and it is left out"
        )
    within = sum((data.beyond[cell] for cell in data.cells), NONE_BEYOND)
    if within.count:
        told.append(
            f"{within.count} of {within.limits} limits lie beyond the levels and enter with the end of them: "
            "differences are biased, usually towards zero; unequal spread can make a difference out of nothing"
        )
    if not contrasts:
        told.append("there are no two conditions to compare at the same damping")
    return told


def _unit(size: int, place: int) -> Floats:
    weights = np.zeros(size)
    weights[place] = 1.0
    return weights


def _name(cell: Cell) -> str:
    return f"{cell[0]}, B = {cell[1]:g}"
