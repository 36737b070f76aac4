"""A simulated hand shared through a file: each side reads a request or a motion completely, or not at all."""

import math
import os
import stat
from itertools import repeat
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.devices.device import DeviceUrl
from rig.devices.local import serve_locally
from rig.realtime.hand import MAGIC, MOTIONS, SIZE, WISH_END, HandMotion, SharedHand, Wish
from sim_backend.ends.link import open_link
from tests.conformance.damaged import each_damaged
from tests.conformance.rigs import rotary_rig

FLOATS = st.floats(allow_nan=False, allow_infinity=False)


@given(wishes=st.lists(st.tuples(FLOATS, FLOATS), max_size=5))
def test_reader_gets_the_newest_wish(
    wishes: list[tuple[float, float]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("hand") / "hand"
    with SharedHand.create(path) as mover, SharedHand.open(path) as looker:
        assert looker.read() == Wish(0, 0.0, 0.0)
        for number, (position, press) in enumerate(wishes, 1):
            mover.move(position, press)
            assert looker.read() == Wish(number, position, press)


def test_second_writer_continues_the_numbers_of_the_first(tmp_path: Path) -> None:
    path = tmp_path / "hand"
    with SharedHand.create(path) as first:
        first.move(0.1, 2.0)
    with SharedHand.open(path) as looker, SharedHand.create(path) as second:
        second.move(0.2, 3.0)
        assert looker.read() == Wish(2, 0.2, 3.0)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_torn_wish_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "hand"
    with SharedHand.create(path) as mover, SharedHand.open(path) as looker:
        mover.move(0.1, 2.0)
        for _ in each_damaged(path, range(len(MAGIC), WISH_END), repeat(0x55)):
            assert looker.read() is None
        assert looker.read() == Wish(1, 0.1, 2.0)


@pytest.mark.parametrize("wish", [(math.nan, 0.0), (0.0, math.inf)])
def test_wish_that_is_not_finite_is_refused(wish: Any, tmp_path: Path) -> None:
    with SharedHand.create(tmp_path / "hand") as mover:
        with pytest.raises(ConfigError, match="finite"):
            mover.move(*wish)
        assert mover.read() == Wish(0, 0.0, 0.0)


def test_file_of_another_kind_is_not_overwritten(tmp_path: Path) -> None:
    other = tmp_path / "notes.txt"
    other.write_text("x" * SIZE)
    os.mkfifo(tmp_path / "pipe")
    for use in (SharedHand.create, SharedHand.open):
        with pytest.raises(ConfigError, match=r"notes\.txt is another kind of file"):
            use(other)
        for odd in (tmp_path, tmp_path / "pipe"):
            with pytest.raises(ConfigError, match=r"is another kind of file|directory"):
                use(odd)
    with pytest.raises(ConfigError, match="cannot open this file"):
        SharedHand.open(tmp_path / "missing")
    with pytest.raises(ConfigError, match="cannot create this file"):
        SharedHand.create(tmp_path / "missing" / "hand")
    assert other.read_text() == "x" * SIZE


def test_driven_hand_without_real_time_or_operator_is_refused(tmp_path: Path) -> None:
    SharedHand.create(tmp_path / "hand").close()
    url = f"sim://?hand={tmp_path / 'hand'}"
    with pytest.raises(ConfigError, match="a hand cannot be driven in virtual time"):
        open_link(DeviceUrl.parse(url), rotary_rig())
    with pytest.raises(ConfigError, match="the experiment has no hand"), serve_locally(url, rotary_rig()):
        pass
    with pytest.raises(ConfigError, match="cannot open this file"), serve_locally(f"{url}less", rotary_rig()):
        pass


def moved(number: int) -> HandMotion:
    return HandMotion(device_time_ns=number, hand=0.1 * number, handle=0.05 * number, velocity=-1.0)


def test_motions_are_read_once_and_in_order(tmp_path: Path) -> None:
    with SharedHand.create(tmp_path / "hand") as mover, SharedHand.open(tmp_path / "hand") as device:
        assert mover.motions() == []
        for number in range(3):
            device.tell(moved(number))
        assert mover.motions() == [moved(0), moved(1), moved(2)]
        assert mover.motions() == []
        for number in range(2 * MOTIONS + 5):  # a late reader gets the newest
            device.tell(moved(number))
        assert mover.motions() == [moved(number) for number in range(MOTIONS + 5, 2 * MOTIONS + 5)]


def test_motions_continue_with_another_device(tmp_path: Path) -> None:
    with SharedHand.create(tmp_path / "hand") as mover:
        for number in range(2):
            with SharedHand.open(tmp_path / "hand") as device:
                device.tell(moved(number))
            assert mover.motions() == [moved(number)]


def test_a_torn_motion_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "hand"
    with SharedHand.create(path) as mover, SharedHand.open(path) as device:
        device.tell(moved(7))
        whole = path.read_bytes()
        for _ in each_damaged(path, [place for place in range(WISH_END, SIZE) if whole[place]], repeat(0x55)):
            assert mover.motions() == []
        assert mover.motions() == [moved(7)]
