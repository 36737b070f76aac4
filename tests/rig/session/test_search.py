"""Search rules, pure functions of the answers so far, find the limit of an observer whose limit is known."""

import itertools
import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rig.core.errors import ConfigError
from rig.session import search
from rig.session.search import JudgedProbe
from rig.session.search import _psychometric as psychometric
from rig.session.search._catching import CatchTrials
from rig.session.search._interleaved import Interleaved
from rig.session.search._observer import Observer, performance, run
from rig.session.search._rule import verdicts_of
from rig.session.search._staircase import Staircase
from tests.conformance.tiers import first_by_default

LEVELS = tuple(float(level) for level in range(25, 1000, 25))
MAKE = {
    "ascending": partial(search.make, "ascending", levels=LEVELS),
    "1u1d": partial(search.make, "staircase", levels=LEVELS),
    "1u2d": partial(search.make, "staircase", levels=LEVELS, stable_to_rise=2),
    "1u3d": partial(search.make, "staircase", levels=LEVELS, stable_to_rise=3),
    "interleaved": partial(search.make, "interleaved", levels=LEVELS),
    "psi": partial(search.make, "psi", levels=LEVELS),
    "grid": partial(search.make, "grid", levels=LEVELS, repeats=2),
}
RULES = {name: make(seed=3) for name, make in MAKE.items()}
every_rule = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
SHARP = Observer(threshold=430.0, spread=1e-3)


# ---------------------------------------------------------------------- what every rule keeps


@every_rule
def test_an_observer_without_doubt_is_found_within_a_step(rule: Any) -> None:
    estimate = rule.estimate(run(rule, SHARP, seed=1))
    assert abs(estimate.value - 430.0) <= 25.0
    assert estimate.censored == ""
    assert estimate.low <= estimate.value <= estimate.high


@every_rule
def test_the_same_answers_always_lead_to_the_same_probe(rule: Any) -> None:
    answers = run(rule, Observer(threshold=430.0, spread=40.0, lapse_rate=0.05), seed=5)
    for length in (0, 1, 2, 7, len(answers) - 1):
        assert rule.next(answers[:length]) == answers[length].probe
    assert rule.next(answers) is None


@every_rule
@settings(max_examples=10, deadline=None)
@given(verdicts=st.binary(min_size=50, max_size=50))
def test_whatever_is_answered_it_ends_on_its_levels(rule: Any, verdicts: bytes) -> None:
    answers: list[JudgedProbe] = []
    for verdict in np.unpackbits(np.frombuffer(verdicts, np.uint8)).astype(bool).tolist():
        probe = rule.next(answers)
        if probe is None:
            break
        assert probe.level in LEVELS
        answers.append(JudgedProbe(probe, verdict))
    estimate = rule.estimate(answers)
    assert estimate.hits == len(answers)
    assert estimate.low <= estimate.high
    if rule is not RULES["ascending"]:
        assert rule.next(answers) is None


@every_rule
def test_a_verdict_that_says_nothing_is_asked_again_and_changes_nothing(rule: Any) -> None:
    answers = run(rule, SHARP, seed=2)[:5]
    probe = rule.next(answers)
    empty = [*answers, JudgedProbe(probe, None)]
    assert rule.next(empty).level == probe.level
    assert rule.next([*empty, JudgedProbe(probe, True)]) == rule.next([*answers, JudgedProbe(probe, True)])
    assert rule.estimate(empty).value == pytest.approx(rule.estimate(answers).value, nan_ok=True)


@every_rule
def test_beyond_the_levels_only_the_side_is_known(rule: Any) -> None:
    """The interval is open at the end of the levels: beyond it only the prior would bound the posterior."""
    above = rule.estimate(run(rule, Observer(threshold=1e5, spread=1e-4), seed=1))
    assert (above.censored, above.value, above.high) == ("above", LEVELS[-1], math.inf)
    assert LEVELS[-6] < above.low <= LEVELS[-1]
    below = rule.estimate(run(rule, Observer(threshold=1e-3, spread=1e-4), seed=1))
    assert (below.censored, below.value, below.low) == ("below", LEVELS[0], 0.0)
    assert LEVELS[0] <= below.high < LEVELS[5]


