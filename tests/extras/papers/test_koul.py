"""Claims of Koul et al.: rules on made-up numbers that reach every verdict, parts of the run, and figures 7 and 8."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import config
from rig.analysis import theory
from rig.experiments.hits.compare import simulate
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan, ZWidth
from rig.extras.papers.koul import compare, rules
from rig.extras.papers.koul import ideas as koul_ideas
from rig.extras.papers.koul import parts as koul_parts
from rig.extras.papers.koul import ways as koul_ways
from rig.extras.papers.koul.rigs import DUAL, HELD, MAIN, SCHEMES, SLOW
from rig.extras.papers.parts import run_parts
from rig.extras.papers.rules import ClaimStatus, each, judge, judge_settable, judge_share, within

RATES = (1000, 2000, 20_000, 50_000)


# --- rules -----------------------------------------------------------------------------------------------------


def test_a_claim_holds_in_all_cases_or_under_a_condition_that_can_be_set() -> None:
    assert judge({"a": True, "b": True}).verdict == "reproduced"
    assert judge({"a": True, "b": False, "c": True}).verdict == "not reproduced"  # a case is no setting
    assert judge({"a": True, "b": False}, conditions=each("ab")).verdict == "reproduced only with a"
    assert judge({"a": False, "b": False}, conditions=each("ab")).verdict == "not reproduced"
    assert judge({}).status is ClaimStatus.NOT  # what was not tried is not confirmed
    assert judge({"a": False}).only(lag=True)["lag"] is True
    assert judge({"a": True, "b": False}).undecided().verdict == "undecided"
    assert judge({"a": False, "b": False}).undecided().verdict == "not reproduced"
    assert judge({"a": True}).undecided().verdict == "reproduced"


@settings(max_examples=40)
@given(st.dictionaries(st.tuples(st.sampled_from("rs"), st.sampled_from("xyz")), st.booleans(), min_size=1))
def test_a_condition_is_named_when_every_case_under_it_held(cases: dict[tuple[str, ...], bool]) -> None:
    found = judge_settable(cases, [1])
    held = {word for word in "xyz" if (of := [h for case, h in cases.items() if case[1] == word]) and all(of)}
    assert set(found.sufficient) == held
    partly = ClaimStatus.ONLY_WITH if held else ClaimStatus.NOT
    assert found.status is (ClaimStatus.REPRODUCED if all(cases.values()) else partly)


def test_a_claim_about_readings_needs_most_of_them() -> None:
    assert judge_share(95, 100).status is ClaimStatus.REPRODUCED
    assert judge_share(5, 100).status is judge_share(89, 100).status is ClaimStatus.NOT
    assert judge_share(5, 100)["share"] == 0.05
    assert judge_share(0, 100).status is ClaimStatus.NOT
    assert judge_share(0, 0).status is ClaimStatus.NOT  # nothing was held anywhere


UP, FLAT, DIP, SLIGHTLY = [100, 200, 600, 700], [100, 400, 600, 700], [100, 50, 600, 700], [100, 90, 600, 700]
FALLS = [(0.0, 500.0), (0.01, 500.0), (1.0, 400.0), (2.0, 100.0), (3.0, 0.0)]
RISES = [(0.0, 200.0), (1.0, 300.0), (2.0, 250.0), (3.0, 0.0)]
YES, NO, PARTLY, UNDECIDED = "reproduced", "not reproduced", "reproduced in part:", "undecided"
ONLY_FIXED = "reproduced only with fixed"
EXAMPLE = (780.0, 560.0, 350.0)  # peaks of the paper (N·m/rad)


def cutoffs(**ratios: float) -> dict[tuple[str, ...], float]:
    return {("rigid", cutoff, "felt"): ratio for cutoff, ratio in ratios.items()}


def felt_at(one: Any, other: Any) -> dict[tuple[str, ...], Any]:
    return {("r", "2 kHz", "felt"): one, ("r", "1 kHz", "felt"): other}


def best_errors(slow: float, other: float, fast: float) -> dict[tuple[str, int], tuple[float, float]]:
    return {("1 µm", 1000): (slow, 1.0), ("20 µm", 1000): (other, 1.0), ("1 µm", 20_000): (fast, 1.0)}


def lower_cutoffs(*errors: float | None) -> dict[str, tuple[float | None, ...]]:
    return {"a": errors, "b": (1.0, 0.95)}


def peaks_of(first: float, other: float, third: float) -> dict[tuple[str, ...], float]:
    cases = (("1 kHz", "felt"), ("1 kHz", "any"), ("2 kHz", "any"))
    return {
        ("rigid", "normal hand", *case): ratio
        for case, ratio in zip(cases, (first, other, third), strict=True)
    }


@pytest.mark.parametrize(
    ("rule", "numbers", "verdict"),
    [
        (rules.rises, ({"a": UP}, RATES), YES),
        (rules.rises, ({"a": FLAT}, RATES), NO),
        (rules.rises, ({"a": DIP}, RATES), NO),
        (rules.rises, ({"a": UP, "b": FLAT}, RATES), NO),
        (rules.rises, ({"a": SLIGHTLY}, RATES), NO),
        (rules.rises, ({"a": SLIGHTLY}, RATES, 1.15), YES),  # less than a rung
        (rules.levels_off, ({"a": 1.2}, {"a": 2.0}), "reproduced only with"),  # the lag
        (rules.levels_off, ({"a": 1.2}, {"a": None}), "reproduced only with"),  # beyond the search
        (rules.levels_off, ({"a": 1.2}, {"a": 1.1}), YES),
        (rules.levels_off, ({"a": 1.9}, {"a": 2.0}), NO),
        (rules.levels_off, ({"a": None}, {"a": 2.0}), NO),  # a cap shows no level
        (rules.level, ({"fitted": 560.0, "unfitted": 620.0}, 560.0), YES),
        (rules.level, ({"fitted": 620.0, "unfitted": 819.0}, 560.0), PARTLY),  # in its size alone
        (rules.level, ({"fitted": 620.0, "unfitted": 5000.0}, 560.0), NO),
        (rules.peaks, ({("rigid", "1 kHz"): (800.0, 577.0, 384.0)}, EXAMPLE), YES),
        (rules.peaks, ({("rigid", "1 kHz"): (577.0, 865.0, 384.0)}, EXAMPLE), PARTLY),  # in another order
        (rules.peaks, ({("rigid", "1 kHz"): (577.0, 2000.0, 384.0)}, EXAMPLE), NO),
        (rules.sometimes_better, (lower_cutoffs(1.0, 2.0, 0.8),), YES),
        (rules.sometimes_better, (lower_cutoffs(1.0, 2.0, None),), NO),  # only where both walls are stable
        (rules.sometimes_better, (lower_cutoffs(None, 0.1),), NO),
        (rules.best_below, (best_errors(0.9, 0.9, 1.2),), YES),
        (rules.best_below, (best_errors(0.9, 0.9, 0.9),), PARTLY),
        (rules.best_below, (best_errors(1.0, 0.9, 0.9),), UNDECIDED),  # it depends on the resolution
        (rules.best_below, (best_errors(1.0, 1.0, 0.9),), NO),
        (rules.same, ({"a": 1.05}, {"a": 1.0}), YES),
        (rules.same, ({"a": 1.5, "b": 1.0}, {"a": 1.0}), NO),
        (rules.same, ({"a": 1.12}, {"a": 1.0}, 1.1), YES),  # a rung more
        (rules.same, ({"a": 2.0}, {"a": 1.2}), NO),
        (rules.same_of_plants, ([(2.0, 2.0)] * 19 + [(2.0, 1.0)],), "follows from the method"),
        (rules.same_of_plants, ([(2.0, 2.0)] * 10 + [(2.0, 1.0)] * 10,), NO),
        (rules.half, (cutoffs(a=0.5, b=0.4),), YES),
        (rules.half, (cutoffs(a=0.5, b=0.2),), "reproduced only with a"),
        (rules.half, (cutoffs(a=7.6),), NO),
        (rules.half, (cutoffs(a=0.7),), NO),
        (rules.half, (cutoffs(a=0.7), 1.2), YES),  # within a step of its search
        (rules.half_of_plants, ([(0.5, 1.0)] * 10,), YES),
        (rules.half_of_plants, ([(0.5, 1.0), (7.0, 1.0)],), NO),
        (rules.higher_peak, (peaks_of(1.4, 1.4, 1.4),), YES),
        (rules.higher_peak, (peaks_of(1.4, 0.9, 0.9),), UNDECIDED),
        (rules.higher_peak, (peaks_of(1.4, 1.4, 0.9),), "reproduced only with 1 kHz"),
        (rules.higher_peak, (peaks_of(1.01, 1.01, 1.01),), NO),  # rounding
        (rules.higher_peak, (peaks_of(1.1, 1.1, 1.1), 1.35), NO),  # less than half a rung
        (rules.loses, (felt_at(FALLS, FALLS),), YES),  # a hundredth of the range does not count
        (rules.loses, (felt_at(RISES, FALLS),), "reproduced only with 1 kHz"),
        (rules.loses, (felt_at(RISES, RISES),), NO),
        (rules.loses, (felt_at([(0.0, 500.0), (1.0, 490.0)], RISES),), NO),
        (rules.loses, (felt_at([(0.0, 0.0), (1.0, 0.0)], RISES),), NO),  # nothing to lose
        (rules.first_rises, ({("r", "felt"): RISES},), YES),
        (rules.first_rises, ({("r", "felt"): FALLS},), NO),
        # It falls before it rises.
        (rules.first_rises, ({("r", "felt"): [(0.0, 200.0), (1.0, 150.0), (2.0, 300.0)]},), NO),
        # The rise is less than half a rung.
        (rules.first_rises, ({("r", "felt"): [(0.0, 200.0), (1.0, 220.0)]}, 1.35), NO),
        (rules.lower_penetration, ({"a": (57, 40, 29)},), YES),
        (rules.lower_penetration, ({"a": (57, 30, 28)},), NO),
        (
            rules.lower_penetration,
            ({"20 kHz, float": (57, 30, 28), "20 kHz, fixed": (57, 57, 29)},),
            ONLY_FIXED,
        ),
        (
            rules.lower_penetration,
            ({"20 kHz, float": (0.5, 0.0, 0.0), "20 kHz, fixed": (0.5, 0.5, 0.0)},),
            ONLY_FIXED,
        ),
        (rules.like_none, ({"a": (57, 57, 29)},), YES),
        (rules.like_none, ({"a": (57, 30, 29)},), NO),
        (rules.between, ({"10 kHz, fixed point": (57.0, 50.0, 29.0)},), YES),
        (rules.between, ({"10 kHz, fixed point": (57.0, 40.0, 29.0)},), NO),
        (rules.filter_delay, (rules.FILTER_DELAYS_S,), PARTLY),  # at 200 Hz
        (rules.filter_delay, ({200.0: 1e-3, 30.0: 7.5e-3},), YES),
        (rules.filter_delay, ({30.0: 1e-2},), NO),
        (rules.noisier, ({"a": 0.5}, 0.1), YES),
        (rules.noisier, ({"a": 0.5, "b": 0.1}, 0.1), "reproduced only with a"),
        (rules.noisier, ({"a": 0.1}, 0.1), NO),
        (rules.null_late, ({"a": (0.0, 0.9)},), YES),
        (rules.null_late, ({"a": (0.0, 0.0)},), NO),  # null at 2 kHz as well
        (rules.null_late, ({"a": (1.2, 1.0)},), NO),
        (rules.null_late_only, ({"a": (0.9, 0.1)},), YES),
        (rules.null_late_only, ({"a": (0.9, 0.1), "b": (0.0, 0.0)},), "reproduced only with a"),
        (rules.null_late_only, ({"a": (0.0, 0.0)},), NO),  # never seen
    ],
)
def test_a_rule_reaches_each_of_its_verdicts(rule: Any, numbers: Any, verdict: str) -> None:
    assert rule(*numbers).verdict == verdict


# --- pieces ----------------------------------------------------------------------------------------------------


def test_ideas_differ_in_key_and_are_all_possible_on_their_rig() -> None:
    tried = koul_ideas.ideas()
    assert len({idea.key for idea in tried}) == len(tried)
    assert tried[0].key == koul_ideas.REFERENCE
    for idea in tried:
        idea.scheme.applied(idea.experiment())


def test_linear_range_is_that_of_the_theory() -> None:
    experiment = MAIN[0].experiment()
    for scheme in SCHEMES.values():
        lifted = theory.as_lifted(experiment, scheme)
        assert koul_parts.linear_range(lifted) == pytest.approx(theory.b_max(lifted).damping, rel=1e-3)


def test_a_nonlinear_estimator_has_no_linear_limits() -> None:
    levant = next(idea for idea in koul_ideas.ideas() if idea.key == "estimator-levant")
    payload = {"experiment": config.as_mapping(levant.experiment()), "scheme": levant.scheme.text}
    assert "not_linear" in koul_parts.linear_limits({**payload, "dampings": [0.0], "islands": False})


def test_a_grid_gives_the_results_of_ladder_and_bisection() -> None:
    search = StiffnessSearch(way="grid", lowest=1.0, highest=64.0, ratio=2.0)
    grid = {"dampings": (0.0,), "search": search, "offsets": (0.1,), "judged": "true"}
    plan = MapPlan(experiment=MAIN[0].experiment(), schemes=(SCHEMES[DUAL],), **grid)
    rows = [{"stiffness": k, "passes_any_true": k not in (2.0, 64.0)} for k in search.rungs]
    for row in rows:
        row |= {f"passes_{c}_true": row["passes_any_true"] for c in ("felt", "heard")}
    (column,) = koul_ways.columns(ZWidth.of(plan, [rows]), 0, "any")
    assert (column.ladder, column.highest, column.islands) == (1.0, 32.0, ((4.0, 32.0),))
    assert column.bisection in (1.0, 32.0)  # the connected end of what it visited


def test_dual_rate_has_the_range_of_its_velocity_rate_at_one_stiffness() -> None:
    """The paper's first claim."""
    search = StiffnessSearch(way="bisection", lowest=0.05, highest=6.0, ratio=1.3)
    asked = {"stiffness": 50.0, "search": search, "weight": 1.0}
    tasks = koul_parts.range_tasks(HELD[0].experiment(), (SCHEMES[DUAL], SCHEMES[SLOW]), (0.1,), **asked)
    ranges = koul_parts.ranges_of(run_parts({"range": tasks}).results["range"], 1)
    for criterion in ("felt", "heard", "any"):
        dual, slow = (of[criterion].damping for of in ranges)
        assert 0.5 < dual <= 6.0
        assert within(dual, slow, 1.4)


