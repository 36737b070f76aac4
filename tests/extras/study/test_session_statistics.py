"""The statistics of an analysis, against closed forms, scipy, statsmodels, and data with known truth."""

import itertools
import math
import sys
from dataclasses import MISSING, fields, replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rig.core import deferred
from rig.extras.study import agreement, effects, kmax, mixed, psychometric
from rig.extras.study.rows import LimitInterval, RunRow, TrialRow
from rig.extras.study.trials import half_way
from rig.session.search._observer import Observer
from tests.benchmarks import null_studies
from tests.conformance.tiers import first_by_default

# ---------------------------------------------------------------------- rows to work on


def blank(kind: Any, **known: Any) -> Any:
    return kind(**dict.fromkeys(one.name for one in fields(kind) if one.default is MISSING) | known)


def run_row(
    participant: str = "P01", condition: str = "a", damping: float = 0.0, value: float = 400.0, censored: str = "",
    **changes: Any,
) -> Any:  # fmt: skip
    limit = LimitInterval(value=value, low=value - 10, high=value + 10, censored=censored, share=0.5)
    known = {
        "participant": participant, "condition": condition, "damping": damping, "limits": {"rule": limit},
        "block": 1, "order": 1, "place": 1, "followed": "person", "state": "complete", "middle_trial": 10.0,
    }  # fmt: skip
    return blank(RunRow, **known | changes)


def runs_of_people(
    people: int = 8,
    repeats: int = 3,
    dampings: tuple[float, ...] = (0.0,),
    effect: float = 40.0,
    between: float = 40.0,
    interaction: float = 15.0,
    scatter: float = 12.0,
    seed: int = 1,
    **along: Any,
) -> Any:
    """Return runs of two conditions, the second stiffer by `effect`; order alternates, blocks are repeats."""
    drawn = np.random.default_rng(seed)
    rows = []
    for person in range(people):
        offset = drawn.normal(0.0, between)
        apart = dict.fromkeys(("a", "b"), 0.0) | {name: drawn.normal(0.0, interaction) for name in "ab"}
        for repeat in range(repeats):
            cells = list(itertools.product("ab" if (person + repeat) % 2 else "ba", dampings))
            for order, (condition, damping) in enumerate(cells, start=1):
                value = 400.0 + offset + apart[condition] + effect * (condition == "b") + 2.0 * damping
                value += along.get("order", 0.0) * order + along.get("block", 0.0) * (repeat + 1)
                value += drawn.normal(0.0, scatter)
                places = {"block": repeat + 1, "place": repeat * len(cells) + order, "repeat": repeat + 1}
                rows.append(run_row(f"P{person:02d}", condition, damping, value, order=order, **places))
    return rows


def model_of(rows: Any) -> Any:
    return mixed.fit_mixed(kmax.collect_limits(rows, "rule", {}), "rule", "ab")


def trial_row(
    participant: str = "P01", verdict: str = "stable", automatic: str = "stable", passes: bool | None = True,
    **changes: Any,
) -> Any:  # fmt: skip
    known = {
        "participant": participant, "condition": "a", "damping": 0.0, "block": 1, "trial": 1, "practice": False,
        "verdict": verdict, "judged_by": "person", "automatic": automatic, "automatic_stable": passes,
        "response_time_s": 1.0, "void": "", "aborted": "",
    }  # fmt: skip
    return blank(TrialRow, **known | changes)


# ---------------------------------------------------------------------- agreement

TABLES = st.integers(2, 4).flatmap(
    lambda size: st.lists(
        st.lists(st.integers(0, 60), min_size=size, max_size=size), min_size=size, max_size=size
    )
)


@settings(max_examples=30)
@given(
    counts=TABLES, weights=st.sampled_from([("none", None), ("linear", "linear"), ("quadratic", "quadratic")])
)
def test_kappa_is_that_of_statsmodels(counts: Any, weights: Any) -> None:
    table = np.array(counts, dtype=float)
    value = agreement.kappa(table, weights[0])
    if math.isnan(value):  # nothing, or nothing that chance would not do
        assert all(np.count_nonzero(table.sum(axis=axis)) <= 1 for axis in (0, 1))
        return
    with np.errstate(all="ignore"):  # theirs divides by nothing on its way
        theirs = import_module("statsmodels.stats.inter_rater").cohens_kappa(table, wt=weights[1])
    assert value == pytest.approx(theirs.kappa, abs=1e-9)