@pytest.mark.parametrize("name", ["psi", "grid"])
def test_a_limit_beyond_the_levels_is_censored_also_after_a_slip(name: str) -> None:
    for observer, side, end in (
        (Observer(threshold=1.2 * LEVELS[-1], spread=15.0), "above", LEVELS[-1]),
        (Observer(threshold=0.1, spread=5.0), "below", LEVELS[0]),
    ):
        answers = run(RULES[name], observer, seed=2)
        place = 12 if name == "psi" else next(n for n, a in enumerate(answers) if a.probe.level == 300.0)
        slip = [*answers[:place], JudgedProbe(answers[place].probe, side == "below"), *answers[place + 1 :]]
        estimate = RULES[name].estimate(slip)
        assert (estimate.censored, estimate.value) == (side, end)
        assert math.isinf(estimate.high) if side == "above" else estimate.low == 0.0


def test_walls_that_all_held_tell_no_more_than_the_stiffest_of_them() -> None:
    """A search that ended early has not reached the highest level, so its estimate is censored at the last wall."""
    answers = [JudgedProbe(search.Probe(level), True) for level in LEVELS[:8]]
    estimate = RULES["psi"].estimate(answers)
    assert (estimate.value, estimate.censored, estimate.high) == (LEVELS[7], "above", math.inf)


@every_rule
def test_without_an_answer_nothing_is_known(rule: Any) -> None:
    estimate = rule.estimate([])
    assert math.isnan(estimate.value)
    assert estimate.hits == 0
    assert estimate.low < LEVELS[0] or estimate.low <= estimate.high


# Rules with few verdicts too: these end before they know much.
SHORT = {
    **MAKE,
    "1u1d, most": partial(search.make, "staircase", levels=LEVELS, turns=6, most=3),
    "1u3d, most": partial(search.make, "staircase", levels=LEVELS, stable_to_rise=3, most=12),
    "interleaved, most": partial(search.make, "interleaved", levels=LEVELS, turns=6, most=3),
    "ascending, once": partial(search.make, "ascending", levels=LEVELS[:8], repeats=1),
    "ascending, twice": partial(search.make, "ascending", levels=LEVELS[:8], repeats=2),
    "psi, short": partial(search.make, "psi", levels=LEVELS, hits=4),
    "grid, once": partial(search.make, "grid", levels=LEVELS[:6], repeats=1),
}


@pytest.mark.parametrize("name", first_by_default(SHORT, 7))
@settings(max_examples=15, deadline=None)
@given(
    threshold=st.floats(1.0, 1200.0),
    spread=st.sampled_from([0.01, 5.0, 40.0, 150.0]),
    lapse_rate=st.sampled_from([0.0, 0.05, 0.3]),
    seed=st.integers(0, 999),
    asked=st.integers(1, 200),
)
def test_a_limit_lies_in_its_interval_and_between_a_stable_and_an_unstable_wall_or_is_marked(
    name: str, threshold: float, spread: float, lapse_rate: float, seed: int, asked: int
) -> None:
    rule = SHORT[name](seed=seed)
    observer = Observer(threshold=threshold, spread=spread, lapse_rate=lapse_rate)
    answers = run(rule, observer, seed, most=asked)
    estimate = rule.estimate(answers)
    if math.isnan(estimate.value):
        return
    assert estimate.low <= estimate.value + 1e-6 or estimate.distrust_reason
    assert estimate.value - 1e-6 <= estimate.high or estimate.distrust_reason
    stable = [level for level, held in verdicts_of(answers) if held]
    others = [level for level, held in verdicts_of(answers) if not held]
    between = bool(stable and others) and min(stable) - 1e-6 <= estimate.value <= max(others) + 1e-6
    assert between or estimate.distrust_reason or estimate.censored


