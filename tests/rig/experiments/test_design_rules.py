"""Rules that judge designs, without hits or theory: the Pareto front, the binding requirement, equal schemes."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.experiments.design import _rules as rules
from rig.experiments.design._rules import BoundaryMeasures, Comparison, Measures, UnmetError, Wishes
from rig.experiments.mapping._searches import Extent

FEW = st.sampled_from([0.0, 1.0, 2.0, 3.0])  # so that ties are common
NUMBERS = ("undamped", "stiffness", "damping", "area", "noise", "fidelity_hz")
measured = st.builds(Measures, cost=st.none() | FEW, **dict.fromkeys(NUMBERS, FEW))
some = st.lists(measured, min_size=1, max_size=12)


def plain(**values: Any) -> Measures:
    return Measures(**{**dict.fromkeys((*NUMBERS, "cost"), 1.0), **values})


@given(some)
def test_the_front_has_exactly_the_schemes_that_no_other_dominates(found: Any) -> None:
    front = set(rules.front(found))
    assert front
    for index, one in enumerate(found):
        by = [i for i, other in enumerate(found) if rules.dominates(other, one)]
        assert (index in front) == (not by)
        if by:
            assert front & set(by), "what dominates is dominated only by what dominates, too"


@given(st.lists(st.sampled_from([0.0, 0.0, 1.0, 2.5, 1e3]), min_size=2, max_size=9))
def test_a_boundary_reaches_to_the_last_wall_and_holes_count_nothing(limits: Any) -> None:
    dampings = [float(n) for n in range(len(limits))]
    found, extent = BoundaryMeasures.of(dampings, limits), Extent.of(dampings, limits)
    last = max((n for n, k in enumerate(limits) if k > 0.0), default=0)
    assert found.damping == extent.damping == last
    assert extent.holes == tuple(float(n) for n in range(last) if limits[n] == 0.0)
    area = sum(0.5 * (a + b) for a, b in pairwise(limits[: last + 1]))
    assert found.area == extent.area == pytest.approx(area)
    assert (found.undamped, found.stiffness) == (limits[0], max(limits))


def test_the_goal_decides_among_what_fulfils_the_wishes_and_nothing_else_before() -> None:
    stiff, wide = plain(stiffness=9.0), plain(damping=9.0)
    for goal, better in (("stiffness", stiff), ("damping", wide)):
        wishes = Wishes(goal=goal)  # type: ignore[arg-type]
        assert max((stiff, wide), key=lambda one: rules.key(wishes, one, {}, 1.0)) is better
        assert rules.key(wishes, better, {"wall": 0.9}, 1.0) < rules.key(wishes, plain(), {"wall": 1.0}, 1.0)


def test_quiet_is_the_least_noise_without_a_loss_of_area() -> None:
    wishes = Wishes(goal="quiet")
    narrow, quiet, loud = plain(area=0.5, noise=0.1), plain(area=0.99, noise=0.5), plain(area=9.0, noise=2.0)
    assert max((narrow, quiet, loud), key=lambda one: rules.key(wishes, one, {}, own_area=1.0)) is quiet


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ([{"noise": 0.5, "cost": 2.0}, {"noise": 0.8, "cost": 3.0}], r"`most_noise`\).*0\.8 of it"),
        ([{"noise": 2.0, "cost": 0.2}, {"noise": 0.9, "cost": 3.0}], r"\((`most_noise`|`most_cost`)\)"),
        ([{"noise": 0.3, "cost": 0.9}, {"noise": 0.6, "cost": 0.1}], r"`most_noise`\).*0\.6 of it"),
    ],
)
def test_the_wish_that_binds_is_named_with_the_best_value(shares: Any, message: str) -> None:
    with pytest.raises(UnmetError, match=message):
        rules.refuse_unmet(Wishes(noise=0.1, cost=10.0), shares)
    rules.refuse_unmet(Wishes(noise=0.1), [{"noise": 0.1}, {"noise": 1.0}])  # one is enough


def test_wishes_about_a_path_are_fulfilled_from_one_on() -> None:
    wishes = Wishes(fidelity_hz=50.0, noise=0.2, cost=100.0)
    assert wishes.of_path(0.4, 100.0, 50.0) == {"fidelity_hz": 2.0, "noise": 0.5, "cost": 2.0}
    assert wishes.of_path(0.0, 50.0, None) == {"fidelity_hz": 1.0, "noise": math.inf, "cost": 0.0}


def test_as_good_means_each_measure_of_the_paper_to_a_rung() -> None:
    own = plain(undamped=100.0, stiffness=200.0, damping=3.0)
    assert rules.as_good(plain(undamped=99.0, stiffness=198.5, damping=3.0), own, 1.02)
    assert not rules.as_good(plain(undamped=99.0, stiffness=400.0, damping=2.9), own, 1.02)


@pytest.mark.parametrize(
    ("name", "worse", "enough"),
    [
        ("k_width", 86.0, 87.0),
        ("b_width", 99.0, 100.0),
        ("worst_fidelity", 103.0, 101.0),
        ("tuned", 101, 100),
    ],
)
def test_each_row_of_the_second_papers_table_has_a_tolerance(name: str, worse: float, enough: float) -> None:
    assert not rules.reaches(name, worse, 100.0, 1.15)
    assert rules.reaches(name, enough, 100.0, 1.15)
    assert not rules.reaches(name, math.nan, 100.0, 1.15)
    assert rules.reaches(name, math.nan, math.nan, 1.15)


def test_the_interval_of_a_comparison_is_students_and_has_its_coverage() -> None:
    random = np.random.default_rng(1)
    covered = 0
    for _ in range(400):
        own = random.normal(10.0, 1.0, 8)
        found = Comparison(tuple(own + random.normal(0.5, 1.0, 8)), tuple(own))
        _, low, high = found.interval
        covered += low <= 0.5 / own.mean() <= high
    assert 0.95 - 4 * math.sqrt(0.95 * 0.05 / 400) < covered / 400 < 0.95 + 4 * math.sqrt(0.95 * 0.05 / 400)


def test_no_worse_needs_the_whole_interval() -> None:
    own = (10.0, 12.0, 11.0, 9.0)
    assert Comparison(own, own).no_worse
    assert not Comparison(own, own).better
    assert Comparison(tuple(1.1 * one for one in own), own).better
    assert not Comparison((20.0, 6.0, 11.0, 9.0), own).no_worse, "the mean is better, but nothing is shown"
    assert not Comparison((20.0,), (10.0,)).no_worse, "one pair shows nothing"
