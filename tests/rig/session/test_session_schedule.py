"""The order of a session's conditions: balanced as declared, reproducible from the seed, with a search rule per run."""

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.session.planning._protocol import Condition, Order, Practice, Protocol, Search, Study
from rig.session.planning._schedule import (
    SearchRun,
    asking_of,
    cells_of,
    levels_of,
    rows_of,
    rule_of,
    schedule,
    williams,
)
from rig.session.search import JudgedProbe

SEARCH = Search(lowest=100.0, highest=500.0, step=100.0)


def protocol(dampings: list[int], **order: Any) -> Protocol:
    return Protocol(
        study=Study(title="a study", preset="koul-rigid", seed=4),
        condition=tuple(
            Condition(name=f"c{n}", damping=tuple(0.1 * b for b in range(number)))
            for n, number in enumerate(dampings)
        ),
        search=SEARCH,
        order=Order(**order),
    )


orders = st.builds(
    protocol,
    st.lists(st.integers(1, 3), min_size=1, max_size=5),
    kind=st.sampled_from(["fixed", "randomised", "latin-square"]),
    blocks=st.sampled_from(["repeat", "condition", "one"]),
    repeats=st.integers(1, 4),
    interleave=st.booleans(),
)


def sequences(one: Protocol, row: int) -> list[list[Any]]:
    return [[(run.condition, run.damping) for run in block.runs] for block in schedule(one, row)]