# ---------------------------------------------------------------------- each in its own way


def test_ascending_series_begin_at_the_softest_wall_and_their_interval_is_students() -> None:
    rule = search.make("ascending", levels=LEVELS, repeats=3)
    answers: list[JudgedProbe] = []
    for track, stable in enumerate((3, 5, 10)):
        for place in range(stable + 1):
            probe = rule.next(answers)
            assert (probe.track, probe.level) == (track, LEVELS[place])
            answers.append(JudgedProbe(probe, place < stable))
    estimate = rule.estimate(answers)
    limits = [LEVELS[stable - 1] for stable in (3, 5, 10)]
    expected = stats.ttest_1samp(limits, 0.0).confidence_interval()
    assert estimate.value == pytest.approx(np.mean(limits))
    assert (estimate.low, estimate.high) == pytest.approx((max(0.0, expected.low), expected.high))


def test_a_series_that_fails_at_the_softest_wall_is_marked_and_bounds_no_other() -> None:
    rule = search.make("ascending", levels=(10.0, 20.0, 30.0), repeats=3)

    def ascended(*verdicts: Any) -> Any:
        answers: list[JudgedProbe] = []
        for verdict in verdicts:
            probe = rule.next(answers)
            answers.append(JudgedProbe(probe, verdict))
        return [one.censored for one in rule.series(answers)], rule.estimate(answers)

    marks, estimate = ascended(True, True, False, False, True, False)
    assert marks == ["", "below", ""]
    assert (estimate.value, estimate.censored) == ((20.0 + 10.0 + 10.0) / 3, "")
    marks, estimate = ascended(False, False, False)
    assert marks == ["below"] * 3
    assert (estimate.value, estimate.low, estimate.high) == (10.0, 0.0, 10.0)
    assert estimate.censored == "below"
    marks, estimate = ascended(True, True, True, True, True, False, False)
    assert marks == ["above", "", "below"]
    assert (estimate.value, estimate.censored, estimate.high) == (20.0, "above", math.inf)