def test_verdicts_are_counted_in_their_tables() -> None:
    rows = [
        trial_row(),
        trial_row(verdict="buzz", automatic="limit cycle", passes=False),
        trial_row(verdict="buzz", automatic="limit cycle", passes=True),  # another criterion than the study's
        trial_row(verdict="unstable", automatic="unstable", passes=False),
        trial_row(verdict="unsure", automatic="stable", passes=True),
        trial_row(verdict="stable", automatic="stable", passes=None),
        trial_row(verdict="stable", void="redone"),
        trial_row(verdict="stable", practice=True),
        trial_row(verdict="stable", judged_by="automatic"),
    ]
    two, linear, quadratic, four = agreement.agreements(rows)
    assert two.counts == ((1, 0), (1, 2))
    assert (two.trials, two.left_out, two.people) == (4, 2, 1)
    assert linear.counts == quadratic.counts == ((2, 0, 0), (0, 2, 0), (0, 0, 1))
    assert (linear.kappa, linear.share) == (pytest.approx(1.0), 1.0)
    assert four.counts == ((1, 0, 0, 1), (0, 2, 0, 0), (0, 0, 1, 0), (1, 0, 0, 0))
    assert (four.left_out, four.low) == (0, None)


def judged(*counts: Any, people: int = 1) -> Any:
    """Return verdicts of people, by count: both stable, only the person, only the automatic verdict, neither."""
    cells = [(person, passes) for person in ("stable", "buzz") for passes in (True, False)]
    return [
        trial_row(f"P{number}", verdict, "stable" if passes else "limit cycle", passes)
        for number in range(people)
        for (verdict, passes), count in zip(cells, counts, strict=True)
        for _ in range(count)
    ]


@pytest.mark.parametrize(
    ("counts", "kappa", "why"),
    [
        (
            (8, 2, 0, 0),
            0.0,
            "the person's verdict was always “stable”, so agreement by chance is complete",
        ),
        ((8, 0, 2, 0), 0.0, "the automatic verdict was always “stable”"),
        ((8, 0, 0, 2), 1.0, "all verdicts agree, so the uncertainty of κ = 1"),
        ((5, 0, 0, 0), None, "κ is not defined"),
    ],
)
@pytest.mark.parametrize("people", [1, 6])
def test_a_table_without_information_has_no_interval_and_a_reason(
    counts: tuple[int, ...], kappa: float | None, why: str, people: int
) -> None:
    two = agreement.agreements(judged(*counts, people=people))[0]
    assert two.kappa == (None if kappa is None else pytest.approx(kappa))
    assert (two.low, two.high) == (None, None)
    assert why in two.problem


def test_agreement_on_a_rare_class_stands_beside_kappa() -> None:
    """Of 100 verdicts 96 agree; five are not stable by at least one judge, one of them by both."""
    two, three, *_ = agreement.agreements(judged(95, 2, 2, 1))
    assert (two.positive, two.negative) == (pytest.approx(190 / 194), pytest.approx(2 / 6))
    assert (three.positive, three.negative) == (None, None)
    alike, *_ = agreement.agreements(judged(5, 0, 0, 0))
    assert (alike.share, alike.positive, alike.negative) == (1.0, 1.0, None)
    assert (
        agreement.agreements([trial_row(judged_by="automatic"), trial_row(judged_by="", void="not judged")])
        == ()
    )


def test_an_interval_of_kappa_is_over_people_where_there_are_enough() -> None:
    """The jackknife of a mean is Student's interval; too few or identical people have none."""
    for people, why in (
        (1, "verdicts of 1 person; an"),
        (4, "verdicts of 4 people; an interval over people needs at least 5"),
        (6, "are equal"),
    ):
        two = agreement.agreements(judged(8, 2, 1, 9, people=people))[0]
        assert (two.low, two.high) == (None, None)
        assert why in two.problem
    tables = [(40, 10, 10, 40), (45, 5, 5, 45), (35, 15, 15, 35), (42, 8, 8, 42), (30, 20, 20, 30)]
    rows = [replace(row, participant=f"P{number}") for number, of in enumerate(tables) for row in judged(*of)]
    two = agreement.agreements(rows)[0]
    # κ is linear: margins are all a half.
    own = [agreement.kappa(np.array(of).reshape(2, 2)) for of in tables]
    expected = stats.ttest_1samp(own, 0.0).confidence_interval()
    assert two.people == 5
    assert (two.low, two.high) == pytest.approx((expected.low, expected.high))


# ---------------------------------------------------------------------- limits


def test_means_intervals_and_paired_tests_are_those_of_scipy() -> None:
    rows = runs_of_people(people=7)
    each = kmax.estimate_participants(rows, {})
    over = kmax.over_participants(each, "ab")
    means = {name: np.array([one.mean for one in each if one.condition == name]) for name in "ab"}
    for one in over:
        expected = stats.ttest_1samp(means[one.condition], 0.0).confidence_interval()
        assert (one.low, one.high) == pytest.approx((expected.low, expected.high))
        assert (one.participants, one.runs) == (7, 21)
    (difference,) = kmax.compare_pairs(each, "ab")
    expected = stats.ttest_rel(means["b"], means["a"])
    assert (difference.condition, difference.against) == ("b", "a")
    assert difference.p == pytest.approx(expected.pvalue)
    assert (difference.low, difference.high) == pytest.approx(tuple(expected.confidence_interval()))


