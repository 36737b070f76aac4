"""Fit a linear mixed model of the participants' stiffness limits, by statsmodels, to compare conditions and dampings.

    limit ~ 0 + condition:damping + order + block
            + (1 | participant) + (1 | participant:condition) + (1 | participant:damping)

Estimates are REML with Student's intervals; for two conditions these equal the paired test. The test of a factor is a
likelihood ratio of ML fits. Without statsmodels (``haptic-rig[report]``), or if the model does not converge,
`Mixed.problem` contains the reason, and the paired tests of `rig.extras.study.kmax` are used.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import linear_model, mixed_linear_model, optimize, pandas, stats
from rig.extras.study.kmax import NONE_BEYOND, Beyond, Bound, Cell, beyond_of, bound_of, holm
from rig.extras.study.rows import Measure, Observed
from rig.session.search import is_resolved, unresolved_words

Floats = NDArray[np.float64]

LEAST_PARTICIPANTS = 3
FEW_PARTICIPANTS = 6
ENOUGH_PARTICIPANTS = 8  # for likelihood ratios
PARTS = {  # random parts of a participant, as formulas within a participant
    "participant": "1",
    "participant × condition": "0 + condition",
    "participant × damping": "0 + damping",
}
COVARIATES = ("order", "block")
RESIDUAL = "residual"
_STARTS = (0.01, 1.0)  # of every variance, in the residual's
_MOST = 1e7  # of a variance, in the residual's: beyond it nothing is left for the residual
_ZERO = 1e-4  # of the residual's variance: below it a variance is printed as zero
_LOST = 1e-3  # of log likelihood, that statsmodels may end below the optimum that was found


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """An estimated value of the model with its 95 % interval; no interval (NaN) for the covariates order and block."""

    name: str
    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Contrast:
    """Stiffness limit under `condition` minus that under `against`, at a damping or over their common ones (None).

    `holm` is p after Holm's correction. `beyond` counts the censored limits, which make the difference a `bound`.
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
    """Likelihood-ratio test of a factor: twice the log ratio of likelihoods, against χ² with `degrees` of freedom.

    "condition, at any damping" tests the condition together with its interaction, and so does "damping, in any
    condition" for the damping; "condition × damping" tests the interaction alone.
    """

    factor: str
    statistic: float
    degrees: int
    p: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Mixed:
    """Mixed model of the stiffness limits by one definition (`measure`), in units of stiffness.

    Attributes
    ----------
    problem
        Why there is no model; empty if there is one. Without a model all other fields are empty.
    notes
        Sentences about limitations of the model.
    participants, runs, beyond
        Participants and runs used, and the number of censored limits, which are replaced by the nearest level.
    degrees
        Degrees of freedom of all intervals.
    means
        Mean of each condition and damping, at the mean order and block; the key is (condition, damping).
    slopes
        Change of the limit per place (order) and per block, if it could be separated; without an interval.
    contrasts
        Differences between conditions.
    tests
        Likelihood ratios; empty for fewer than `ENOUGH_PARTICIPANTS` participants.
    deviations
        Standard deviation of each random part (`PARTS`) that can be estimated, 0 where its estimate is zero, and of the
        residual.
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


def fit_mixed(values: Sequence[Observed], measure: Measure, conditions: Sequence[str]) -> Mixed:
    """Fit the mixed model to stiffness limits by the definition `measure`. Raise no error: `problem` has the reason.

    Each of `conditions` is compared with all conditions before it in the sequence.
    """
    beyond = beyond_of((one.condition, one.damping, one.limit) for one in values)
    # A cell of which most limits are censored has the end of the levels as its mean.
    kept = [one for one in values if not beyond[one.condition, one.damping].mostly]
    cells = _sort_cells({(one.condition, one.damping) for one in kept}, conditions)
    problem = _problem(kept, cells, censored=len(cells) < len(beyond))
    if problem:
        return Mixed(measure=measure, problem=problem)
    design = _Design.of(kept, cells)
    # Participants − 1, or what values leave beside participants and fixed parts where that is less: a crossover whose
    # order is taken out leaves participants − 2.
    if design.degrees < 1:
        return Mixed(
            measure=measure,
            problem=f"{len(design.frame)} values are too few for {design.participants} participants and {len(cells)} "
            "conditions and dampings",
        )
    problem = design.unresolved(design.residual_deviation)
    if problem:
        return Mixed(measure=measure, problem=problem)
    with warnings.catch_warnings():
        # Ignore warnings of intermediate steps; the optimum itself is checked.
        warnings.simplefilter("ignore")
        try:
            model = _Model.of(design)
            tests = _tests(design) if design.participants >= ENOUGH_PARTICIPANTS else ()
        except np.linalg.LinAlgError:
            # A singular covariance matrix: a random part explains everything, and no residual remains.
            model = None
    if model is None:
        return Mixed(measure=measure, problem="the mixed model did not converge; the paired tests remain")
    problem = design.unresolved(model.deviations[-1][1])
    if problem:
        return Mixed(measure=measure, problem=problem)
    contrasts = _contrasts(design, model, beyond, conditions)
    notes = _notes(measure, design.participants, beyond, cells, _sort_cells(beyond, conditions))
    if not contrasts:
        notes.append("no two conditions share a damping, so no pair can be compared")
    return Mixed(
        measure=measure,
        notes=(*design.notes, *model.notes, *notes),
        participants=design.participants,
        runs=sum(one.runs for one in kept),
        beyond=sum((beyond[cell] for cell in cells), NONE_BEYOND),
        degrees=design.degrees,
        means=tuple((cell, model.term(_name(cell), design.weights({cell: 1.0}))) for cell in cells),
        slopes=tuple(
            Term(name=name, value=float(value))
            for name, value in zip(design.covariates, model.mean[len(cells) :], strict=True)
        ),
        contrasts=contrasts,
        tests=tests,
        deviations=model.deviations,
    )


def _sort_cells(cells: Iterable[Cell], conditions: Sequence[str]) -> list[Cell]:
    def in_order(cell: Cell) -> tuple[int, float]:
        condition, damping = cell
        return conditions.index(condition), damping

    return sorted(cells, key=in_order)


def _problem(kept: Sequence[Observed], cells: Sequence[Cell], *, censored: bool) -> str:
    participants = len({one.participant for one in kept})
    problem = ""
    if censored and not cells:
        problem = "most limits lie beyond the searched levels"
    elif participants < LEAST_PARTICIPANTS:
        problem = (
            f"{participants} participant{'' if participants == 1 else 's'} with a limit; differences between people "
            f"need {LEAST_PARTICIPANTS} or more"
        )
    elif len(cells) < 2:
        problem = "fewer than two conditions or dampings to compare"
        if censored:
            problem = f"most limits lie beyond the searched levels, except those of {_name(cells[0])}"
    elif len({one.limit.value for one in kept}) == 1:
        problem = "all limits are equal"
    elif not _is_installed():
        problem = "statsmodels is not installed: pip install 'haptic-rig[report]'"
    return problem


def _is_installed() -> bool:
    try:
        return bool(mixed_linear_model.MixedLM)
    except ImportError:
        return False


# ------------------------------------------------------------------------------------------------ what is modelled


@dataclass(frozen=True)
class _Design:
    """Data of the mixed model, with a row of `frame` for each participant and cell (condition, damping).

    Attributes
    ----------
    cells
        Conditions and dampings, in the order of their labels in the frame.
    middle, scale
        Mean and standard deviation of the limits, in stiffness; the frame has limits minus `middle` divided by `scale`.
    rounding
        Standard deviation of the error of the limits that rounding to the searched stiffnesses makes, in stiffness.
    covariates
        Those of order and block whose effect can be separated from cells and participants.
    notes
        Sentences about covariates that could not be separated.
    """

    frame: Any
    cells: Sequence[Cell]
    middle: float
    scale: float
    rounding: float
    covariates: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, values: Sequence[Observed], cells: Sequence[Cell]) -> _Design:
        """Build the data from limits: means over the repeats of each participant, by condition and damping."""
        where: list[Cell] = [(one.condition, one.damping) for one in values]
        conditions = list(dict.fromkeys(name for name, _ in cells))
        dampings = sorted({damping for _, damping in cells})
        # Numbers instead of names keep the order of factors, and keep users' names out of the formula.
        each = pandas.DataFrame(
            {
                "participant": [one.participant for one in values],
                "cell": [f"{cells.index(cell):03}" for cell in where],
                "condition": [f"{conditions.index(name):03}" for name, _ in where],
                "damping": [f"{dampings.index(damping):03}" for _, damping in where],
                "limit": [one.limit.value for one in values],
                "order": [one.order for one in values],
                "block": [one.block for one in values],
                "rounding": [one.limit.rounding**2 for one in values],
            }
        )
        groups = each.groupby(["participant", "cell", "condition", "damping"], as_index=False)
        frame = groups.mean()
        rounding = math.sqrt((frame.pop("rounding") / groups.size()["size"]).mean())
        middle, scale = frame["limit"].mean(), frame["limit"].std(ddof=0) or 1.0
        frame["limit"] = (frame["limit"] - middle) / scale
        design = cls(frame, cells, float(middle), float(scale), rounding)
        for name in COVARIATES:
            frame[name] -= frame[name].mean()
            if np.ptp(frame[name]) == 0.0:
                continue
            before = design.rank("cell", "participant", *design.covariates)
            after = design.rank("cell", "participant", *design.covariates, name)
            if before < after < len(frame):
                design.covariates.append(name)
            else:
                design.notes.append(
                    f"{name} cannot be separated from the conditions and participants, and is excluded"
                )
        return design

    def columns(self, *terms: str) -> Floats:
        """Return the design matrix of ``0 + terms``: all values of the first factor, all but one of later ones."""
        made = []
        for place, term in enumerate(terms):
            values = self.frame[[term]].to_numpy()
            levels = np.unique(values)[min(place, 1) :]
            made.append(values if term in COVARIATES else (values == levels).astype(np.float64))
        return np.hstack(made)

    def rank(self, *terms: str) -> int:
        return int(np.linalg.matrix_rank(self.columns(*terms)))

    @cached_property
    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        of = self.frame.groupby("participant")
        return of.ngroup().to_numpy(), of.cumcount().to_numpy()

    def by_person(self, values: Floats) -> Floats:
        """Arrange `values` in a row for each participant, padded with zeros: shape (participants, n, …)."""
        person, own = self._places
        rows = np.zeros((person.max() + 1, own.max() + 1, *values.shape[1:]))
        rows[person, own] = values
        return rows

    @cached_property
    def alike(self) -> list[Floats]:
        """For each random part, 1 where two of a participant's values share a level: shape (participants, n, n)."""
        found = []
        for part in self.parts:
            groups = self.frame.groupby(["participant", *part.split(" × ")[1:]]).ngroup().to_numpy()
            number = self.by_person(groups + 1.0)
            same = (number[:, :, None] == number[:, None]) & (number[:, :, None] > 0.0)
            found.append(same.astype(np.float64))
        return found

    @cached_property
    def participants(self) -> int:
        return int(self.frame["participant"].nunique())

    @cached_property
    def degrees(self) -> int:
        """Degrees of freedom of a difference: participants - 1, or fewer if there are too few values."""
        taken = self.rank("cell", "participant", *self.covariates)
        return min(self.participants - 1, len(self.frame) - taken)

    @cached_property
    def residual_deviation(self) -> float:
        """Residual standard deviation (stiffness) of a least-squares fit of all fixed effects and participants."""
        columns, limits = self.columns("cell", "participant", *self.covariates), self.frame["limit"]
        rest = limits - columns @ np.linalg.lstsq(columns, limits, rcond=None)[0]
        free = len(limits) - int(np.linalg.matrix_rank(columns))
        return math.sqrt(float(rest @ rest) / free) * self.scale

    def unresolved(self, deviation: float) -> str:
        """Return the reason why a residual deviation (stiffness) gives no interval and no p; empty if it does."""
        if is_resolved(deviation, self.rounding, abs(self.middle) + self.scale):
            return ""
        return unresolved_words("the residuals within participants", deviation, self.rounding)

    @cached_property
    def parts(self) -> list[str]:
        """Names of the random parts that can be estimated: they need repeated values within participants."""
        found = ["participant"]
        for part in list(PARTS)[1:]:
            factor = part.split()[-1]
            pairs = self.frame.groupby(["participant", factor]).ngroups
            if self.frame[factor].nunique() > 1 and pairs < len(self.frame):
                found.append(part)
        return found

    def weights(self, of: Mapping[Cell, float]) -> Floats:
        """Return the weights of all fixed effects: `of` for the cells (condition, damping), 0 for covariates."""
        return np.array([*(of.get(cell, 0.0) for cell in self.cells), *(0.0 for _ in self.covariates)])


