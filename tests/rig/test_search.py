"""Search rules: pure functions of the answers so far, that find the limit of an observer whose limit is known."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from rig import search
from rig.errors import ConfigError
from rig.search import Answer, psychometric
from rig.search.interleaved import Interleaved
from rig.search.observer import Observer, run, study
from rig.search.rule import told
from rig.search.staircase import Staircase

LEVELS = tuple(float(level) for level in range(25, 1000, 25))
RULES = {
    "ascending": search.make("ascending", levels=LEVELS),
    "1u1d": search.make("staircase", levels=LEVELS),
    "1u2d": search.make("staircase", levels=LEVELS, stable_to_rise=2),
    "1u3d": search.make("staircase", levels=LEVELS, stable_to_rise=3),
    "interleaved": search.make("interleaved", levels=LEVELS, seed=3),
    "psi": search.make("psi", levels=LEVELS),
    "grid": search.make("grid", levels=LEVELS, repeats=2, seed=3),
}
every_rule = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
SHARP = Observer(threshold=430.0, spread=1e-3)


# ---------------------------------------------------------------------- what every rule keeps


@every_rule
def test_an_observer_without_doubt_is_found_within_a_step(rule):
    estimate = rule.estimate(run(rule, SHARP, seed=1))
    assert abs(estimate.value - 430.0) <= 25.0
    assert estimate.censored == ""
    assert estimate.low <= estimate.value <= estimate.high


@every_rule
def test_the_same_answers_always_lead_to_the_same_probe(rule):
    answers = run(rule, Observer(threshold=430.0, spread=40.0, slips=0.05), seed=5)
    for length in (0, 1, 2, 7, len(answers) - 1):
        assert rule.next(answers[:length]) == answers[length].probe
    assert rule.next(answers) is None


@every_rule
@settings(max_examples=15, deadline=None)
@given(verdicts=st.lists(st.booleans(), min_size=400, max_size=400))
def test_whatever_is_answered_it_ends_on_its_levels(rule, verdicts):
    answers: list[Answer] = []
    for verdict in verdicts:
        probe = rule.next(answers)
        if probe is None:
            break
        assert probe.level in LEVELS
        answers.append(Answer(probe, verdict))
    estimate = rule.estimate(answers)
    assert estimate.hits == len(answers)
    assert estimate.low <= estimate.high
    if rule is not RULES["ascending"]:
        assert rule.next(answers) is None


@every_rule
def test_a_verdict_that_says_nothing_is_asked_again_and_changes_nothing(rule):
    answers = run(rule, SHARP, seed=2)[:5]
    probe = rule.next(answers)
    empty = [*answers, Answer(probe, None)]
    assert rule.next(empty).level == probe.level
    if rule is not RULES["interleaved"]:  # whose draws go on with the number of trials
        assert rule.next([*empty, Answer(probe, True)]) == rule.next([*answers, Answer(probe, True)])
    assert rule.estimate(empty).value == pytest.approx(rule.estimate(answers).value, nan_ok=True)


@every_rule
@pytest.mark.parametrize(("threshold", "censored"), [(1e5, "above"), (1e-3, "below")])
def test_a_limit_beyond_the_levels_is_said_to_lie_there(rule, threshold, censored):
    estimate = rule.estimate(run(rule, Observer(threshold=threshold, spread=1e-4), seed=1))
    assert estimate.censored == censored


@every_rule
def test_without_an_answer_nothing_is_known(rule):
    estimate = rule.estimate([])
    assert math.isnan(estimate.value)
    assert estimate.hits == 0
    assert estimate.low < LEVELS[0] or estimate.low <= estimate.high


# ---------------------------------------------------------------------- each in its own way


def test_the_ascending_rule_climbs_from_the_softest_wall_so_often():
    rule = search.make("ascending", levels=(10.0, 20.0, 30.0), repeats=2)
    answers: list[Answer] = []
    asked = []
    for verdict in (True, True, False, False):
        probe = rule.next(answers)
        asked.append((probe.track, probe.level))
        answers.append(Answer(probe, verdict))
    assert asked == [(0, 10.0), (0, 20.0), (0, 30.0), (1, 10.0)]
    estimate = rule.estimate(answers)
    assert (estimate.value, estimate.censored) == (10.0, "below")  # limits 20 and none


def test_one_slip_in_fifty_makes_the_ascending_rule_read_low_and_no_other():
    observer = Observer(threshold=430.0, spread=15.0, slips=0.02)
    found = {one.rule: one for one in study(RULES, [observer], sessions=40)}
    assert found["ascending"].bias < -40.0
    for name in ("1u1d", "1u2d", "interleaved", "psi", "grid"):
        assert abs(found[name].bias) < 15.0, name
        assert found[name].covered >= 0.9, name
    assert found["psi"].hits < found["ascending"].hits / 2


@pytest.mark.parametrize("n", [1, 2, 3])
def test_up_down_rules_settle_where_levitt_says(n):
    """Share of stable verdicts to the n-th power is a half: by counting the walls that a long track visits."""
    observer = Observer(threshold=500.0, spread=60.0)
    rule = Staircase(levels=LEVELS, stable_to_rise=n, steps=(1,), turns=1000, most=900)
    visited = np.array([answer.probe.level for answer in run(rule, observer, seed=4)[100:]])
    assert rule.share == pytest.approx(0.5 ** (1 / n))
    assert visited.mean() == pytest.approx(observer.level_of(rule.share), abs=20.0)


def test_tracks_come_from_both_ends_and_catch_trials_move_neither():
    rule = Interleaved(levels=LEVELS, catch_share=0.3, seed=1)
    answers = run(rule, SHARP, seed=1)
    first = {track: next(a.probe.level for a in answers if a.probe.track == track) for track in (0, 1)}
    assert first == {0: LEVELS[0], 1: LEVELS[-1]}
    caught = rule.catches(answers)
    assert caught.soft + caught.stiff == sum(answer.probe.catch for answer in answers) > 5
    assert (caught.soft_slips, caught.stiff_slips) == (0, 0)
    moved = [a for a in answers if not a.probe.catch]
    assert rule.estimate(answers).value == rule.estimate(moved).value


def test_catch_trials_show_how_often_a_person_slips():
    rule = Interleaved(levels=LEVELS, catch_share=0.5, turns=100, most=2000, seed=1)
    answers = run(rule, Observer(threshold=430.0, spread=15.0, slips=0.2), seed=1, most=300)
    caught = rule.catches(answers)
    share = (caught.soft_slips + caught.stiff_slips) / (caught.soft + caught.stiff)
    assert share == pytest.approx(0.2, abs=0.1)


def test_the_grid_asks_every_level_so_often_in_another_order_each_time():
    asked = [answer.probe.level for answer in run(RULES["grid"], SHARP, seed=1)]
    halves = asked[: len(LEVELS)], asked[len(LEVELS) :]
    assert sorted(halves[0]) == sorted(halves[1]) == list(LEVELS)
    assert halves[0] != halves[1]


def test_psi_stops_when_it_knows_enough():
    sure = search.make("psi", levels=LEVELS, hits=60, enough=0.1)
    answers = run(sure, SHARP, seed=1)
    assert 10 <= len(answers) < 60
    estimate = sure.estimate(answers)
    assert (estimate.high - estimate.low) / 2 <= 0.1 * estimate.value


# ---------------------------------------------------------------------- the posterior


def test_the_posterior_is_bayes_rule_by_hand():
    levels = (10.0, 20.0, 30.0)
    grid = psychometric.of_levels(levels)
    verdicts = [(10.0, True), (30.0, False), (20.0, True), (20.0, False)]
    expected = np.ones((len(grid.thresholds), len(grid.spreads), len(psychometric.SLIPS)))
    for (t, threshold), (s, spread), (g, slips) in itertools.product(
        enumerate(grid.thresholds), enumerate(grid.spreads), enumerate(psychometric.SLIPS)
    ):
        for level, stable in verdicts:
            share = float(psychometric.share_stable(level, threshold, spread, slips))
            expected[t, s, g] *= share if stable else 1.0 - share
    np.testing.assert_allclose(grid.posterior(verdicts), expected / expected.sum(), rtol=1e-9)


@given(st.floats(0.05, 0.95), st.floats(100.0, 900.0), st.floats(1.0, 200.0))
def test_the_level_of_a_share_is_where_the_function_has_it(share, threshold, spread):
    observer = Observer(threshold=threshold, spread=spread)
    level = observer.level_of(share)
    root = brentq(
        lambda k: float(psychometric.share_stable(k, threshold, spread)) - share, level - 500, level + 500
    )
    assert level == pytest.approx(root, abs=1e-6)


def test_intervals_shrink_as_the_root_of_the_hits():
    observer = Observer(threshold=430.0, spread=40.0)
    widths = []
    for repeats in (2, 8, 32):
        rule = search.make("grid", levels=LEVELS, repeats=repeats)
        estimate = rule.estimate(run(rule, observer, seed=3))
        widths.append(estimate.high - estimate.low)
    ratios = np.array(widths[:-1]) / widths[1:]
    assert (ratios > 1.4).all()
    assert (ratios < 3.0).all()


def test_any_estimate_can_be_had_from_any_rules_answers():
    answers = run(RULES["ascending"], Observer(threshold=430.0, spread=15.0), seed=3)
    low, high = psychometric.interval(LEVELS, told(answers), 0.5)
    assert low <= 430.0 <= high


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("nobody", {}),
        ("ascending", {"levels": (10.0,)}),
        ("ascending", {"levels": (10.0, 10.0)}),
        ("ascending", {"levels": (0.0, 10.0)}),
        ("ascending", {"repeats": 0}),
        ("staircase", {"steps": ()}),
        ("staircase", {"steps": (100,)}),
        ("staircase", {"start": 26.0}),
        ("staircase", {"stable_to_rise": 1.5}),
        ("interleaved", {"catch_share": 0.9}),
        ("psi", {"enough": 1.0}),
        ("psi", {"unknown": 1}),
        ("grid", {"repeats": True}),
    ],
)
def test_settings_that_cannot_be_meant_are_refused_with_a_remedy(name, wrong):
    with pytest.raises(ConfigError) as refused:
        search.make(name, **{"levels": LEVELS, **wrong})
    assert refused.value.remedy