@pytest.mark.parametrize("apart", first_by_default([25.0, 0.0]))
def test_people_who_all_differ_by_the_same_give_no_interval_and_no_p(apart: float) -> None:
    """On coarse levels all limits differ by the same number of levels; 0.1 tests rounding in their sum."""
    values = [400.1, 425.2, 450.7]
    rows = [
        run_row(f"P{person}", condition, value=value + 50.0 * person + apart * (condition == "b"))
        for person in range(4)
        for condition in "ab"
        for value in (values if condition == "a" else reversed(values))
    ]
    each = kmax.estimate_participants(rows, {})
    (one,) = kmax.compare_pairs(each, "ab")
    assert "the differences of the participants are equal" in one.problem
    assert one.difference == pytest.approx(apart)
    assert all(math.isnan(value) for value in (one.low, one.high, one.p, one.holm))
    assert not kmax.compare_pairs(kmax.estimate_participants(runs_of_people(), {}), "ab")[0].problem
    (alone,) = kmax.compare_pairs([row for row in each if row.participant == "P0"], "ab")
    assert "1 participant; an" in alone.problem


@settings(max_examples=30)
@given(p=st.lists(st.floats(0.0, 1.0, allow_subnormal=False), min_size=1, max_size=6))
def test_holm_is_what_testing_all_families_gives(p: list[float]) -> None:
    """Closed testing: a difference is significant if every family with it is, each by Bonferroni."""
    numbers = range(len(p))
    families = [f for size in range(1, len(p) + 1) for f in itertools.combinations(numbers, size)]
    expected = [max(min(1.0, len(f) * min(p[i] for i in f)) for f in families if one in f) for one in numbers]
    assert kmax.holm(p) == pytest.approx(expected)
    assert kmax.holm([math.nan, *p])[1:] == kmax.holm(p)


def test_a_bootstrap_of_four_values_against_all_their_samples() -> None:
    values = np.array([380.0, 395.0, 402.0, 440.0])
    low, high = kmax.bootstrap(values)
    means = np.array([np.mean(sample) for sample in itertools.product(values, repeat=4)])
    below = [(means < end).mean() + 0.5 * (means == end).mean() for end in (low, high)]
    assert below == pytest.approx([0.025, 0.975], abs=0.03)  # the correction shifts it by little here
    assert kmax.bootstrap(values) == (low, high)
    assert all(math.isnan(end) for end in kmax.bootstrap(np.array([400.0, 400.0, 400.0])))


@pytest.mark.parametrize(
    ("values", "interval", "low"),
    [
        ((400.0,), "run", 390.0),
        ((400.0, 425.0), "verdicts", 380.0),
        ((400.0, 400.0, 400.0), "verdicts", 380.0),
        ((400.0, 425.0, 412.0), "Student", None),
        (tuple(400.0 + 3.0 * n for n in range(9)), "Student", None),
        (tuple(400.0 + 3.0 * n for n in range(10)), "bootstrap", None),
    ],
)
def test_an_interval_says_what_it_is_of(values: Any, interval: str, low: float | None) -> None:
    rows = [run_row(value=value) for value in values]
    pooled = LimitInterval(value=400.0, low=380.0, high=440.0, censored="", share=0.5)
    (one,) = kmax.estimate_participants(rows, {("rule", "P01", ("a", 0.0)): pooled})
    assert (one.interval, one.repeats) == (interval, len(values))
    assert low is None or one.low == low
    assert math.isnan(one.student_low) == (len(set(values)) < 3)
    assert math.isnan(one.bootstrap_low) == (len(set(values)) < 3)
    if low is None:  # the other one stands beside it
        student, bootstrap = (one.student_low, one.student_high), (one.bootstrap_low, one.bootstrap_high)
        assert (one.low, one.high) == (student if interval == "Student" else bootstrap)
        assert student != bootstrap


def test_a_single_series_has_no_interval_of_its_own() -> None:
    endless = LimitInterval(value=400.0, low=0.0, high=math.inf, censored="", share=None)
    (one,) = kmax.estimate_participants([replace(run_row(), limits={"rule": endless})], {})
    assert (one.interval, math.isnan(one.low)) == ("none", True)


def test_limits_beyond_the_levels_are_counted_and_what_has_not_ended_is_left_out() -> None:
    rows = [run_row(), run_row(censored="above"), run_row(state="unfinished"), run_row(state="skipped")]
    (one,) = kmax.estimate_participants(rows, {})
    assert (one.repeats, one.limits, one.above, one.below) == (2, 2, 1, 0)