def test_noise_of_a_count_is_less_at_the_low_rate() -> None:
    noise = koul_parts.velocity_noise({"offsets": [0.1, 0.7]})
    assert noise["20 kHz, fs/10"] > noise["20 kHz, fs/20"] > 3.0 * noise["2 kHz"] > 0.0


def test_random_plants_do_not_depend_on_how_they_are_dealt_out() -> None:
    payload = {"schemes": [SCHEMES[DUAL].text], "seed": 1, "islands": [0]}
    together = koul_parts.random_plants({**payload, "numbers": [0, 1, 2]})
    apart = [koul_parts.random_plants({**payload, "numbers": [n]})[0] for n in (0, 1, 2)]
    assert together == apart
    assert all(np.isfinite(plant["ranges"]).all() for plant in together)
    assert all(plant["with_islands"][0] >= 0.99 * plant["ranges"][0] for plant in together)


# ---------------------------------------------------------------------- figures 7 and 8


def test_the_handle_is_at_the_start_at_the_first_sample() -> None:
    """A trial without a byte link begins one tick earlier and coasts to the start."""
    for rate in (20_000, 10_000, 2000):
        experiment = compare.koul_entries(rate)[0].applied(compare.koul_experiment())
        _, plant, trace = simulate(experiment, compare.START, 0.4)
        position, velocity = trace.states[0, plant.sensed_position :][:2]
        assert position == pytest.approx(compare.START.position, abs=1e-8)
        assert velocity == pytest.approx(compare.START.velocity, abs=1e-4)