# ------------------------------------------------------------------------------------------------ the fit


@dataclass(frozen=True)
class _Optimum:
    """The largest log likelihood, and the variances of the random parts at this maximum over the residual's."""

    likelihood: float
    variances: Mapping[str, float]


def _minus_log_likelihood(
    variances: Floats, count: int, limits: Floats, fixed: Floats, parts: Sequence[Floats], reml: bool
) -> tuple[float, Floats]:
    """Return minus the log likelihood and its gradient, for variances of the random parts over the residual's.

    Fixed effects and residual variance are at their maximum-likelihood values. The arrays have the form of
    `_Design.by_person`: `count` values, padded with zeros that add nothing to a sum.
    """
    covariance = np.eye(limits.shape[1]) + sum(v * part for v, part in zip(variances, parts, strict=True))
    inverse = np.linalg.inv(covariance)
    weighted = inverse @ fixed
    information = np.einsum("pvi,pvj->ij", fixed, weighted)
    effects = np.linalg.solve(information, np.einsum("pvi,pv->i", weighted, limits))
    residual = np.einsum("pvw,pw->pv", inverse, limits - fixed @ effects)
    freedom, squares = count, float(np.sum(limits * residual))
    _, log_determinants = np.linalg.slogdet(covariance)
    value = float(log_determinants.sum())
    gradient = np.array([np.sum(inverse * part) for part in parts])
    if reml:
        freedom -= len(information)
        _, log_determinant = np.linalg.slogdet(information)
        value += float(log_determinant)
        projected = weighted @ np.linalg.solve(information, np.swapaxes(weighted, 1, 2))
        gradient -= [np.sum(projected * part) for part in parts]
    squares = max(squares, np.finfo(np.float64).tiny)  # rounding may give 0 if no residual remains
    value += freedom * (math.log(2.0 * math.pi * squares / freedom) + 1.0)
    gradient -= [freedom / squares * np.einsum("pv,pvw,pw", residual, part, residual) for part in parts]
    return 0.5 * value, 0.5 * gradient