def test_repeats_that_are_mostly_bounds_have_the_open_interval_of_all_verdicts() -> None:
    """Two ends of the levels and a limit just below them scatter little, but do not locate the limit."""
    rows = [run_row(value=780.0), *(run_row(value=800.0, censored="above") for _ in range(2))]
    pooled = LimitInterval(value=800.0, low=790.0, high=math.inf, censored="above", share=0.5)
    (one,) = kmax.estimate_participants(rows, {("rule", "P01", ("a", 0.0)): pooled})
    assert (one.interval, one.low, one.high) == ("verdicts", 790.0, math.inf)
    assert math.isnan(one.student_low)
    open_run = replace(run_row(), limits={"rule": pooled})
    (one,) = kmax.estimate_participants([open_run], {})
    assert (one.interval, one.low, one.high) == ("run", 790.0, math.inf)


def mostly_beyond(spread: float) -> Any:
    """Return two conditions; nearly all limits of the second are the end of the levels."""
    drawn = np.random.default_rng(3)
    return [
        *(run_row(f"P{n}", "a", value=600.0 + drawn.normal(0.0, 40.0)) for n in range(8)),
        run_row("P0", "b", value=780.0),
        *(
            run_row(f"P{n}", "b", value=800.0 + drawn.normal(0.0, spread), censored="above")
            for n in range(1, 8)
        ),
    ]


@pytest.mark.parametrize("spread", [0.0, 3.0])
def test_where_most_limits_are_bounds_nothing_is_tested(spread: float) -> None:
    """Eight ends of the levels are not eight limits: their mean is a bound without an interval."""
    rows = mostly_beyond(spread)
    each = kmax.estimate_participants(rows, {})
    a, b = kmax.over_participants(each, "ab")
    assert (b.limits, b.above, math.isnan(b.low), math.isnan(a.low)) == (8, 7, True, False)
    (one,) = kmax.compare_pairs(each, "ab")
    assert (one.bound, one.beyond.count, one.beyond.limits) == ("least", 7, 16)
    assert one.withheld
    assert one.problem == kmax.MOSTLY_CENSORED
    assert all(math.isnan(value) for value in (one.low, one.high, one.p, one.holm))
    assert kmax.compare_pairs(each, "ba")[0].bound == "most"
    model = model_of(rows)
    assert model.problem == "most limits lie beyond the searched levels, except those of a, B = 0"
    assert model.contrasts == ()
    assert all(slope.problem for slope in effects.slopes(rows, []) if slope.measure == "rule")


def test_a_difference_with_some_bounds_says_on_which_side_it_is_open() -> None:
    rows = [
        run_row(f"P{n}", name, value=400.0 + 7.0 * n * n + 30.0 * (name == "b"))
        for n in range(6)
        for name in "ab"
    ]
    above = [replace(row, limits={"rule": replace(row.limits["rule"], censored="above")}) for row in rows]
    some = [above[0], *rows[1:]]  # of "a"
    (one,) = kmax.compare_pairs(kmax.estimate_participants(some, {}), "ab")
    assert (one.bound, one.withheld, one.beyond.count) == ("most", False, 1)
    both = [above[0], above[1], *rows[2:]]
    (one,) = kmax.compare_pairs(kmax.estimate_participants(both, {}), "ab")
    assert (one.bound, one.beyond.count) == ("unknown", 2)
    (one,) = kmax.compare_pairs(kmax.estimate_participants(rows, {}), "ab")
    assert one.bound == ""


def test_p_is_corrected_for_all_differences_of_a_measure_whatever_the_damping() -> None:
    rows = runs_of_people(people=7, dampings=(0.0, 1.0, 3.0), effect=8.0)
    for family in (kmax.compare_pairs(kmax.estimate_participants(rows, {}), "ab"), model_of(rows).contrasts):
        assert len(family) == 4
        assert [one.holm for one in family] == kmax.holm([one.p for one in family])


# ---------------------------------------------------------------------- mixed model