@pytest.mark.parametrize("n", range(1, 10))
def test_williams_balances_places_and_followers(n: int) -> None:
    items = list(range(n))
    rows = 1 if n == 1 else n if n % 2 == 0 else 2 * n
    square = [williams(items, row) for row in range(rows)]
    assert all(sorted(row) == items for row in square)
    places = Counter((place, item) for row in square for place, item in enumerate(row))
    assert set(places.values()) == {rows // n}
    followers = Counter(pair for row in square for pair in pairwise(row))
    assert len(followers) == n * (n - 1)
    assert len(set(followers.values())) <= 1
    assert [williams(items, row + rows) for row in range(rows)] == square  # and round again


@settings(max_examples=40)
@given(orders, st.integers(0, 50))
def test_a_session_holds_every_search_as_often_as_declared(one: Protocol, row: int) -> None:
    blocks = schedule(one, row)
    assert blocks == schedule(one, row)
    runs = [run for block in blocks for run in block.runs]
    assert [run.number for run in runs] == list(range(1, len(runs) + 1))
    assert [block.number for block in blocks] == list(range(1, len(blocks) + 1))
    repeats = set(range(1, one.order.repeats + 1))
    assert Counter((run.condition, run.damping, run.repeat) for run in runs) == Counter(
        (condition, damping, repeat) for condition, damping in cells_of(one) for repeat in repeats
    )
    assert all(block.interleave == one.order.interleave for block in blocks)
    for cell in cells_of(one):  # repeats are numbered as they come
        numbers = [run.repeat for run in runs if (run.condition, run.damping) == cell]
        assert numbers == sorted(numbers)
    expected = {"repeat": one.order.repeats, "condition": len(one.condition), "one": 1}
    assert len(blocks) == expected[one.order.blocks]


@settings(max_examples=20)
@given(orders)
def test_seeds_of_runs_differ_between_runs_and_participants(one: Protocol) -> None:
    seeds = [run.seed for row in range(3) for block in schedule(one, row) for run in block.runs]
    assert len(set(seeds)) == len(seeds)
    assert max(seeds) < 2**53


@pytest.mark.parametrize("blocks", ["repeat", "one"])
@pytest.mark.parametrize("dampings", [[1, 1], [2, 1], [2, 2], [1, 3, 1]])
def test_a_latin_square_is_balanced_in_every_block(dampings: list[int], blocks: str) -> None:
    one = protocol(dampings, kind="latin-square", repeats=2, blocks=blocks)
    cells, rows = cells_of(one), rows_of(one)
    study = [[cell for block in sequences(one, row) for cell in block] for row in range(rows)]
    for repeat in range(2):
        part = [session[repeat * len(cells) : (repeat + 1) * len(cells)] for session in study]
        places = Counter((place, cell) for row in part for place, cell in enumerate(row))
        assert set(places.values()) == {rows // len(cells)}
        followers = Counter(pair for row in part for pair in pairwise(row))
        assert len(set(followers.values())) == 1


def test_blocks_of_conditions_are_balanced_among_themselves() -> None:
    one = protocol([2, 3, 2], kind="latin-square", blocks="condition", repeats=2)
    rows = rows_of(one)
    assert rows == 6
    study = [[block[0][0] for block in sequences(one, row)] for row in range(rows)]
    assert all(len({name for name, _ in block}) == 1 for row in range(rows) for block in sequences(one, row))
    assert set(Counter((place, name) for row in study for place, name in enumerate(row)).values()) == {2}
    assert set(Counter(pair for row in study for pair in pairwise(row)).values()) == {2}


@pytest.mark.parametrize("kind", ["fixed", "randomised", "latin-square"])
def test_a_fitted_part_stays_for_all_blocks_that_need_it(kind: str) -> None:
    one = protocol([1] * 6, kind=kind, blocks="condition")
    fits = ["", "a damper", "", "a damper", "", "a damper"]
    fit_of = {f"c{n}": fit for n, fit in enumerate(fits)}
    one = replace(one, condition=tuple(replace(c, fit=fit_of[c.name]) for c in one.condition))
    rows = {"fixed": 1, "randomised": 40, "latin-square": 2 * 6}[kind]
    study = [[block[0][0] for block in sequences(one, row)] for row in range(rows)]
    for row in study:
        assert [fit_of[name] for name in row] in (
            ["", "", ""] + ["a damper"] * 3,
            ["a damper"] * 3 + [""] * 3,
        )
    if kind == "latin-square":
        assert rows_of(one) == rows
        assert set(Counter((place, name) for row in study for place, name in enumerate(row)).values()) == {2}
    if kind == "randomised":
        assert len({tuple(row) for row in study}) > 20


def test_a_fixed_order_is_as_written_and_a_drawn_one_depends_on_all_that_it_should() -> None:
    fixed = protocol([2, 1, 1], kind="fixed", repeats=2)
    assert sequences(fixed, 0) == sequences(fixed, 7) == [list(cells_of(fixed))] * 2
    drawn = protocol([3, 3], kind="randomised", repeats=30)
    other = replace(drawn, study=replace(drawn.study, seed=5))
    blocks = sequences(drawn, 0)
    assert len({tuple(block) for block in blocks}) > 20  # anew for each block
    assert blocks != sequences(drawn, 1)
    assert blocks != sequences(other, 0)
    firsts = Counter(block[0] for row in range(40) for block in sequences(drawn, row))
    assert all(140 <= firsts[cell] <= 260 for cell in cells_of(drawn))  # of 1200, six ways


def test_the_order_of_a_seed_never_changes() -> None:
    """A study may run for a year, and a software update must not change the order of its participants."""
    drawn = protocol([1, 1, 1, 1], kind="randomised")
    assert sequences(drawn, 0) == [[("c0", 0.0), ("c3", 0.0), ("c2", 0.0), ("c1", 0.0)]]
    square = protocol([1, 1, 1, 1], kind="latin-square")
    assert sequences(square, 0) == [[("c1", 0.0), ("c3", 0.0), ("c2", 0.0), ("c0", 0.0)]]
    assert schedule(square, 0)[0].runs[0].seed == 4654790825111401


def test_practice_comes_first_and_goes_through_its_walls() -> None:
    one = replace(protocol([1, 2]), practice=Practice(stiffness=(300.0, 100.0), condition="c1"))
    first, second = schedule(one, 0)
    assert (first.number, first.practice, second.number) == (0, True, 1)
    (run,) = first.runs
    assert (run.number, run.condition, run.damping, run.practice) == (0, "c1", 0.0, True)
    rule, answers = rule_of(one, run), []
    while (probe := rule.next(answers)) is not None:
        answers.append(JudgedProbe(probe, None))
    assert [answer.probe.level for answer in answers] == [300.0, 100.0]


@pytest.mark.parametrize(
    ("search", "levels"),
    [
        (Search(lowest=0.1, highest=0.5, step=0.1), (0.1, 0.2, 0.3, 0.4, 0.5)),
        (Search(lowest=0.1, highest=0.7, step=0.1), (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)),
        (Search(lowest=100, highest=850, ratio=2.0), (100.0, 200.0, 400.0, 800.0)),
        (Search(lowest=100, highest=299.9, step=100.0), (100.0, 200.0)),
    ],
)
def test_levels_reach_from_the_lowest_towards_the_highest(search: Search, levels: tuple[float, ...]) -> None:
    assert levels_of(search) == levels


def test_a_rule_is_that_of_its_condition_and_starts_at_the_nearest_level() -> None:
    own = Search(lowest=100.0, highest=500.0, ratio=1.3, rule="staircase", settings={"start": 200.0})
    one = protocol([1, 1])
    one = replace(one, condition=(one.condition[0], replace(one.condition[1], search=own)))
    usual = rule_of(one, SearchRun(number=1, condition="c0", damping=0.0, seed=3))
    other = rule_of(one, SearchRun(number=2, condition="c1", damping=0.0, seed=3))
    assert usual.next([]).level == 300.0
    assert other.next([]).level == pytest.approx(219.7)


def test_catch_trials_come_where_the_seed_of_the_run_puts_them() -> None:
    one = replace(protocol([1]), search=replace(SEARCH, rule="staircase", catch_share=0.5))

    def catches(seed: int) -> list[bool]:
        rule, answers = asking_of(one, SearchRun(number=1, condition="c0", damping=0.0, seed=seed)), []
        while len(answers) < 20 and (probe := rule.next(answers)) is not None:
            answers.append(JudgedProbe(probe, stable=probe.level < 250.0))
        return [answer.probe.catch for answer in answers]

    assert catches(1) == catches(1)
    assert catches(1) != catches(2)