# --- figure 7 ---------------------------------------------------------------------------------------------


def test_few_bits_of_state_take_the_damping_from_a_uniform_wall_alone(figure_7: Any) -> None:
    """A uniform rate with cut-off fs/20 against 200 Hz at 2 kHz, with 14 bits and rounding to zero."""
    fixed = {panel.position_rate: panel.peaks for panel in figure_7 if panel.arithmetic == compare.FIXED}
    expected = {20_000: (57.0, 57.0, 29.0), 10_000: (57.0, 39.75, 29.0)}
    assert fixed == {rate: pytest.approx(peaks, abs=0.5) for rate, peaks in expected.items()}


@pytest.fixture(scope="module")
def figure_7() -> Any:
    return compare.koul_figure_7()


@pytest.fixture(scope="module")
def figure_8() -> Any:
    return compare.koul_figure_8()


def test_in_floating_point_the_uniform_wall_is_as_well_damped_as_the_dual_rate_one(figure_7: Any) -> None:
    """The effect in figure 7 is due to the word length, not to the method."""
    for panel in figure_7:
        none, uniform, dual = panel.peaks
        assert none == 57.0
        if panel.arithmetic == compare.FLOAT:
            assert 1.0 <= uniform / dual < 1.08
            assert uniform < 0.6 * none
            assert panel.comparison["uniform"].numbers.decay == 0.0
        elif panel.position_rate == 20_000:
            uniform_hits, none_hits = (panel.comparison[name].impacts for name in ("uniform", "none"))
            for damped, free in zip(uniform_hits, none_hits, strict=True):
                np.testing.assert_array_equal(damped.counts, free.counts, "no damping at all")
        assert panel.comparison["none"].numbers.decay > 0.5
        assert panel.comparison["dual"].numbers.bounces == 0.0