@pytest.mark.exhaustive("::test_in_a_balanced_study_the_likelihoods_are_those_of_its_strata")
def test_the_mixed_model_is_that_of_the_formula() -> None:
    """The same model of the means over repeats, as a formula for which statsmodels builds the columns."""
    rows = runs_of_people(people=9, dampings=(0.0, 3.0, 7.0), order=4.0, block=-6.0, scatter=20.0)
    drawn = np.random.default_rng(3)
    apart = {(f"P{person:02d}", b): drawn.normal(0.0, 25.0) for person in range(9) for b in (0.0, 3.0, 7.0)}
    left_out = ("P03", 1, 1), ("P05", 3, 4)  # so that order and block differ
    rows = [row for row in rows if (row.participant, row.block, row.order) not in left_out]
    for number, row in enumerate(rows):
        limit = row.limits["rule"]
        value = limit.value + apart[row.participant, row.damping]
        rows[number] = replace(row, limits={"rule": replace(limit, value=value)})
    model = model_of(rows)
    columns = ["participant", "condition", "order", "block"]
    values = [
        [row.limits["rule"].value, f"B{row.damping:g}", *(getattr(row, name) for name in columns)]
        for row in rows
    ]
    frame = import_module("pandas").DataFrame(values, columns=["limit", "damping", *columns])
    frame = frame.groupby(["participant", "condition", "damping"], as_index=False).mean()

    def fitted(formula: Any, **how: Any) -> Any:
        parts = {"condition": "0 + C(condition)", "damping": "0 + C(damping)"}
        random = {"groups": "participant", "re_formula": "1", "vc_formula": parts}
        api = import_module("statsmodels.formula.api")
        return api.mixedlm(formula, frame, **random).fit(method=["bfgs", "lbfgs"], **how)

    theirs = fitted("limit ~ condition * damping + order + block")
    at = {contrast.damping: contrast for contrast in model.contrasts}
    assert at[0.0].difference == pytest.approx(theirs.fe_params["condition[T.b]"], rel=1e-3)
    assert model.degrees == 8
    half = stats.t.ppf(0.975, 8) * theirs.bse_fe["condition[T.b]"]
    assert (at[0.0].high - at[0.0].low) / 2 == pytest.approx(half, rel=5e-3)
    apart = theirs.fe_params["condition[T.b]"] + theirs.fe_params["condition[T.b]:damping[T.B3]"]
    assert at[3.0].difference == pytest.approx(apart, rel=1e-3)
    assert at[None].difference == pytest.approx(
        np.mean([at[b].difference for b in (0.0, 3.0, 7.0)]), rel=1e-9
    )
    slopes = {slope.name: slope.value for slope in model.slopes}
    assert slopes == pytest.approx(
        {"order": theirs.fe_params["order"], "block": theirs.fe_params["block"]}, rel=5e-3
    )
    assert all(math.isnan(slope.low) for slope in model.slopes)
    deviations = [math.sqrt(value) for value in (theirs.cov_re.iloc[0, 0], *theirs.vcomp, theirs.scale)]
    assert [name for name, _ in model.deviations] == [*mixed.PARTS, mixed.RESIDUAL]
    assert [value for _, value in model.deviations] == pytest.approx(deviations, rel=0.02)
    without = [f"limit ~ {what} + order + block" for what in ("damping", "condition", "condition + damping")]
    whole, *others = (
        fitted(f, reml=False).llf for f in ("limit ~ condition * damping + order + block", *without)
    )
    names = ("condition, at any damping", "damping, in any condition", "condition × damping")
    assert tuple(test.factor for test in model.tests) == names
    for test, other, degrees in zip(model.tests, others, (3, 4, 2), strict=True):
        assert test.statistic == pytest.approx(2 * (whole - other), abs=1e-3)
        assert test.p == pytest.approx(stats.chi2.sf(2 * (whole - other), degrees), rel=1e-2)


def test_in_a_balanced_study_the_likelihoods_are_those_of_its_strata() -> None:
    """`null_studies` uses this closed form to count false positives of the likelihood ratio."""
    drawn = np.random.default_rng(1)
    means = 400.0 + null_studies.study(9, drawn)
    rows = [
        run_row(f"P{person:02d}", "ab"[condition], float(damping), float(value))
        for (person, condition, damping), value in np.ndenumerate(means)
    ]
    values = null_studies.in_strata(means)
    whole = null_studies.fit(values).deviance
    expected = {
        factor: null_studies.fit(values, without).deviance - whole
        for factor, without in null_studies.FACTORS.items()
    }
    model = model_of(rows)
    assert {test.factor: test.statistic for test in model.tests} == pytest.approx(expected, abs=2e-3)
    variances = null_studies.fit(values, reml=True).variances
    over = next(contrast for contrast in model.contrasts if contrast.damping is None)
    half = stats.t.ppf(0.975, 8) * math.sqrt(2.0 * variances[True, False] / 3.0 / 9.0)
    assert (over.high - over.low) / 2.0 == pytest.approx(half, rel=1e-3)


def test_repeats_of_one_person_are_no_more_people() -> None:
    """Five identical copies of each run add no information about the population."""
    rows = [
        replace(row, order=1, block=1) for row in runs_of_people(repeats=1, dampings=(0.0, 3.0), scatter=25.0)
    ]
    once, often = model_of(rows), model_of(rows * 5)
    assert [test.p for test in often.tests] == pytest.approx([test.p for test in once.tests], rel=1e-3)
    for one, other in zip(once.contrasts, often.contrasts, strict=True):
        assert (other.low, other.high) == pytest.approx((one.low, one.high), abs=1e-3 * (one.high - one.low))
    assert (once.runs, often.runs) == (32, 160)