def _optimum(design: _Design, fixed: Floats, *, reml: bool = True) -> _Optimum | None:
    parts, limits = design.alike, design.frame["limit"].to_numpy()
    data = len(limits), design.by_person(limits), design.by_person(fixed), parts
    # The optimisers of statsmodels work on square roots of the variances, where the likelihood is flat at a variance of
    # zero. Tried on 2026-11-29 (statsmodels 0.15.0, 70 fits to 14 studies): those with gradients stop up to 0.63 short
    # of the largest log likelihood; Powell's method, which needs no gradient, at most 0.0007, but at a variance of zero
    # it ends in a singular matrix whatever its start (one of 16 studies of six people, and people who differ by chance
    # alone). So the variances themselves are varied, within bounds, from two starts.
    found = [
        optimize.minimize(
            _minus_log_likelihood,
            np.full(len(parts), start),
            args=(*data, reml),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, _MOST)] * len(parts),
            options={"ftol": 1e-13, "gtol": 1e-7},
        )
        for start in _STARTS
    ]
    best = min(found, key=lambda one: float(one.fun))
    if not math.isfinite(best.fun) or max(best.x) >= _MOST:
        return None
    return _Optimum(-float(best.fun), dict(zip(design.parts, best.x.tolist(), strict=True)))


@dataclass(frozen=True)
class _Model:
    """Fitted mixed model: fixed effects (cells, then covariates) and their covariance matrix, in units of stiffness."""

    mean: Floats
    covariance: Floats
    deviations: tuple[tuple[str, float], ...]
    degrees: int
    notes: list[str]

    @classmethod
    def of(cls, design: _Design) -> _Model | None:
        """Fit the mixed model by REML, without random parts of zero variance; return None if it does not converge."""
        optimum = _optimum(design, design.columns("cell", *design.covariates))
        if optimum is None:
            return None
        parts = [part for part, variance in optimum.variances.items() if variance >= _ZERO]
        none = [part for part in design.parts if part not in parts]
        formula = f"limit ~ 0 + {' + '.join(['cell', *design.covariates])}"
        if parts:
            fit = mixed_linear_model.MixedLM.from_formula(
                formula, design.frame, groups="participant", vc_formula={part: PARTS[part] for part in parts}
            ).fit(
                start_params=mixed_linear_model.MixedLMParams.from_components(
                    np.zeros(0),
                    cov_re=np.zeros((0, 0)),
                    vcomp=np.array([optimum.variances[part] for part in parts]),
                ),
                method=["bfgs", "lbfgs"],
            )
            variances = dict(zip(parts, fit.vcomp.tolist(), strict=True))
            if not fit.llf > optimum.likelihood - _LOST:
                return None
        else:
            fit = linear_model.OLS.from_formula(formula, design.frame).fit()
            variances = {}
        mean = np.array(fit.params[: len(design.cells) + len(design.covariates)]) * design.scale
        mean[: len(design.cells)] += design.middle
        covariance = np.asarray(fit.cov_params())[: len(mean), : len(mean)] * design.scale**2
        deviations = {part: math.sqrt(variances.get(part, 0.0)) * design.scale for part in design.parts}
        return cls(
            mean=mean,
            covariance=covariance,
            deviations=(*deviations.items(), (RESIDUAL, math.sqrt(fit.scale) * design.scale)),
            degrees=design.degrees,
            notes=[f"the variance of {' and of '.join(none)} is estimated as zero"] if none else [],
        )

    def term(self, name: str, weights: Floats) -> Term:
        value, deviation = float(weights @ self.mean), self.deviation(weights)
        low, high = stats.t.interval(0.95, self.degrees, value, deviation)
        return Term(name=name, value=value, low=float(low), high=float(high))

    def p(self, weights: Floats) -> float:
        return float(
            2.0 * stats.t.sf(abs(float(weights @ self.mean)) / self.deviation(weights), self.degrees)
        )

    def deviation(self, weights: Floats) -> float:
        return math.sqrt(float(weights @ self.covariance @ weights))


