"""The frames of a scope: each point once, sweeps from their trigger on, and only requested columns."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.core.sample import ROW, RowFlag
from rig.extras.console.history import History
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
def test_each_point_is_sent_once_however_seldom_a_page_reads(
    pieces: list[int], window_s: float, slow: int
) -> None:
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
