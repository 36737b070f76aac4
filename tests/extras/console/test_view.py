"""The frames of a scope: each point once, sweeps from their trigger on; every spike at any zoom, in bounded memory."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.core.sample import ROW, RowFlag
from rig.extras.console.history import BUCKET, History
from rig.extras.console.trigger import Trigger
from rig.extras.console.view import POINTS, View, ViewRequest
from tests.extras.console.console_fakes import frame_of

RATE = 1000.0


def unpacked(frame: bytes) -> dict[str, Any]:
    header, low, high, _ = frame_of(frame)
    return {**header, "low": low, "high": high}


class Ramp:
    """A history with a ramp that enters the wall at each thousandth row for 100 rows."""

    def __init__(self) -> None:
        self.history = History(1 << 14, 1 << 10)

    def add(self, count: int) -> None:
        rows = np.zeros(count, ROW)
        number = self.history.rows + np.arange(count)
        rows["tick"], rows["device_time"] = number, 1_000_000 * number
        rows["position"] = number % 1000
        rows["flags"] = np.where(number % 1000 < 100, int(RowFlag.INSIDE), 0)
        self.history.add(rows)


@settings(max_examples=20, deadline=None)
@given(
    pieces=st.lists(st.integers(0, 500), min_size=1, max_size=12),
    window_s=st.sampled_from([0.01, 0.5, 2.0, 5.0, 10.0]),
    slow=st.integers(1, 4),
)
def test_each_point_is_sent_once_to_a_slow_page(pieces: list[int], window_s: float, slow: int) -> None:
    ramp = Ramp()
    view = View(ramp.history, RATE, ViewRequest(columns=("tick",), window_s=window_s))
    seen: list[float] = []
    for number, count in enumerate(pieces):
        ramp.add(count)
        if number % slow == 0:
            for frame in map(unpacked, view.frames()):
                step = frame["step"]
                assert step == max(1, round(window_s * RATE) // POINTS)
                for first, last in zip(frame["low"]["tick"], frame["high"]["tick"], strict=True):
                    seen += np.arange(first, last + 1).tolist()
    assert seen == list(range(len(seen)))


def test_another_window_begins_with_what_is_there() -> None:
    ramp = Ramp()
    ramp.add(5000)
    (frame,) = map(unpacked, View(ramp.history, RATE, ViewRequest(columns=("tick",), window_s=2.0)).frames())
    assert frame["fresh"]
    assert (frame["low"]["tick"][0], frame["high"]["tick"][-1]) == (3000, 4999)


@pytest.mark.parametrize(
    ("trigger", "at"),
    [
        (Trigger(), 1000),
        (Trigger(edge="falling"), 100),
        (Trigger(on="position", level=499.5), 500),
        (Trigger(on="position", level=499.5, edge="falling"), 1000),
    ],
)
def test_a_sweep_begins_where_its_trigger_says(trigger: Trigger, at: int) -> None:
    ramp = Ramp()
    ramp.add(50)
    view = View(ramp.history, RATE, ViewRequest(columns=("tick", "position"), window_s=0.2, trigger=trigger))
    sweeps = []
    for _ in range(40):  # in pieces that no sweep fits
        ramp.add(70)
        sweeps += [unpacked(frame) for frame in view.frames()]
    before = round(trigger.before * 200)
    assert len(sweeps) == 2 or len(sweeps) == 3
    for number, sweep in enumerate(sweeps):
        crossing = at + 1000 * number
        assert sweep["at"] == pytest.approx(crossing / RATE, abs=1e-12)
        assert (sweep["low"]["tick"] == np.arange(crossing - before, crossing - before + 200)).all()


def test_a_single_sweep_is_the_only_one() -> None:
    ramp = Ramp()
    ramp.add(150)
    view = View(ramp.history, RATE, ViewRequest(window_s=0.1, trigger=Trigger(single=True)))
    sweeps = []
    for _ in range(30):
        ramp.add(200)
        sweeps += list(view.frames())
    assert len(sweeps) == 1


@pytest.mark.parametrize(
    ("shown", "named"),
    [
        ({"columns": ("nothing",)}, "'nothing'"),
        ({"columns": ()}, "0 columns"),
        ({"columns": ("position",) * 13}, "13 columns"),
        ({"window_s": 0.001}, "0.001 s"),
        ({"window_s": 61.0}, "61 s"),
        ({"trigger": Trigger(on="nothing")}, "'nothing'"),
        ({"trigger": Trigger(before=1.5)}, "1.5"),
    ],
)
def test_an_impossible_view_is_refused_with_its_value(shown: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError, match=named) as error:
        ViewRequest(**shown)
    assert error.value.remedy


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
