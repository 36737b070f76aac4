"""The C and the Python check of currents have the same settings, and the same memory after each tick."""

import ctypes
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import current
from rig.control.current import CURRENT, DISAGREES, SLOTS, WORDS
from rig.core.current_sensor import CurrentSensor
from rig.realtime import c_board as board
from tests.firmware.build import CORE, FIRMWARE, UNDEFINED, compile_c
from tests.firmware.law.law_library import i8, i16, i32, structure, u8, u16, u32

CONFIGURE = """
#include "current.h"

void configure(struct current_check *check, const struct current_sensor *sensor, int sign, uint32_t rate);
void configure(struct current_check *check, const struct current_sensor *sensor, int sign, uint32_t rate)
{
    const struct board board = {.encoder_sign = (int8_t)sign, .current_sensor = *sensor};
    current_configure(check, &board, rate);
}
"""


Check = structure(  # the struct current_check of current.h, with its delay line as separate fields
    "Check",
    (u16, "ticks passed awaited"),
    (u32, "noise decay quick_decay slow_decay back_emf difference largest sum last_largest"),
    (i32, "expected quick_low slow_low quick_high slow_high zero largest_zero"),
    (u32, "speed_decay late"),
    (i32, "count speed moved left before smooth quick_low_left slow_low_left quick_high_left slow_high_left"),
    (i8, "sign"),
    (u8, "known"),
    (u16, "delayed stride first middle last newest filled"),
    (i16 * SLOTS, "lowest highest"),
)


@pytest.fixture(scope="module")
def rule(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    directory: Path = tmp_path_factory.mktemp("current")
    source = directory / "configure.c"
    source.write_text(CONFIGURE)
    parts = [path for path in CORE if path.name in ("current.c", "delay_line.c", "wide.c")]
    flags = ["-fPIC", "-shared", f"-I{FIRMWARE / 'core'}", f"-I{FIRMWARE}", *UNDEFINED]
    library = ctypes.CDLL(str(compile_c(directory / "current.so", [source, *parts], flags)))
    library.configure.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_uint32]
    library.current_disagrees.argtypes = [ctypes.c_void_p, ctypes.c_int32, ctypes.c_int16, ctypes.c_int16]
    library.current_disagrees.restype = ctypes.c_bool
    return library


currents = st.integers(-32_767, 32_767)


LINE = ("lowest", "highest")
HOST = {*LINE, "most", "last_most", "dead"}  # used for an agreement, which the device does not report


@given(
    st.sampled_from([50, 99, 1_000, 7_777, 20_000, 50_000]),
    st.sampled_from([-1.0, 0.0, 0.41, 30.0]),
    st.sampled_from([0.0, 1e-5, 1.09e-4, 1e-2]),
    st.sampled_from([0.0, 3e-5, 2.5e-4, 9.9e-3]),
    st.sampled_from([0.0, 1e-4, 0.017, 3.0, 1e6]),
    st.sampled_from([1, -1]),
    st.lists(
        st.tuples(st.integers(-(2**31), 2**31 - 1) | st.integers(-99, 99), currents, currents), min_size=1
    ),
    st.integers(1, 15),
)
def test_c_and_python_have_the_same_memory(
    rule: Any,
    rate: int,
    noise: float,
    lag_s: float,
    delay_s: float,
    back_emf: float,
    sign: int,
    motions: list[tuple[int, int, int]],
    each: int,
) -> None:
    words = memoryview(np.zeros(WORDS, np.int64))
    check = Check()
    sensor = CurrentSensor(noise=noise, lag_s=lag_s, delay_s=delay_s, back_emf=back_emf)
    current.configure(words, sensor, rate, sign)
    rule.configure(ctypes.byref(check), ctypes.byref(board.CurrentSensor(**asdict(sensor))), sign, rate)
    for count, active, measured in motions:
        for tick in range(each):
            here = max(-(2**31), count - 3 * tick)
            outcome = current.compare(words, here, active, measured)
            assert rule.current_disagrees(ctypes.byref(check), here, active, measured) == (
                outcome == DISAGREES
            )
            assert {name: getattr(check, name) for name in CURRENT._fields if name not in HOST} == {
                name: words[place] for name, place in CURRENT._asdict().items() if name not in HOST
            }
            for name in LINE:
                place = getattr(CURRENT, name)
                assert list(getattr(check, name)) == list(words[place : place + SLOTS])
