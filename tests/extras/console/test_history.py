"""The history of a scope keeps every spike at any zoom, in bounded memory."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.sample import ROW
from rig.extras.console.history import BUCKET, History

COLUMNS = ("position", "tick")


def rows_of(count: int, first: int = 0) -> np.ndarray:
    rows = np.zeros(count, ROW)
    number = first + np.arange(count)
    rows["tick"] = number
    rows["device_time"] = 7_000_000 + 50_000 * number
    rows["position"] = np.random.default_rng(first).normal(size=count)
    return rows


def filled(pieces: list[int], raw_rows: int, buckets: int) -> tuple[History, np.ndarray]:
    history, added = History(raw_rows, buckets), np.zeros(0, ROW)
    for count in pieces:
        rows = rows_of(count, len(added))
        history.add(rows)
        added = np.concatenate((added, rows))
    return history, added


@settings(max_examples=30, deadline=None)
@given(
    pieces=st.lists(st.integers(0, 700), min_size=1, max_size=8),
    first=st.integers(-50, 3000),
    length=st.integers(0, 3000),
    step=st.integers(1, 200),
)
def test_a_cut_is_the_least_and_greatest_of_the_rows_that_it_names(
    pieces: list[int], first: int, length: int, step: int
) -> None:
    history, added = filled(pieces, raw_rows=512, buckets=64)
    cut = history.cut(COLUMNS, first, first + length, step)
    assert cut.step >= step
    assert history.rows == len(added)
    assert cut.low.shape == cut.high.shape == (len(COLUMNS), len(cut.times))
    for point, seconds in enumerate(cut.times):
        begin = cut.first + point * cut.step
        meant = added[begin : begin + cut.step]
        assert len(meant) == cut.step, "whole points only"
        assert first <= begin < first + length or cut.step != step
        assert seconds == (meant["device_time"][0] - added["device_time"][0]) * 1e-9
        for place, name in enumerate(COLUMNS):
            assert cut.low[place, point] == meant[name].min()
            assert cut.high[place, point] == meant[name].max()


def test_old_rows_are_available_by_bucket() -> None:
    history, added = filled([300] * 10, raw_rows=512, buckets=256)
    cut = history.cut(COLUMNS, 0, 3000, 1)
    assert cut.step == BUCKET
    assert (cut.first, len(cut.times)) == (0, 3000 // BUCKET)
    fresh = history.cut(COLUMNS, history.oldest_row, 3000, 1)
    assert (fresh.step, len(fresh.times)) == (1, 512)
    assert (fresh.low[1] == added["tick"][-512:]).all()


def test_memory_does_not_grow_and_a_new_loop_begins_anew() -> None:
    history, _ = filled([5000] * 5, raw_rows=512, buckets=64)
    assert history.cut(COLUMNS, 0, 25_000, 1).first >= 25_000 // BUCKET * BUCKET - 64 * BUCKET
    history.clear()
    assert history.rows == 0
    assert len(history.cut(COLUMNS, 0, 100, 1).times) == 0
    history.add(rows_of(64, 900))
    assert history.cut(COLUMNS, 0, 100, 1).times[0] == 0.0


def test_rows_are_found_by_their_time() -> None:
    history, _ = filled([1000], raw_rows=2048, buckets=64)
    assert history.row_at(0.0) == 0
    assert history.row_at(1e9) == 1000
    assert abs(history.row_at(500 * 50e-6) - 500) <= BUCKET
