"""The guide's numbers for search rules: in the stored table of 1000 sessions, and in a few sessions simulated again."""

import math
from functools import cache
from typing import Any

import pytest

from tests.benchmarks import observers

TABLE = observers.read_table()
ROWS = {(row["rule"], row["lapse_rate"], row["spread"]): row for row in TABLE["rows"]}
GRADUAL = {(row["rule"], row["lapse_rate"], row["spread"]): row for row in TABLE["gradual"]}
SERIES = ("ascending × 5", "ascending × 1")
OTHERS = [name for name in observers.RULES if name not in SERIES]
AGAIN = 40  # sessions


@cache
def simulate_again(case: tuple[str, float, float], sessions: int = AGAIN) -> observers.Row:
    return observers.row_of(case, sessions)


def test_the_table_holds_every_case() -> None:
    assert list(ROWS) == observers.cases(), f"run {observers.REGENERATE}"


def test_the_guide_shows_the_committed_table_in_sections_that_exist_once() -> None:
    text = observers.GUIDE.read_text(encoding="utf-8")
    assert all(text.count(f"<!-- generated: {section} -->") == 1 for section in observers.SECTIONS)
    assert observers.main(["--check"]) == 0, f"run {observers.REGENERATE} --guide"


@pytest.mark.parametrize("rule", observers.RULES)
def test_a_few_sessions_again_agree_with_the_table(rule: Any) -> None:
    """Agreement within the scatter of so few sessions shows that the table belongs to the current code."""
    row, now = ROWS[rule, 0.02, 15.0], simulate_again((rule, 0.02, 15.0))
    assert abs(now["bias"] - row["bias"]) < 4.0 * row["scatter"] / math.sqrt(AGAIN)
    assert now["scatter"] == pytest.approx(row["scatter"], rel=0.5)
    assert now["hits"] == pytest.approx(row["hits"], rel=0.15)
    assert abs(now["covered"] - row["covered"]) < 0.15


def test_one_slip_in_fifty_makes_the_ascending_rule_read_low_and_no_other() -> None:
    ascended = simulate_again(("ascending × 5", 0.02, 15.0))
    assert ascended["bias"] < -40.0
    assert ascended["bias"] < -ascended["scatter"]
    for name in OTHERS:
        found = ROWS[name, 0.02, 15.0]  # a few sessions again agree with it
        assert abs(found["bias"]) < 5.0, name
    assert simulate_again(("psi", 0.02, 15.0))["hits"] < ascended["hits"] / 2


def test_intervals_hold_what_they_promise_except_the_ascending_rules() -> None:
    for (name, lapse_rate, spread), row in ROWS.items():
        if name in OTHERS:
            assert row["covered"] >= 0.93, (name, lapse_rate, spread)
            assert abs(row["bias"]) <= 12.5, (name, lapse_rate, spread)  # half a step
        elif name == "ascending × 5":
            assert 0.45 < row["covered"] < 0.94, (lapse_rate, spread)
        else:  # one series knows nothing of its scatter
            assert row["width"] is None


@pytest.mark.exhaustive(
    "tests/rig/session/test_search.py::test_limits_on_levels_a_ratio_apart_are_found_with_honest_intervals"
)
def test_intervals_of_psi_hold_the_limit_of_gradual_observers_too() -> None:
    """With a prior that ended at a quarter of the range, only 91 to 93 % of intervals contained the limit."""
    assert simulate_again(("psi", 0.0, 120.0), sessions=300)["covered"] >= 0.935
    for (name, lapse_rate, spread), row in GRADUAL.items():
        if name in OTHERS:
            assert row["covered"] >= (0.94 if name == "psi" else 0.92), (name, lapse_rate, spread)


def test_a_limit_beyond_the_levels_is_marked_where_it_is_and_nowhere_else() -> None:
    marked = {(row["rule"], row["lapse_rate"], row["spread"]): row["marked"] for row in TABLE["beyond"]}
    assert list(marked) == observers.cases(), f"run {observers.REGENERATE}"
    for (name, lapse_rate, spread), share in marked.items():
        if name in OTHERS:
            assert share >= (0.7 if name == "staircase 1u3d" else 0.96), (name, lapse_rate, spread)
    for (name, lapse_rate, spread), row in ROWS.items():
        if name != "ascending × 1":  # whose only series may fail at the softest wall
            assert row["censored"] <= 0.002, (name, lapse_rate, spread)
    now = observers.beyond_of(("psi", 0.05, 15.0), sessions=10)
    assert now["marked"] == marked["psi", 0.05, 15.0] == 1.0
