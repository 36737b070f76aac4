"""Compute Cohen's kappa of a person's and the automatic verdicts, and the confusion matrices behind it.

    κ = (p_o − p_e) / (1 − p_e)

p_o is the share of trials with equal verdicts, p_e the share that is expected by chance; both are weighted if the
classes have an order. The automatic class "limit cycle" corresponds to "buzz". ``rig/session/README.md`` states how
often the interval contains the true value.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import stats
from rig.extras.study.rows import TrialRow
from rig.session.search import is_resolved, unresolved_words

Floats = NDArray[np.float64]
Weights = Literal["none", "linear", "quadratic"]

LEAST_PEOPLE = 5  # for an interval over them

TWO = ("stable", "not stable")
THREE = ("stable", "buzz", "unstable")
FOUR = (*THREE, "unsure")
AUTOMATIC = {"stable": "stable", "limit cycle": "buzz", "unstable": "unstable"}  # automatic verdict → class


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Confusion matrix of a person's and the automatic verdicts, and its kappa.

    Attributes
    ----------
    name
        "two classes", "three classes" or "four classes".
    condition
        Condition of the trials; empty for all conditions.
    weights
        How a confusion counts: "none": fully; "linear", "quadratic": by the distance of its classes, or its square.
    classes
        Names of the classes, for rows and columns.
    counts
        Number of trials: a row for each class of the person, a column for each class of the automatic verdict.
    trials, left_out
        Trials in the matrix; judged trials that are left out because one of the two verdicts is missing.
    people
        Number of people who judged the trials.
    share
        Share of trials with equal verdicts, without weights.
    positive, negative
        Agreement on "stable" and on "not stable": 2 n_both / (n_person + n_automatic) of the class. None without such
        verdicts, and for matrices of more than two classes.
    kappa
        Cohen's kappa; None if agreement by chance is already complete.
    low, high
        95 % interval over people (jackknife); None if `problem` gives a reason.
    """

    name: str
    condition: str
    weights: Weights
    classes: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    trials: int
    left_out: int
    people: int
    share: float | None
    positive: float | None
    negative: float | None
    kappa: float | None
    low: float | None
    high: float | None
    problem: str


def two_classes(trial: TrialRow) -> tuple[str | None, str | None]:
    """Return the person's and the automatic class of a trial: "stable" or "not stable"; None for a missing verdict.

    The automatic class follows the criterion of the study's protocol.
    """
    stable, not_stable = TWO
    person = {"stable": stable, "buzz": not_stable, "unstable": not_stable}.get(trial.verdict)
    automatic = None if trial.automatic_stable is None else stable if trial.automatic_stable else not_stable
    return person, automatic


def three_classes(trial: TrialRow) -> tuple[str | None, str | None]:
    """Return the person's and the automatic class of a trial: stable, buzz or unstable; None for a missing verdict."""
    person = trial.verdict if trial.verdict in THREE else None
    return person, AUTOMATIC.get(trial.automatic)


def four_classes(trial: TrialRow) -> tuple[str | None, str | None]:
    """Return the person's and the automatic class of a trial: stable, buzz, unstable or unsure; None if missing.

    The automatic class is "unsure" if the study's criterion could not be measured.
    """
    automatic = "unsure" if trial.automatic_stable is None else AUTOMATIC.get(trial.automatic)
    return trial.verdict or None, automatic


class _Kind(NamedTuple):
    name: str
    split: Callable[[TrialRow], tuple[str | None, str | None]]  # class of the person, class of the program
    classes: tuple[str, ...]
    weights: Weights


_KINDS = (
    _Kind("two classes", two_classes, TWO, "none"),
    _Kind("three classes", three_classes, THREE, "linear"),
    _Kind("three classes", three_classes, THREE, "quadratic"),
    _Kind("four classes", four_classes, FOUR, "none"),
)


def agreements(trials: Sequence[TrialRow]) -> tuple[Agreement, ...]:
    """Return the confusion matrices of people's and automatic verdicts: of all valid trials, then of each condition.

    Empty if no person judged.
    """
    judged = [
        trial for trial in trials if not trial.void and not trial.practice and trial.judged_by in _PEOPLE
    ]
    conditions = list(dict.fromkeys(trial.condition for trial in judged))
    chosen = ["", *conditions] if len(conditions) > 1 else [""]
    return tuple(
        _agreement(name, split, classes, weights, condition, judged)
        for condition in chosen
        for name, split, classes, weights in _KINDS
        if judged
    )


_PEOPLE = ("person", "simulated")


