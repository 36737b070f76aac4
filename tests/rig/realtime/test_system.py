"""System calls of the compiled loop on real descriptors (pipes, sockets, pseudo-terminals), and its clocks."""

import contextlib
import errno
import os
import pty
import signal
import socket
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.realtime.clock import MonotonicClock, VirtualClock
from rig.realtime.system import (
    descriptor_read,
    descriptor_sync,
    descriptor_wait,
    descriptor_write,
    monotonic_now,
    sleep_until,
)

MILLISECOND = 1_000_000


def pipe() -> Any:
    reader, writer = os.pipe()
    return reader, writer


def sockets() -> Any:
    ends = socket.socketpair()
    return tuple(end.detach() for end in ends)


def pseudo_terminal() -> Any:
    master, slave = pty.openpty()
    tty.setraw(slave)
    return slave, master


@pytest.fixture(params=[pipe, sockets, pseudo_terminal], ids=lambda make: make.__name__)
def ends(request: pytest.FixtureRequest) -> Iterator[Any]:
    """Yield descriptors (ours, theirs), both non-blocking: the far end writes, the test reads."""
    ours, theirs = request.param()
    for descriptor in (ours, theirs):
        os.set_blocking(descriptor, False)
    yield ours, theirs
    for descriptor in (ours, theirs):
        with contextlib.suppress(OSError):
            os.close(descriptor)


def read(descriptor: int, size: int = 64) -> bytes | int:
    buffer = np.zeros(size, np.uint8)
    got = descriptor_read(descriptor, buffer.ctypes.data, size)
    return got if got <= 0 else buffer[:got].tobytes()


def write(descriptor: int, data: bytes) -> int:
    buffer = np.frombuffer(data, np.uint8).copy()
    return descriptor_write(descriptor, buffer.ctypes.data, len(buffer))


def soon() -> int:
    return monotonic_now(0) + 2000 * MILLISECOND


def test_an_empty_line_is_not_an_error(ends: Any) -> None:
    """Zero means that no byte is available although the far end is open; the loop continues."""
    ours, _ = ends
    assert read(ours) == 0
    assert descriptor_wait(ours, monotonic_now(0)) == 0


def test_no_more_is_read_than_there_is_room_for(ends: Any) -> None:
    ours, theirs = ends
    os.write(theirs, b"\x00\xff\nd\x03f")
    assert descriptor_wait(ours, soon()) == 1
    assert read(ours, 4) == b"\x00\xff\nd"
    assert read(ours, 4) == b"\x03f"
    assert read(ours, 4) == 0


def test_a_wait_ends_at_its_deadline_and_not_before(ends: Any) -> None:
    ours, _ = ends
    deadline = monotonic_now(0) + 5 * MILLISECOND
    assert descriptor_wait(ours, deadline) == 0
    assert monotonic_now(0) >= deadline


def test_a_deadline_in_the_past_still_sees_what_is_there(ends: Any) -> None:
    ours, theirs = ends
    assert descriptor_wait(ours, monotonic_now(0) - MILLISECOND) == 0
    os.write(theirs, b"x")
    assert descriptor_wait(ours, soon()) == 1
    assert descriptor_wait(ours, monotonic_now(0) - MILLISECOND) == 1


def test_bytes_wake_a_wait_that_holds_no_gil(ends: Any) -> None:
    ours, theirs = ends
    answers = []
    thread = threading.Thread(target=lambda: answers.append(descriptor_wait(ours, soon())), daemon=True)
    thread.start()
    os.write(theirs, b"x")  # could not run if the waiting thread kept the GIL
    thread.join(10.0)
    assert answers == [1]


@pytest.mark.parametrize("make", [pipe, sockets], ids=lambda make: make.__name__)
def test_bytes_sent_before_a_hang_up_are_still_read(make: Any) -> None:
    """A terminal is the exception: it discards its queue when its master closes."""
    ours, theirs = make()
    os.write(theirs, b"last words")
    os.close(theirs)
    try:
        assert descriptor_wait(ours, soon()) == 1
        assert read(ours) == b"last words"
        assert read(ours) == -errno.ENODEV
    finally:
        os.close(ours)