# ------------------------------------------------------------------------------------------------ what it says


def _contrasts(
    design: _Design, model: _Model, beyond: Mapping[Cell, Beyond], conditions: Sequence[str]
) -> tuple[Contrast, ...]:
    dampings: list[float | None] = [*sorted({damping for _, damping in design.cells})]
    if len(dampings) > 1:
        dampings.append(None)
    found: list[Contrast] = []
    for damping in dampings:
        for against, condition in combinations(conditions, 2):
            of = _difference(beyond, condition, against, damping)
            if not of or not set(of) <= set(design.cells):
                continue
            weights = design.weights(of)
            term = model.term("", weights)
            behind = {cell: beyond[cell] for cell in of}
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


def _difference(
    cells: Iterable[Cell], condition: str, against: str, damping: float | None
) -> dict[Cell, float]:
    """Return the weights of the means (condition, damping) in a difference; empty if too few dampings are shared."""
    tested = {name: {of_cell for other, of_cell in cells if other == name} for name in (condition, against)}
    common = tested[condition] & tested[against]
    if damping is not None:
        common &= {damping}
    elif len(common) < 2:
        return {}
    return {
        (name, of_cell): (1.0 if name == condition else -1.0) / len(common)
        for name in tested
        for of_cell in common
    }


def _tests(design: _Design) -> tuple[LikelihoodRatio, ...]:
    """Return likelihood-ratio tests of the full model against models without condition, damping, or interaction.

    A factor is left out if it cannot be separated from the others, or if one of its fits does not converge.
    """
    several = design.frame["condition"].nunique() > 1 and design.frame["damping"].nunique() > 1
    reduced = {
        "condition" + (", at any damping" if several else ""): ["damping"],
        "damping" + (", in any condition" if several else ""): ["condition"],
        "condition × damping": ["condition", "damping"],
    }
    whole = _optimum(design, design.columns("cell", *design.covariates), reml=False)
    found = []
    for factor, terms in reduced.items():
        fixed = design.columns(*terms, *design.covariates)
        rank = int(np.linalg.matrix_rank(fixed))
        degrees = len(design.cells) + len(design.covariates) - rank
        if degrees <= 0 or rank < fixed.shape[1]:
            continue
        without = _optimum(design, fixed, reml=False)
        if whole is None or without is None:
            continue
        statistic = max(2.0 * (whole.likelihood - without.likelihood), 0.0)
        p = float(stats.chi2.sf(statistic, degrees))
        found.append(LikelihoodRatio(factor=factor, statistic=statistic, degrees=degrees, p=p))
    return tuple(found)


