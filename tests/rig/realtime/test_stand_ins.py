"""Python functions under the names of the C library: results as compiled code reads them. Calls by compiled code:
tests/platforms.
"""

import ctypes
import errno
import os
import time
from pathlib import Path

import numpy as np
import pytest

from rig.realtime import _stand_ins as stand_ins
from rig.realtime.system import EAGAIN

BILLION = 1_000_000_000


def last_error() -> int:
    return ctypes.c_int32.from_address(stand_ins._errno_location()).value


def test_written_bytes_arrive_and_a_failure_sets_errno(tmp_path: Path) -> None:
    data = np.frombuffer(b"one\ntwo\r\n", np.uint8).copy()
    with open(tmp_path / "file", "wb") as file:
        assert stand_ins._write(file.fileno(), data.ctypes.data, len(data)) == len(data)
        assert stand_ins._sync(file.fileno()) == 0
        closed = file.fileno()
    assert (tmp_path / "file").read_bytes() == data.tobytes()
    assert stand_ins._write(-1, data.ctypes.data, 1) == -1
    assert last_error() == errno.EBADF
    assert stand_ins._sync(closed) == -1
    with open("/dev/full", "wb") as full:
        assert stand_ins._write(full.fileno(), data.ctypes.data, 1) == -1
    assert last_error() == errno.ENOSPC


def test_full_line_reports_the_errno_of_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise BlockingIOError(errno.EAGAIN, "full")

    with monkeypatch.context() as patched:
        patched.setattr(errno, "EAGAIN", 35)  # of macOS
        patched.setattr(os, "write", full)
        assert stand_ins._write(1, 0, 0) == -1
    assert last_error() == EAGAIN == 11


def test_time_is_that_of_the_links_clock_and_a_sleep_ends_at_its_deadline() -> None:
    timespec = np.zeros(2, np.int64)
    before = time.perf_counter_ns()
    assert stand_ins._now(1, timespec.ctypes.data) == 0
    now = int(timespec[0] * BILLION + timespec[1])
    assert before <= now <= time.perf_counter_ns()
    timespec[:] = divmod(now + 3_000_000, BILLION)
    assert stand_ins._sleep(1, 1, timespec.ctypes.data, 0) == 0
    assert time.perf_counter_ns() >= now + 3_000_000


def test_every_name_of_the_compiled_loop_has_one() -> None:
    from rig.realtime import system  # noqa: PLC0415

    assert set(system._NAMES) == set(stand_ins._CALLS)