@pytest.mark.parametrize("n", first_by_default([1, 2, 3]))
def test_up_down_rules_settle_where_levitt_says(n: int) -> None:
    """The share of stable verdicts to the n-th power is a half (Levitt); measured on the walls of a long run."""
    observer = Observer(threshold=500.0, spread=60.0)
    walls = 450 if n == 1 else 900
    rule = Staircase(levels=LEVELS, stable_to_rise=n, steps=(1,), turns=1000, most=walls)
    visited = np.array([answer.probe.level for answer in run(rule, observer, seed=4)[walls // 9 :]])
    assert rule.share == pytest.approx(0.5 ** (1 / n))
    assert visited.mean() == pytest.approx(observer.level_of(rule.share), abs=20.0)


def test_tracks_come_from_both_ends() -> None:
    answers = run(Interleaved(levels=LEVELS, seed=1), SHARP, seed=1)
    first = {track: next(a.probe.level for a in answers if a.probe.track == track) for track in (0, 1)}
    assert first == {0: LEVELS[0], 1: LEVELS[-1]}


def catching(rule: Any, share: float = 0.5) -> Any:
    return search.Catching(rule=rule, levels=LEVELS, share=share, seed=1)


@pytest.mark.parametrize("name", MAKE)
def test_catch_trials_among_any_rule_leave_it_as_it_is(name: Any) -> None:
    """The rule requests the same walls and finds the same limit as without catch trials."""
    rule, observer = MAKE[name](seed=1), Observer(threshold=430.0, spread=1e-3)
    alone = run(rule, observer, seed=1)
    answers = run(catching(rule), observer, seed=1)
    own = [answer for answer in answers if not answer.probe.catch]
    assert own == alone
    assert len(answers) > len(own)
    assert {a.probe.level for a in answers if a.probe.catch} <= {LEVELS[0], LEVELS[-1]}
    found, least = rule.estimate(answers), rule.estimate(own)
    assert repr(replace(found, hits=least.hits)) == repr(least)  # NaN among them, which equals nothing
    assert found.hits == len(answers)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_so_many_of_the_trials_are_catch_trials(share: float) -> None:
    many, always = 400, SimpleNamespace(next=lambda answers: search.Probe(430.0))
    answers = run(catching(always, share), Observer(threshold=430.0, spread=15.0), seed=1, most=many)
    scatter = math.sqrt(share * (1.0 - share) / many)
    assert np.mean([answer.probe.catch for answer in answers]) == pytest.approx(share, abs=3.0 * scatter)
    with pytest.raises(ConfigError, match=r"0\.9"):
        catching(always, 0.9)


def test_an_invalid_catch_trial_comes_again_like_any_other() -> None:
    rule = catching(MAKE["1u1d"](seed=1))
    answers = []
    while (probe := rule.next(answers)) is not None and len(answers) < 200:
        answers.append(JudgedProbe(probe, None))
        assert rule.next(answers) == probe
        answers[-1] = JudgedProbe(probe, probe.level < 430.0)
    assert any(answer.probe.catch for answer in answers)


def caught_of(rule: Any, answers: Any) -> Any:
    return CatchTrials.of(answers, LEVELS, {rule.estimate(answers).censored})


def test_catch_trials_show_how_often_a_person_slips() -> None:
    rule = catching(Interleaved(levels=LEVELS, turns=100, most=2000, seed=1))
    answers = run(rule, Observer(threshold=430.0, spread=15.0, lapse_rate=0.2), seed=1, most=300)
    caught = caught_of(rule, answers)
    assert caught.lapses == caught.false_unstable + caught.false_stable
    assert caught.lapses / caught.count == pytest.approx(0.2, abs=0.1)


@pytest.mark.parametrize(("threshold", "counted"), [(1e5, "soft"), (1e-3, "stiff")])
def test_catch_trials_at_an_end_beyond_which_the_limit_lies_are_not_counted(
    threshold: float, counted: str
) -> None:
    """If a person's limit is above all levels, the stiffest wall is stable, and that answer is no lapse."""
    rule = catching(Interleaved(levels=LEVELS, seed=1))
    answers = run(rule, Observer(threshold=threshold, spread=1e-4), seed=1)
    caught = caught_of(rule, answers)
    assert caught.lapses == 0
    assert caught.count == (caught.soft if counted == "soft" else caught.stiff) > 0
    assert caught.count < sum(answer.probe.catch for answer in answers)


def test_the_grid_asks_every_level_so_often_in_another_order_each_time() -> None:
    asked = [answer.probe.level for answer in run(RULES["grid"], SHARP, seed=1)]
    halves = asked[: len(LEVELS)], asked[len(LEVELS) :]
    assert sorted(halves[0]) == sorted(halves[1]) == list(LEVELS)
    assert halves[0] != halves[1]


def test_psi_stops_when_it_knows_enough() -> None:
    sure = search.make("psi", levels=LEVELS, hits=60, enough=0.1)
    answers = run(sure, SHARP, seed=1)
    assert 10 <= len(answers) < 60
    estimate = sure.estimate(answers)
    assert (estimate.high - estimate.low) / 2 <= 0.1 * estimate.value


# ---------------------------------------------------------------------- the posterior


def test_the_posterior_is_bayes_rule_by_hand() -> None:
    levels = (10.0, 20.0, 30.0)
    grid = psychometric.of_levels(levels)
    verdicts = [(10.0, True), (30.0, False), (20.0, True), (20.0, False)]
    expected = np.ones((len(grid.thresholds), len(grid.spreads), len(psychometric.LAPSE_RATES)))
    for (t, threshold), (s, spread), (g, lapse_rate) in itertools.product(
        enumerate(grid.thresholds), enumerate(grid.spreads), enumerate(psychometric.LAPSE_RATES)
    ):
        for level, stable in verdicts:
            share = float(psychometric.share_stable(level, threshold, spread, lapse_rate))
            expected[t, s, g] *= share if stable else 1.0 - share
    np.testing.assert_allclose(grid.posterior(verdicts), expected / expected.sum(), rtol=1e-9)


def test_quantiles_are_those_of_the_posterior_on_a_fine_grid() -> None:
    """Compare with the density spread over the width of each grid point, also for shares other than a half."""
    drawn = np.random.default_rng(3)
    truth = Observer(threshold=430.0, spread=15.0)
    verdicts = [(level, truth.judge(level, drawn)) for level in LEVELS * 4]
    grid = psychometric.of_levels(LEVELS)
    posterior = grid.posterior(verdicts)
    step = grid.edges[1] - grid.edges[0]
    places = drawn.choice(posterior.size, size=200_000, p=posterior.reshape(-1))
    thresholds, spreads, _ = np.unravel_index(places, posterior.shape)
    for share in (0.5, 0.71):
        sample = grid.thresholds[thresholds] + drawn.uniform(-step / 2, step / 2, len(places))
        sample = sample + grid.spreads[spreads] * math.log((1 - share) / share)
        expected = np.quantile(sample, (0.025, 0.5, 0.975))
        assert grid.quantiles(posterior, share, (0.025, 0.5, 0.975)) == pytest.approx(expected, abs=0.5)


def ratio_levels(lowest: Any, highest: Any, ratio: Any) -> Any:
    count = math.floor(math.log(highest / lowest) / math.log(ratio) + 1e-9) + 1
    return tuple(lowest * ratio**place for place in range(count))


@pytest.mark.parametrize(
    ("threshold", "share"), first_by_default([(80.0, 0.04), (120.0, 0.04), (80.0, 0.01), (2000.0, 0.01)])
)
def test_limits_on_levels_a_ratio_apart_are_found_with_honest_intervals(
    threshold: float, share: float
) -> None:
    """The search resolves K50 as finely as the levels are spaced, also for observers of small spread."""
    make = partial(search.make, "psi", levels=ratio_levels(50.0, 3000.0, 1.1))
    observer = Observer(threshold=threshold, spread=share * threshold, lapse_rate=0.02)
    found = performance("psi", make, observer, 20, seed=5, off_lattice=0.04 * threshold)
    assert abs(found.bias) < 0.02 * threshold
    assert found.covered >= 0.9


@given(st.lists(st.tuples(st.sampled_from(LEVELS), st.booleans())), st.sampled_from([0.5, 0.71, 0.79]))
@settings(max_examples=40, deadline=None)
def test_no_limit_lies_below_zero_or_outside_its_interval(verdicts: Any, share: Any) -> None:
    found = psychometric.locate(LEVELS, verdicts, share)
    assert 0.0 <= found.low <= found.high
    if verdicts:
        assert max(found.low, LEVELS[0]) <= found.value <= min(found.high, LEVELS[-1])
    assert psychometric.interval(LEVELS, verdicts, share)[0] >= 0.0


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("unknown", {}),
        ("ascending", {"levels": (10.0,)}),
        ("ascending", {"levels": (10.0, 10.0)}),
        ("ascending", {"levels": (0.0, 10.0)}),
        ("ascending", {"repeats": 0}),
        ("staircase", {"steps": ()}),
        ("staircase", {"steps": (100,)}),
        ("staircase", {"start": 26.0}),
        ("staircase", {"stable_to_rise": 1.5}),
        ("psi", {"enough": 1.0}),
        ("psi", {"unknown": 1}),
        ("grid", {"repeats": True}),
    ],
)
def test_impossible_settings_are_refused_with_a_remedy(name: str, wrong: Any) -> None:
    with pytest.raises(ConfigError) as refused:
        search.make(name, **{"levels": LEVELS, **wrong})
    assert refused.value.remedy