def _agreement(
    name: str,
    split: Callable[[TrialRow], tuple[str | None, str | None]],
    classes: tuple[str, ...],
    weights: Weights,
    condition: str,
    judged: Sequence[TrialRow],
) -> Agreement:
    of = [trial for trial in judged if condition in ("", trial.condition)]
    people = list(dict.fromkeys(trial.participant for trial in of))
    tables = np.zeros((len(people), len(classes), len(classes)))
    for trial in of:
        person, automatic = split(trial)
        if person is not None and automatic is not None:
            tables[people.index(trial.participant), classes.index(person), classes.index(automatic)] += 1
    counts = tables.sum(axis=0)
    within = int(counts.sum())
    value = _number(kappa(counts, weights))
    ends = _problem(counts, classes, value) or _jackknife(tables, weights)
    low, high = (None, None) if isinstance(ends, str) else ends
    # κ alone misleads where one class is rare: the agreement on each of two classes stands beside it (Cicchetti and
    # Feinstein, Journal of Clinical Epidemiology 43, 1990).
    positive, negative = (_class_agreement(counts, place) if len(classes) == 2 else None for place in (0, 1))
    return Agreement(
        name=name,
        condition=condition,
        weights=weights,
        classes=classes,
        counts=tuple(tuple(int(count) for count in row) for row in counts),
        trials=within,
        left_out=len(of) - within,
        people=len(people),
        share=float(np.trace(counts) / within) if within else None,
        positive=positive,
        negative=negative,
        kappa=value,
        low=None if low is None else max(low, -1.0),
        high=None if high is None else min(high, 1.0),
        problem=ends if isinstance(ends, str) else "",
    )


def _problem(counts: Floats, classes: Sequence[str], value: float | None) -> str:
    if not counts.any():
        return "no trial has both verdicts"
    for who, axis in (("the person's verdict", 1), ("the automatic verdict", 0)):
        given = np.flatnonzero(counts.sum(axis=axis))
        if len(given) == 1:
            of_chance = "not defined" if value is None else "0 in any case"
            return f"{who} was always “{classes[given[0]]}”, so agreement by chance is complete: κ is {of_chance}"
    if np.trace(counts) == counts.sum():
        return "all verdicts agree, so the uncertainty of κ = 1 cannot be estimated"
    return ""


def _class_agreement(counts: Floats, place: int) -> float | None:
    both = float(counts[place].sum() + counts[:, place].sum())
    return 2.0 * float(counts[place, place]) / both if both else None


def _jackknife(tables: Floats, weights: Weights) -> tuple[float, float] | str:
    tables = tables[tables.sum(axis=(1, 2)) > 0.0]
    people = len(tables)
    if people < LEAST_PEOPLE:
        who = "person" if people == 1 else "people"
        return f"verdicts of {people} {who}; an interval over people needs at least {LEAST_PEOPLE}"
    counts = tables.sum(axis=0)
    # The trials of one person are not independent: the interval is over people, by the jackknife that leaves out one at
    # a time.
    without = np.array([kappa(counts - one, weights) for one in tables])
    if not np.isfinite(without).all():
        return "κ is not defined when one of the people is left out (jackknife)"
    scatter = float(without.std(ddof=1))
    if not is_resolved(scatter, magnitude=1.0):
        return unresolved_words("the verdicts of the people", scatter, 0.0)
    deviation = (people - 1) * scatter / math.sqrt(people)
    low, high = stats.t.interval(0.95, people - 1, kappa(counts, weights), deviation)
    return float(low), float(high)


def kappa(counts: Floats | Sequence[Sequence[float]], weights: Weights = "none") -> float:
    """Return Cohen's kappa of a confusion matrix of shape (classes, classes).

    `weights` "none": all confusions count equally; "linear", "quadratic": by the distance of the classes, or its
    square. The result is NaN without trials, or if all verdicts of both judges are of one class.
    """
    table = np.asarray(counts, dtype=np.float64)
    total = table.sum()
    if total == 0.0:
        return math.nan
    share = table / total
    alike = _weigh_pairs(len(table), weights)
    rows, columns = share.sum(axis=1), share.sum(axis=0)
    observed, chance = float((alike * share).sum()), float(rows @ alike @ columns)
    if 1.0 - chance < 1e-12:
        return math.nan
    return (observed - chance) / (1.0 - chance)


def _weigh_pairs(classes: int, weights: Weights) -> Floats:
    place = np.arange(classes)
    distance = np.abs(place[:, None] - place[None, :]).astype(np.float64)
    if weights == "none":
        return np.asarray(distance == 0.0, dtype=np.float64)
    far = distance / max(classes - 1, 1)
    return np.asarray(1.0 - (far if weights == "linear" else far**2))


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
