"""Clocks in real and in virtual time: the same functions from Python and from compiled code."""

import time

from rig.realtime.clock import MonotonicClock, VirtualClock


def test_virtual_time_moves_only_by_a_sleep_and_never_backwards() -> None:
    clock = VirtualClock(5)
    assert clock.now_ns() == clock.now_ns() == 5
    clock.sleep_until(60_000_000_000)  # a minute costs nothing
    clock.sleep_until(40)
    assert clock.now_ns() == 60_000_000_000


def test_compiled_code_reads_the_same_virtual_time() -> None:
    clock = VirtualClock(7)
    assert clock.now_plug(clock.handle) == 7
    clock.sleep_until(1 << 40)
    assert clock.now_plug(clock.handle) == clock.now_ns() == 1 << 40


def test_two_virtual_clocks_do_not_share_their_time() -> None:
    one, two = VirtualClock(), VirtualClock()
    one.sleep_until(9)
    assert two.now_plug(two.handle) == 0


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