def test_a_crossover_whose_order_is_taken_out_is_its_two_sample_test() -> None:
    """With each condition once in either order, the degrees of freedom are the number of people minus two."""
    rows = runs_of_people(people=8, repeats=1, scatter=20.0, order=10.0)
    (contrast,) = model_of(rows).contrasts
    by = {(row.participant, row.condition): row.limits["rule"].value for row in rows}
    first = {row.participant: row.condition for row in rows if row.order == 1}
    groups = [[by[code, "b"] - by[code, "a"] for code, name in first.items() if name == of] for of in "ab"]
    expected = stats.ttest_ind(groups[0], np.negative(groups[1])).confidence_interval()
    assert model_of(rows).degrees == 6
    assert (contrast.low, contrast.high) == pytest.approx((expected.low / 2, expected.high / 2), rel=1e-3)


def test_below_eight_people_there_are_no_likelihood_ratios() -> None:
    few, enough = (model_of(runs_of_people(people=people, scatter=25.0)) for people in (7, 8))
    assert few.tests == ()
    assert any("likelihood ratios of factors are omitted" in note for note in few.notes)
    assert [test.factor for test in enough.tests] == ["condition"]
    assert not any("likelihood" in note for note in enough.notes)


def test_a_variance_estimated_as_zero_is_noted() -> None:
    """People differ only by chance, so the optimiser stops somewhere near zero."""
    rows = runs_of_people(people=8, between=0.0, interaction=0.0, effect=0.0, dampings=(0.0, 3.0), seed=2)
    model = model_of(rows)
    none = [name for name, value in model.deviations if value == 0.0]
    assert none
    assert f"the variance of {' and of '.join(none)} is estimated as zero" in model.notes


def test_an_order_that_cannot_be_separated_from_the_conditions_is_left_out() -> None:
    rows = [replace(row, order=1 + (row.condition == "b"), block=1) for row in runs_of_people()]
    model = model_of(rows)
    assert model.slopes == ()
    assert any("order cannot be separated" in note for note in model.notes)


def test_limits_beyond_the_levels_are_noted() -> None:
    rows = runs_of_people(people=8)
    limit = LimitInterval(value=430.0, low=400.0, high=500.0, censored="above", share=0.5)
    rows[3] = replace(rows[3], limits={"rule": limit})
    model = model_of(rows)
    assert (model.beyond.count, model.contrasts[0].beyond.count) == (1, 1)
    assert any("1 of 48 limits lie beyond the searched levels" in note for note in model.notes)
    assert any("unequal spread can produce a false difference" in note for note in model.notes)
    assert not any("smaller than they are" in note for note in model.notes)


def test_a_cell_that_is_mostly_beyond_the_levels_is_left_out_and_so_is_the_mean_over_it() -> None:
    rows = runs_of_people(people=7, dampings=(0.0, 1.0, 3.0))
    limit = LimitInterval(value=430.0, low=400.0, high=math.inf, censored="above", share=0.5)
    stiff = [
        replace(row, limits={"rule": limit}) if (row.condition, row.damping) == ("b", 3.0) else row
        for row in rows
    ]
    model = model_of(stiff)
    assert [contrast.damping for contrast in model.contrasts] == [0.0, 1.0]
    assert ("b", 3.0) not in dict(model.means)
    assert "21 of 21 limits of b, B = 3 lie beyond the searched levels: excluded" in model.notes
    withheld = [
        one.damping for one in kmax.compare_pairs(kmax.estimate_participants(stiff, {}), "ab") if one.withheld
    ]
    assert withheld == [3.0, None]


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ([], "0 participants"),
        (runs_of_people(people=2), "2 participants with a limit;"),
        ([run_row(f"P{n}", value=400.0 + n) for n in range(3)], "fewer than two conditions or dampings"),
        (
            [run_row(f"P{n}", "ab"[n > 1], value=400.0 + n) for n in range(3)]
            + [run_row("P2", "a", value=410.0)],
            "4 values are too few for 3 participants",
        ),
        ([run_row(f"P{n}", name) for n in range(5) for name in "ab"], "all limits are equal"),
    ],
)
def test_too_few_data_give_a_reason_and_no_contrast(rows: Any, why: str) -> None:
    model = model_of(rows)
    assert why in model.problem
    assert model.contrasts == ()


def test_without_statsmodels_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "statsmodels.regression.mixed_linear_model", None)
    monkeypatch.setattr(deferred.mixed_linear_model, "_module", None)
    assert "pip install 'haptic-rig[report]'" in model_of(runs_of_people()).problem


# ---------------------------------------------------------------------- the resolution of the levels

STEP = 10.0


