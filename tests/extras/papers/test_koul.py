"""The rules that judge the claims of Koul et al., on made-up numbers that reach every verdict; parts of the run."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import config
from rig.analysis import theory
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan, ZWidth
from rig.extras.papers.koul import ideas as koul_ideas
from rig.extras.papers.koul import parts as koul_parts
from rig.extras.papers.koul import rules as koul_rules
from rig.extras.papers.koul import ways as koul_ways
from rig.extras.papers.koul.rigs import DUAL, HELD, MAIN, SCHEMES, SLOW
from rig.extras.papers.parts import part, run_parts
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


@settings(max_examples=40)
@given(st.dictionaries(st.tuples(st.sampled_from("rs"), st.sampled_from("xyz")), st.booleans(), min_size=1))
def test_a_condition_is_named_when_every_case_under_it_held(cases: dict[tuple[str, ...], bool]) -> None:
    found = judge_settable(cases, [1])
    held = {word for word in "xyz" if (of := [h for case, h in cases.items() if case[1] == word]) and all(of)}
    assert set(found.sufficient) == held
    expected = (
        ClaimStatus.REPRODUCED if all(cases.values()) else ClaimStatus.ONLY_WITH if held else ClaimStatus.NOT
    )
    assert found.status is expected


def test_a_claim_about_readings_needs_most_of_them() -> None:
    assert judge_share(95, 100).status is ClaimStatus.REPRODUCED
    assert judge_share(5, 100).status is judge_share(89, 100).status is ClaimStatus.NOT
    assert judge_share(5, 100)["share"] == 0.05
    assert judge_share(0, 100).status is ClaimStatus.NOT
    assert judge_share(0, 0).status is ClaimStatus.NOT  # nothing was held anywhere


def test_rising_wants_every_rate_and_the_whole_way() -> None:
    up, flat, dip = [100, 200, 600, 700], [100, 400, 600, 700], [100, 50, 600, 700]
    assert koul_rules.rises({"a": up}, RATES).status is ClaimStatus.REPRODUCED
    assert koul_rules.rises({"a": flat}, RATES).status is ClaimStatus.NOT
    assert koul_rules.rises({"a": dip}, RATES).status is ClaimStatus.NOT
    assert koul_rules.rises({"a": up, "b": flat}, RATES).status is ClaimStatus.NOT
    slightly = [100, 90, 600, 700]
    assert koul_rules.rises({"a": slightly}, RATES).status is ClaimStatus.NOT
    # Less than a rung.
    assert koul_rules.rises({"a": slightly}, RATES, step=1.15).status is ClaimStatus.REPRODUCED


def test_levelling_off_needs_the_lag_when_the_control_keeps_rising() -> None:
    found = koul_rules.levels_off({"a": 1.2}, {"a": 2.0})
    assert found.status is ClaimStatus.ONLY_WITH
    assert found["lag"]
    assert koul_rules.levels_off({"a": 1.2}, {"a": None})["lag"]  # beyond the search
    assert koul_rules.levels_off({"a": 1.2}, {"a": 1.1}).status is ClaimStatus.REPRODUCED
    assert koul_rules.levels_off({"a": 1.9}, {"a": 2.0}).status is ClaimStatus.NOT
    assert koul_rules.levels_off({"a": None}, {"a": 2.0}).status is ClaimStatus.NOT  # a cap shows no level


def test_a_stiffness_far_from_the_papers_is_reproduced_in_its_size_alone() -> None:
    def status_of(fitted: float, unfitted: float) -> ClaimStatus:
        return koul_rules.level({"fitted": fitted, "unfitted": unfitted}, 560.0).status

    assert status_of(560.0, 620.0) is ClaimStatus.REPRODUCED
    assert status_of(620.0, 819.0) is ClaimStatus.PARTLY
    assert status_of(620.0, 5000.0) is ClaimStatus.NOT


def test_peaks_in_another_order_are_reproduced_in_their_size_alone() -> None:
    def status_of(*stiffnesses: float) -> ClaimStatus:
        return koul_rules.peaks({("rigid", "1 kHz"): stiffnesses}, (780.0, 560.0, 350.0)).status

    assert status_of(800.0, 577.0, 384.0) is ClaimStatus.REPRODUCED
    assert status_of(577.0, 865.0, 384.0) is ClaimStatus.PARTLY
    assert status_of(577.0, 2000.0, 384.0) is ClaimStatus.NOT


def test_a_claim_that_depends_on_what_the_paper_leaves_open_is_undecided() -> None:
    assert judge({"a": True, "b": False}).undecided().verdict == "undecided"
    assert judge({"a": False, "b": False}).undecided().verdict == "not reproduced"
    assert judge({"a": True}).undecided().verdict == "reproduced"


def test_a_lower_cutoff_counts_where_both_walls_are_stable() -> None:
    def status_of(*errors: float | None) -> ClaimStatus:
        return koul_rules.sometimes_better({"a": errors, "b": (1.0, 0.95)}).status

    assert status_of(1.0, 2.0, 0.8) is ClaimStatus.REPRODUCED
    assert status_of(1.0, 2.0, None) is status_of(None, 0.1) is status_of(1.0, None) is ClaimStatus.NOT


def test_the_best_estimator_of_a_rate_may_depend_on_the_resolution() -> None:
    def status_of(slow: float, other: float, fast: float) -> str:
        errors = {("1 µm", 1000): (slow, 1.0), ("20 µm", 1000): (other, 1.0), ("1 µm", 20_000): (fast, 1.0)}
        return str(koul_rules.best_below(errors).status)

    assert status_of(0.9, 0.9, 1.2) == "reproduced"
    assert status_of(0.9, 0.9, 0.9) == "reproduced in part:"
    assert status_of(1.0, 0.9, 0.9) == "undecided"
    assert status_of(1.0, 1.0, 0.9) == "not reproduced"


def test_equal_ranges_are_equal_in_every_case() -> None:
    assert koul_rules.same({"a": 1.05}, {"a": 1.0}).status is ClaimStatus.REPRODUCED
    assert koul_rules.same({"a": 1.5, "b": 1.0}, {"a": 1.0}).failed == ["a"]
    assert koul_rules.same({"a": 1.12}, {"a": 1.0}, step=1.1).status is ClaimStatus.REPRODUCED  # a rung more
    assert koul_rules.same({"a": 2.0}, {"a": 1.2}).status is ClaimStatus.NOT


def test_equal_ranges_of_random_plants_want_most_of_them() -> None:
    same, other = (2.0, 2.0), (2.0, 1.0)
    assert koul_rules.same_of_plants([same] * 19 + [other]).status is ClaimStatus.FOLLOWS
    assert koul_rules.same_of_plants([same] * 10 + [other] * 10).status is ClaimStatus.NOT
    assert koul_rules.same_of_plants([same, other])["count"] == 1


def test_half_is_half_and_not_less() -> None:
    def status_of(step: float = 1.0, **ratios: float) -> str:
        cases = {("rigid", cutoff, "felt"): ratio for cutoff, ratio in ratios.items()}
        return koul_rules.half(cases, step).verdict

    assert status_of(a=0.5, b=0.4) == "reproduced"
    assert status_of(a=0.5, b=0.2) == "reproduced only with a"
    assert status_of(a=7.6) == "not reproduced"
    assert status_of(a=0.7) == "not reproduced"
    assert status_of(1.2, a=0.7) == "reproduced"  # within a step of its search
    assert koul_rules.half_of_plants([(0.5, 1.0)] * 10).status is ClaimStatus.REPRODUCED
    assert koul_rules.half_of_plants([(0.5, 1.0), (7.0, 1.0)]).status is ClaimStatus.NOT


def test_a_peak_is_higher_by_more_than_rounding() -> None:
    one, other, third = (
        ("rigid", "normal hand", cutoff, criterion)
        for cutoff, criterion in (("1 kHz", "felt"), ("1 kHz", "any"), ("2 kHz", "any"))
    )
    assert koul_rules.higher_peak({one: 1.4}).status is ClaimStatus.REPRODUCED
    found = koul_rules.higher_peak({one: 1.4, other: 0.9, third: 0.9})
    assert found.status is ClaimStatus.UNDECIDED
    assert found["groups"] == [("rigid, 1 kHz", 1, 2), ("rigid, 2 kHz", 0, 1)]
    assert koul_rules.higher_peak({one: 1.4, other: 1.4, third: 0.9}).verdict.endswith("only with 1 kHz")
    assert koul_rules.higher_peak({one: 1.01}).status is ClaimStatus.NOT
    assert koul_rules.higher_peak({one: 1.1}, step=1.35).status is ClaimStatus.NOT  # less than half a rung


FALLS = [(0.0, 500.0), (0.01, 500.0), (1.0, 400.0), (2.0, 100.0), (3.0, 0.0)]
RISES = [(0.0, 200.0), (1.0, 300.0), (2.0, 250.0), (3.0, 0.0)]


def test_stiffness_is_lost_once_damping_is_added() -> None:
    def status_of(curve: koul_rules.Curve, other: koul_rules.Curve = FALLS) -> str:
        return koul_rules.loses({("r", "2 kHz", "felt"): curve, ("r", "1 kHz", "felt"): other}).verdict

    assert status_of(FALLS) == "reproduced"  # a hundredth of the range does not count
    assert status_of(RISES) == "reproduced only with 1 kHz"
    assert status_of(RISES, RISES) == "not reproduced"
    assert status_of([(0.0, 500.0), (1.0, 490.0)], RISES) == "not reproduced"
    assert status_of([(0.0, 0.0), (1.0, 0.0)], RISES) == "not reproduced"  # nothing to lose


def test_stiffness_rises_to_a_peak() -> None:
    def status_of(curve: koul_rules.Curve, step: float = 1.0) -> str:
        return koul_rules.first_rises({("r", "felt"): curve}, step).verdict

    assert status_of(RISES) == "reproduced"
    assert status_of(FALLS) == "not reproduced"
    assert status_of([(0.0, 200.0), (1.0, 150.0), (2.0, 300.0)]) == "not reproduced"  # it falls first
    assert status_of([(0.0, 200.0), (1.0, 220.0)], step=1.35) == "not reproduced"  # less than half a rung


def test_penetration_with_dual_rate_is_clearly_the_lowest() -> None:
    assert koul_rules.lower_penetration({"a": (57, 40, 29)}).status is ClaimStatus.REPRODUCED
    some = {"20 kHz, float": (57, 30, 28), "20 kHz, fixed": (57, 57, 29), "10 kHz, fixed": (57, 40, 29)}
    assert koul_rules.lower_penetration(some).verdict == "reproduced only with fixed"
    assert koul_rules.lower_penetration({"a": (57, 30, 28)}).status is ClaimStatus.NOT
    assert koul_rules.like_none({"a": (57, 57, 29)}).status is ClaimStatus.REPRODUCED
    assert koul_rules.like_none({"a": (57, 30, 29)}).status is ClaimStatus.NOT


def test_a_filter_delay_that_agrees_at_one_cut_off_is_reproduced_in_part() -> None:
    found = koul_rules.filter_delay(koul_rules.FILTER_DELAYS_S)
    assert (found.status, found.held) == (ClaimStatus.PARTLY, ["200 Hz"])
    assert [round(1e3 * delay_s, 2) for row in found["found"] for delay_s in row[2:]] == [
        1.09,
        1.34,
        7.5,
        7.75,
    ]
    assert koul_rules.filter_delay({200.0: 1e-3, 30.0: 7.5e-3}).status is ClaimStatus.REPRODUCED
    assert koul_rules.filter_delay({30.0: 1e-2}).status is ClaimStatus.NOT


def test_an_equal_decay_of_zero_is_not_more_damped() -> None:
    decays = {"20 kHz, floating point": (0.5, 0.0, 0.0), "20 kHz, fixed point": (0.5, 0.5, 0.0)}
    assert koul_rules.lower_penetration(decays).condition == "fixed point"
    assert koul_rules.between({"10 kHz, fixed point": (57.0, 50.0, 29.0)}).status is ClaimStatus.REPRODUCED
    assert koul_rules.between({"10 kHz, fixed point": (57.0, 40.0, 29.0)}).status is ClaimStatus.NOT


def test_noise_and_null_readings_are_about_the_rate() -> None:
    assert koul_rules.noisier({"a": 0.5}, 0.1).status is ClaimStatus.REPRODUCED
    assert koul_rules.noisier({"a": 0.5, "b": 0.1}, 0.1).verdict == "reproduced only with a"
    assert koul_rules.noisier({"a": 0.1}, 0.1).status is ClaimStatus.NOT
    assert koul_rules.null_late({"a": (0.0, 0.9)}).status is ClaimStatus.REPRODUCED
    assert koul_rules.null_late({"a": (0.0, 0.0)}).status is ClaimStatus.NOT  # null at 2 kHz as well
    assert koul_rules.null_late({"a": (1.2, 1.0)}).status is ClaimStatus.NOT
    assert koul_rules.null_late_only({"a": (0.9, 0.1)}).status is ClaimStatus.REPRODUCED
    assert koul_rules.null_late_only({"a": (0.9, 0.1), "b": (0.0, 0.0)}).verdict == "reproduced only with a"
    assert koul_rules.null_late_only({"a": (0.0, 0.0)}).status is ClaimStatus.NOT  # never seen


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
    plan = MapPlan(
        experiment=MAIN[0].experiment(),
        schemes=(SCHEMES[DUAL],),
        dampings=(0.0,),
        search=search,
        offsets=(0.1,),
        judged="true",
    )
    rows = [{"stiffness": k, "passes_any_true": k not in (2.0, 64.0)} for k in search.rungs]
    for row in rows:
        row |= {f"passes_{c}_true": row["passes_any_true"] for c in ("felt", "heard")}
    (column,) = koul_ways.columns(ZWidth.of(plan, [rows]), 0, "any")
    assert (column.ladder, column.highest, column.islands) == (1.0, 32.0, ((4.0, 32.0),))
    assert column.bisection in (1.0, 32.0)  # the connected end of what it visited


def test_ranges_do_not_depend_on_the_number_of_workers() -> None:
    """One part of each cheap kind gives equal bits with one worker and with two."""
    held = HELD[0].experiment()
    search = StiffnessSearch(way="bisection", lowest=0.05, highest=6.0, ratio=1.3)
    schemes = (SCHEMES[DUAL], SCHEMES[SLOW])
    tasks = koul_parts.range_tasks(held, schemes, (0.1,), stiffness=50.0, search=search, weight=1.0)
    plants = {"schemes": [s.text for s in schemes], "numbers": [0, 1], "seed": 3, "islands": [0, 1]}
    parts = {
        "range": tasks,
        "plants": part(koul_parts.random_plants, plants, 1.0),
        "noise": part(koul_parts.velocity_noise, {"offsets": [0.4]}, 1.0),
    }
    one, two = (run_parts(parts, workers=workers) for workers in (1, 2))
    found = [json.dumps({name: list(of) for name, of in done.results.items()}) for done in (one, two)]
    assert found[0] == found[1]
    ranges = koul_parts.ranges_of(one.results["range"], 1)
    for criterion in ("felt", "heard", "any"):  # the paper's first claim, at one stiffness
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