def _notes(
    measure: Measure,
    participants: int,
    beyond: Mapping[Cell, Beyond],
    cells: Sequence[Cell],
    of_all: Sequence[Cell],
) -> list[str]:
    notes = []
    if measure != "rule":
        notes.append("one K50 per participant, condition and damping, estimated from all verdicts there")
    if participants < FEW_PARTICIPANTS:
        notes.append(
            f"{participants} participants: the variance between people is imprecise, so p and intervals are approximate"
        )
    if participants < ENOUGH_PARTICIPANTS:
        notes.append(
            f"likelihood ratios of factors are omitted: with fewer than {ENOUGH_PARTICIPANTS} participants they report "
            "false differences too often"
        )
    for cell in of_all:
        if cell not in cells:
            counts = beyond[cell]
            notes.append(
                f"{counts.count} of {counts.limits} limits of {_name(cell)} lie beyond the searched levels: excluded"
            )
    within = sum((beyond[cell] for cell in cells), NONE_BEYOND)
    if within.count:
        notes.append(
            f"{within.count} of {within.limits} limits lie beyond the searched levels and are replaced by the nearest "
            "level: differences are biased, usually towards zero; unequal spread can produce a false difference"
        )
    return notes


def _name(cell: Cell) -> str:
    condition, damping = cell
    return f"{condition}, B = {damping:g}"