def quantised(scatter: float) -> Any:
    """Return runs of six people on a ladder; two of them read `scatter` steps more under the second condition."""
    rows = []
    for n, name in itertools.product(range(6), "ab"):
        steps = 7.0 * n + (3.0 + scatter * (n // 2 % 2)) * (name == "b")
        row = run_row(f"P{n}", name, value=400.0 + STEP * steps, order=1 + (n + (name == "b")) % 2)
        rows.append(replace(row, limits={"rule": replace(row.limits["rule"], step=STEP)}))
    return rows


@pytest.mark.parametrize(("scatter", "resolved"), [(0.0, False), (0.2, False), (0.6, False), (2.0, True)])
def test_no_method_infers_from_a_scatter_that_rounding_to_the_levels_makes(
    scatter: float, resolved: bool
) -> None:
    """Rounding makes differences scatter by 10 / √6 = 4.1; those here scatter by 0, 1.1, 3.3 and 11."""
    rows = quantised(scatter)
    (paired,) = kmax.compare_pairs(kmax.estimate_participants(rows, {}), "ab")
    model = model_of(rows)
    slope = next(one for one in effects.slopes(rows, []) if (one.along, one.measure) == ("order", "rule"))
    for problem, values in (
        (paired.problem, [paired.low, paired.high, paired.p]),
        (model.problem, [end for one in model.contrasts for end in (one.low, one.high, one.p)]),
        (slope.problem, [slope.low, slope.high, slope.p]),
    ):
        assert (problem == "") == resolved
        assert resolved or "rounding to levels" in problem or "are equal" in problem
        assert all(math.isfinite(value) == resolved for value in values)


def test_repeats_that_scatter_by_rounding_have_the_interval_of_all_verdicts() -> None:
    pooled = LimitInterval(value=400.0, low=380.0, high=440.0, censored="", share=0.5)
    rows = [
        replace(run_row(), limits={"rule": replace(pooled, value=v, step=STEP)})
        for v in (400.0, 402.0, 404.0)
    ]
    (one,) = kmax.estimate_participants(rows, {("rule", "P01", ("a", 0.0)): pooled})
    assert (one.interval, one.low, one.high) == ("verdicts", 380.0, 440.0)
    assert one.rounding == pytest.approx(STEP / 6.0)  # of the mean of three


# ---------------------------------------------------------------------- order and fatigue


def test_slopes_are_those_of_least_squares_with_a_mean_for_each_cell_and_their_mean_is_scipys() -> None:
    drawn = np.random.default_rng(4)
    rows = []
    for p in range(4):
        for c, n in zip("ab" * 10, drawn.permutation(20), strict=True):
            seconds = math.exp(0.007 * p * n + p + drawn.normal(0.0, 0.3))
            rows.append(trial_row(f"P{p}", condition=c, trial=int(n), response_time_s=seconds))
    ordinary = import_module("statsmodels.regression.linear_model").OLS
    theirs = []
    for person in range(4):
        own = [row for row in rows if row.participant == f"P{person}"]
        design = np.array([[row.condition == "a", row.condition == "b", row.trial] for row in own], float)
        theirs.append(ordinary([math.log(row.response_time_s) for row in own], design).fit().params[-1])
    expected = stats.ttest_1samp(theirs, 0.0)
    found = next(slope for slope in effects.slopes([], rows) if slope.of == "response time")
    assert (found.participants, found.count) == (4, 80)
    assert (found.slope, found.p) == pytest.approx((np.mean(theirs), expected.pvalue))
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval()))


@pytest.mark.parametrize(
    ("people", "pace", "why"),
    [
        (1, 0.01, "1 participant with a slope of their own; an interval and a p value need 3 or more"),
        (3, 0.01, "the slopes of the participants are equal"),
        (3, 0.0, "all values are equal within participants"),
    ],
)
def test_a_slope_without_an_interval_says_why(people: int, pace: float, why: str) -> None:
    rows = [
        trial_row(f"P{person}", trial=n, response_time_s=math.exp(pace * n + person))
        for person in range(people)
        for n in range(1, 9)
    ]
    found = next(slope for slope in effects.slopes([], rows) if slope.of == "response time")
    assert why in found.problem
    assert math.isnan(found.slope)
    assert math.isnan(found.low)


def test_fatigue_is_found_and_an_inseparable_slope_has_a_reason() -> None:
    rows = runs_of_people(people=8, scatter=5.0, block=-12.0)
    drawn = np.random.default_rng(8)
    timed = [
        trial_row(f"P{p}", trial=n, response_time_s=math.exp(0.004 * n + drawn.normal(0.0, 0.3)))
        for p in range(5)
        for n in range(1, 30)
    ]
    slopes = effects.slopes(rows, timed)
    found = {slope.along: slope for slope in slopes if slope.measure == "rule"}
    (alone,) = [slope for slope in slopes if slope.of == "response time"]
    tested = [found["block"], found["order"]]
    # A correction for each quantity.
    assert [one.holm for one in tested] == kmax.holm([one.p for one in tested])
    assert alone.holm == alone.p
    assert found["block"].low <= -12.0 <= found["block"].high < 0.0
    assert found["order"].low <= 0.0 <= found["order"].high
    assert "cannot be separated" in found["trial"].problem  # the same for all runs here
    once = [replace(row, block=1) for row in rows if row.block == 1]
    alone = {slope.along: slope for slope in effects.slopes(once[:2], []) if slope.measure == "rule"}
    assert alone["order"].problem != ""


