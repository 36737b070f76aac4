"""The three search strategies over stiffness levels, on walls whose limits are known."""

import itertools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.experiments.mapping._searches import StiffnessSearch, limit_of

RANGE = {"lowest": 10.0, "highest": 1000.0, "ratio": 1.06}


def walk_search(search: Any, passes: Any) -> Any:
    """Return the walls that a search tries, given `passes(stiffness)[criterion]`: True, False or None."""
    tried = {}
    criteria = list(passes(1.0))
    way = search.walk(criteria)
    try:
        stiffness = next(way)
        while True:
            assert stiffness not in tried, "no wall is tried twice"
            tried[stiffness] = passes(stiffness)
            stiffness = way.send(tried[stiffness])
    except StopIteration:
        return tried


def limit(search: Any, passes: Any, criterion: str = "felt") -> Any:
    return limit_of({k: outcome[criterion] for k, outcome in walk_search(search, passes).items()})


def passes_below(bound: Any) -> Any:
    return lambda stiffness: {"felt": stiffness < bound}


@pytest.mark.parametrize("way", ["ladder", "bisection", "grid"])
@given(bound=st.floats(1.0, 2000.0))
def test_every_way_finds_the_last_rung_below_a_single_limit(way: str, bound: float) -> None:
    search = StiffnessSearch(way=way, **RANGE)
    found = limit(search, passes_below(bound))
    expected = max((k for k in search.rungs if k < bound), default=0.0)
    assert found.stiffness == expected
    assert found.capped == (search.rungs[-1] < bound)
    assert found.islands == ()


def test_rungs_keep_their_ratio_and_stay_in_the_range() -> None:
    rungs = StiffnessSearch(**RANGE).rungs
    assert rungs[0] == 10.0
    assert rungs[-1] <= 1000.0 < rungs[-1] * 1.06
    assert all(b / a == pytest.approx(1.06) for a, b in itertools.pairwise(rungs))


def test_a_bisection_of_a_hundred_rungs_needs_few_trials() -> None:
    search = StiffnessSearch(way="bisection", lowest=1.0, highest=1000.0, ratio=1.06)
    assert len(search.rungs) > 100
    assert len(walk_search(search, passes_below(77.0))) <= 9


def test_the_ladder_ends_when_every_criterion_has_failed_and_the_grid_never() -> None:
    def passes(k: Any) -> Any:
        return {"felt": k < 100.0, "heard": k < 300.0}

    ladder = StiffnessSearch(**RANGE)
    assert 300.0 <= max(walk_search(ladder, passes)) < 300.0 * 1.06
    grid = StiffnessSearch(way="grid", **RANGE)
    assert list(walk_search(grid, passes)) == grid.rungs


def test_an_island_is_shown_by_the_grid_and_unseen_by_the_ladder() -> None:
    def passes(k: Any) -> Any:
        return {"felt": k < 50.0 or 200.0 < k < 400.0}

    grid = limit(StiffnessSearch(way="grid", **RANGE), passes)
    ladder = limit(StiffnessSearch(**RANGE), passes)
    assert grid.stiffness == ladder.stiffness < 50.0
    ((low, high),) = grid.islands
    assert 200.0 < low < 200.0 * 1.06
    assert 400.0 / 1.06 < high < 400.0
    assert ladder.islands == ()


def test_bisection_with_two_criteria_gives_each_its_own_limit() -> None:
    def passes(k: Any) -> Any:
        return {"felt": k < 100.0, "heard": k < 600.0}

    search = StiffnessSearch(way="bisection", **RANGE)
    assert 100 / 1.06 < limit(search, passes, "felt").stiffness < 100
    assert 600 / 1.06 < limit(search, passes, "heard").stiffness < 600


@given(st.dictionaries(st.floats(1.0, 1e4), st.sampled_from([True, False, None]), max_size=30))
def test_a_limit_lies_below_every_failure_and_counts_unknown_walls(tried: Any) -> None:
    found = limit_of(tried)
    failures = [k for k, passes in tried.items() if passes is False]
    assert found.failed_at == min(failures, default=None)
    lowest = min(failures, default=1e9)
    assert found.stiffness == max((k for k, passes in tried.items() if passes and k < lowest), default=0.0)
    assert found.unknown == list(tried.values()).count(None)
    assert found.capped == (not failures and any(tried.values()))
    for low, high in found.islands:
        assert found.failed_at < low <= high
        assert not any(low <= k <= high for k in failures)


@pytest.mark.parametrize("wrong", [{"lowest": 0.0}, {"highest": 5.0}, {"ratio": 1.0}, {"highest": math.inf}])
def test_an_invalid_range_is_refused(wrong: Any) -> None:
    with pytest.raises(ValueError, match=r"range|ratio"):
        StiffnessSearch(**{**RANGE, **wrong})