def test_a_hang_up_ends_a_wait_at_once_and_for_ever(ends: Any) -> None:
    """An unplugged device must not cost the loop a timeout, nor look like an idle line."""
    ours, theirs = ends
    os.close(theirs)
    for _ in range(3):
        answer = descriptor_wait(ours, monotonic_now(0) + 60_000 * MILLISECOND)
        assert answer == -errno.EIO or (answer == 1 and read(ours) in (-errno.ENODEV, -errno.EIO))


def test_a_closed_descriptor_is_an_error_not_silence(ends: Any) -> None:
    ours, _ = ends
    os.close(ours)
    assert descriptor_wait(ours, soon()) == -errno.EIO
    assert read(ours) == -errno.EBADF
    assert write(ours, b"x") == -errno.EBADF


@pytest.mark.parametrize("make", [sockets, pseudo_terminal], ids=lambda make: make.__name__)
def test_a_full_line_takes_what_fits_and_never_blocks(make: Any) -> None:
    ours, theirs = make()
    os.set_blocking(ours, False)
    try:
        chunk, taken, last = b"x" * 4096, 0, 1
        while last > 0:
            last = write(ours, chunk)
            taken += max(last, 0)
            assert taken < 1 << 26
        assert last == 0
        assert taken > 0
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize("make", [pipe, sockets, pseudo_terminal], ids=lambda make: make.__name__)
def test_writing_to_a_closed_line_is_an_error(make: Any) -> None:
    ours, theirs = make()
    if make is pseudo_terminal:  # only its master can hang up
        ours, theirs = theirs, ours
    os.close(ours)
    try:
        assert write(theirs, b"x") == (-errno.EIO if make is pseudo_terminal else -errno.EPIPE)
    finally:
        os.close(theirs)


def test_a_signal_shortens_neither_a_sleep_nor_a_wait() -> None:
    """Ctrl-C or a profiler's timer interrupts the system calls, which must resume for the remaining time."""
    ours, theirs = pipe()
    caught = []
    previous = signal.signal(signal.SIGALRM, lambda *_: caught.append(time.monotonic_ns()))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.002, 0.002)
        deadline = monotonic_now(0) + 20 * MILLISECOND
        sleep_until(deadline)
        assert monotonic_now(0) >= deadline
        deadline += 20 * MILLISECOND
        assert descriptor_wait(ours, deadline) == 0
        assert monotonic_now(0) >= deadline
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
        os.close(ours)
        os.close(theirs)
    assert caught


def test_a_sync_that_fails_is_an_error_except_where_nothing_can_be_synced(tmp_path: Path) -> None:
    with open(tmp_path / "file", "wb") as file, open("/dev/full", "wb") as device:
        assert descriptor_sync(file.fileno()) == descriptor_sync(device.fileno()) == 0
    assert descriptor_sync(-1) == errno.EBADF


def test_virtual_time_moves_only_by_a_sleep_of_its_clock_and_never_backwards() -> None:
    clock, other = VirtualClock(5), VirtualClock()
    assert clock.now_ns() == clock.now_ns() == clock.now_plug(clock.handle) == 5
    clock.sleep_until(60_000_000_000)  # a minute costs nothing
    clock.sleep_until(40)
    assert clock.now_ns() == clock.now_plug(clock.handle) == 60_000_000_000
    assert other.now_plug(other.handle) == 0


def test_monotonic_time_never_wakes_before_the_deadline() -> None:
    clock = MonotonicClock()
    deadline = clock.now_ns() + 3_000_000
    clock.sleep_until(deadline)
    assert clock.now_ns() >= deadline


def test_compiled_and_python_read_one_and_the_same_monotonic_clock() -> None:
    """Stamps of both are recorded together and compared, so they must interleave."""
    clock = MonotonicClock()
    stamps = []
    for _ in range(50):
        stamps += [time.monotonic_ns(), clock.now_plug(clock.handle), clock.now_ns()]
    assert stamps == sorted(stamps)