def test_blocks_count_what_happened_in_them() -> None:
    rows = [
        trial_row(response_time_s=1.0),
        trial_row(response_time_s=3.0, verdict="unsure"),
        trial_row(void="invalid", verdict="", judged_by="", response_time_s=None),
        trial_row(void="redone", aborted="violence", judged_by="", response_time_s=None),
        trial_row(block=0, practice=True),
    ]
    (block,) = effects.blocks(rows)
    counts = (block.trials, block.invalid, block.redone, block.aborted, block.unsure, block.response_s)
    assert counts == (4, 1, 1, 1, 1, 2.0)


# ---------------------------------------------------------------------- psychometric functions

LEVELS = tuple(float(level) for level in range(100, 925, 25))


def test_known_functions_lie_within_their_intervals() -> None:
    """Verdicts along all levels, of observers with lapses: each interval nearly always contains its parameter."""
    drawn = np.random.default_rng(6)
    held = np.zeros(3)
    for _ in range(40):
        truth = Observer(
            threshold=float(drawn.uniform(300, 700)), spread=float(drawn.uniform(10, 50)), lapse_rate=0.02
        )
        verdicts = [(level, truth.judge(level, drawn)) for level in LEVELS * 6]
        found = psychometric.fit("P01", "a", 0.0, "person", LEVELS, verdicts)
        for place, name in enumerate(("threshold", "spread", "lapse_rate")):
            posterior = getattr(found, name)
            held[place] += posterior.low <= getattr(truth, name) <= posterior.high
    assert (held >= 34).all()


def test_a_function_has_its_levels_and_is_bounded_by_both_kinds_of_verdicts() -> None:
    verdicts = [(200.0, True), (100.0, True), (200.0, False), (200.0, True)]
    found = psychometric.fit("P01", "a", 0.0, "person", LEVELS, verdicts)
    assert (found.levels, found.verdicts, found.stable) == ((100.0, 200.0), (1, 3), (1, 2))
    assert found.bounded
    assert not psychometric.fit("P01", "a", 0.0, "person", LEVELS, verdicts[:2]).bounded
    share = found.share(np.array([50.0, found.threshold.mean, 2000.0]))
    assert share[0] > share[1] > share[2]
    assert share[1] == pytest.approx(0.5)


def test_one_series_has_a_wide_interval_and_five_a_narrow_one() -> None:
    """A single verdict that is not stable may be a lapse: the median stays near it with a wide interval."""
    series = [(level, level < 450.0) for level in LEVELS if level <= 450.0]
    one, five = half_way(LEVELS, series), half_way(LEVELS, series * 5)
    assert one.low < 437.0 < one.high
    assert one.high - one.low > 4.0 * (five.high - five.low)
    assert abs(five.value - 437.0) < 15.0
    held = half_way(LEVELS, series[:-1])
    assert (one.censored, held.censored) == ("", "above")
    assert (held.value, held.high) == (425.0, math.inf)
    assert half_way(LEVELS, series * 5, 0.71).value < five.value


def test_over_participants_k50_is_the_mean_of_theirs_with_an_interval_over_them() -> None:
    """Many verdicts of few people do not show where the limits of other people are."""
    drawn = np.random.default_rng(8)
    verdicts, each = [], []
    for code, threshold in (("P01", 350.0), ("P02", 430.0), ("P03", 560.0)):
        person = Observer(threshold=threshold, spread=15.0)
        own = [(level, person.judge(level, drawn)) for level in LEVELS * 4]
        each.append(psychometric.fit(code, "a", 0.0, "person", LEVELS, own))
        verdicts += own
    found = psychometric.together(each, LEVELS, verdicts)
    own = np.array([one.threshold.mean for one in each])
    interval = stats.t.interval(0.95, 2, own.mean(), stats.sem(own))
    assert found.threshold.mean == pytest.approx(own.mean())
    assert (found.threshold.low, found.threshold.high) == pytest.approx(interval)
    assert (found.participant, found.participants, sum(found.verdicts)) == ("", 3, len(verdicts))
    assert found.spread.mean > max(one.spread.mean for one in each)  # people differ
    for parameter in (found.spread, found.lapse_rate):
        assert math.isnan(parameter.low)
        assert math.isnan(parameter.high)
    two = psychometric.together(each[:2], LEVELS, verdicts[: len(verdicts) * 2 // 3])
    assert two.threshold.mean == pytest.approx(own[:2].mean())
    assert math.isnan(two.threshold.low)