def test_two_word_lengths_and_cut_offs_give_figure_7_and_no_others() -> None:
    table = compare.word_lengths((0, 1, 2, 3, 4, 5, 6, 16))
    found = {(row.state_bits, round(1 / row.uniform_share)) for row in table if row.as_in_the_paper}
    assert found == {(4, 20), (2, 10)}
    wide = [row for row in table if row.state_bits == 16]
    assert all(row.uniform[rate] < 0.6 * row.none[rate] for row in wide for rate in row.none)


# --- figure 8 ---------------------------------------------------------------------------------------------


def test_velocity_at_20_khz_is_noisier_late_in_the_impact_and_null_only_in_fixed_point(figure_8: Any) -> None:
    profiles = figure_8
    slow, fast = profiles[2000, compare.FLOAT], profiles[20_000, compare.FLOAT]
    assert 5.0 < fast.noise_late / slow.noise_late < 10.0
    assert 1.2 < fast.noise_early / slow.noise_early < 3.0, "a fast handle shows less: many counts a period"
    assert slow.reading_late == pytest.approx(1.0, abs=0.1)
    assert fast.reading_late > 1.0, "noise, not null"
    null, dual = profiles[20_000, compare.FIXED], profiles[2000, compare.FIXED]
    assert (null.reading_early, null.reading_late) == (0.0, 0.0)
    assert null.delay_s is None
    assert null.noise_late == pytest.approx(profiles.speed_late, rel=0.01)
    assert 0.8 < dual.reading_late < 1.0


def test_the_delays_are_those_of_the_filters(figure_8: Any) -> None:
    """√2·T/(2·tan(π·fc·T)) plus half a period of the difference: 1.338 ms, and 0.249 ms at 20 kHz."""
    for (rate, cutoff_hz), share in {(2000, 200.0): 0.03, (20_000, 1000.0): 0.05}.items():
        expected = math.sqrt(2) / rate / (2 * math.tan(math.pi * cutoff_hz / rate)) + 0.5 / rate
        profile = figure_8[rate, compare.FLOAT]
        assert profile.cutoff_hz == cutoff_hz
        assert profile.delay_s == pytest.approx(expected, rel=share)
