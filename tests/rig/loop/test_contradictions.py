"""Contradictory messages of a device end the run, with the law on the host and on the device."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input
from rig.loop._contradictions import WRAP, Contradiction, ahead, clock_error, find_clock_contradiction
from rig.loop.layout import EndReason
from tests.conformance.batch_device import BatchDevice
from tests.rig.loop import test_loop, test_supervise
from tests.rig.loop.test_loop import PERIOD_NS, Receiver, Script, settings, state_frame

UNITS = 16_000  # of the device's clock in a period
FROM = 10


ANEW = {
    "sample_index": lambda k: (k - 500) % WRAP,
    **dict.fromkeys(("device_time", "edge_time"), lambda k: (k - 500) * UNITS % WRAP),
}
LIES: dict[str, tuple[Contradiction, dict[str, Any]]] = {
    "time, a second ahead": (Contradiction.CLOCK, {"device_time": lambda k: (k + 1_000) * UNITS}),
    "time, a second back": (Contradiction.CLOCK, {"device_time": lambda k: (k - 1_000) * UNITS % WRAP}),
    "time, three periods ahead": (Contradiction.CLOCK, {"device_time": lambda k: (k + 3) * UNITS}),
    "time, frozen": (
        Contradiction.CLOCK,
        dict.fromkeys(("device_time", "edge_time"), lambda k: FROM * UNITS),
    ),
    "time, twice as fast": (Contradiction.CLOCK, {"device_time": lambda k: (2 * k - FROM) * UNITS}),
    "index, frozen": (Contradiction.CLOCK, {"sample_index": lambda k: FROM}),
    "index, ahead": (Contradiction.CLOCK, {"sample_index": lambda k: k + 1_000}),
    "index and time, anew": (Contradiction.RESTARTED, ANEW),
    "edge, after the sample": (Contradiction.EDGE, {"edge_time": lambda k: (k + 1) * UNITS}),
    "missed ticks, no sample missing": (Contradiction.MISSED, {"missed_ticks": lambda k: 1}),
    "command, not sent": (Contradiction.COMMAND, {"command_sequence": lambda k: k + 5}),
    "command, of long ago": (Contradiction.COMMAND, {"command_sequence": lambda k: (k - 200) % 65536}),
}


def lied(index: int, lie: dict[str, Any]) -> bytes:
    fields = {name: value(index) for name, value in lie.items()}
    age = {"command_age": 1} if "command_sequence" in fields else {}
    return state_frame(index, **age, **fields)


@pytest.mark.parametrize("name", LIES)
def test_with_the_law_on_the_host_a_contradiction_ends_the_run_and_is_named(name: str) -> None:
    expected, lie = LIES[name]
    frames = [(PERIOD_NS * k, lied(k, lie if k > FROM else {})) for k in range(1, 60)]
    link = Script(*frames)
    thread, end = test_loop.ran(link)
    restarted = expected is Contradiction.RESTARTED
    assert end.reason == (EndReason.DEVICE_RESTARTED if restarted else EndReason.DEVICE_CONTRADICTS)
    assert end.contradiction == expected.text
    assert FROM <= end.counters["ticks"] <= FROM + 3, "within a few samples"
    assert np.diff(thread.ring.rows[: end.counters["ticks"]]["device_time"]).max() <= 2 * PERIOD_NS
    test_loop.assert_ends_with_stops(link)


def test_a_pressed_emergency_stop_ends_the_run_without_a_latched_fault() -> None:
    pressed = int(Input.EMERGENCY_STOP)
    link = Script(*test_loop.ticks(1, 10), *test_loop.ticks(10, 30, inputs=pressed))
    thread, end = test_loop.ran(link)
    assert (end.reason, end.counters["ticks"]) == (EndReason.DEVICE_FAULT, 10)
    assert thread.fault == Fault.EMERGENCY_STOP


@pytest.mark.parametrize("name", ["time", "index and time", "inputs", "state"])
def test_with_the_law_on_the_device_a_contradiction_ends_the_run(name: str) -> None:
    device = BatchDevice(test_supervise.taps(400), [0] * 400)

    def lie() -> None:
        if name == "time":
            device.time_error = 1_000 * UNITS
        elif name == "index and time":
            device.index -= 200
            device.time_error = -200 * UNITS
        elif name == "inputs":
            device.inputs = int(Input.EMERGENCY_STOP)
        else:
            device.state = State.CONFIGURED

    device.at[100] = lie
    thread, end = test_supervise.ran(device)
    expected = {"time": EndReason.DEVICE_CONTRADICTS, "index and time": EndReason.DEVICE_RESTARTED}.get(
        name, EndReason.DEVICE_FAULT
    )
    assert end.reason == expected
    rows = test_supervise.rows_of(thread)
    assert 90 <= len(rows) <= 110
    assert np.diff(rows["device_time"]).max() <= 2 * PERIOD_NS
    test_supervise.assert_ends_with_stops(device)


def test_a_jump_back_of_the_clock_in_a_fault_is_no_wrap() -> None:
    receiver = Receiver()
    receiver.feed(state_frame(1_000))
    before = int(receiver.buffers.progress[0]["device_time"])
    assert receiver.feed(state_frame(1_001, device_time=0, fault=int(Fault.ENCODER))) == 1
    assert int(receiver.buffers.progress[0]["device_time"]) == before - 1_000 * UNITS


@given(
    st.lists(
        st.tuples(st.integers(1, 40), st.floats(-0.9, 0.9, allow_subnormal=False)), min_size=1, max_size=60
    ),
    st.floats(-0.009, 0.009, allow_subnormal=False),
)
def test_a_late_tick_and_an_inexact_timer_are_no_contradiction(steps: Any, drift: float) -> None:
    """Samples are up to 0.9 periods from their place, on a grid that is up to 0.9 % off."""
    values, index, before, error = settings().as_array(), 0, 0, 0
    for samples, off in steps:
        index += samples
        time = round((index * (1.0 + drift) + off) * UNITS)
        error = int(clock_error(values, error, samples, time - before))
        before = time
        assert find_clock_contradiction(values, samples, error) == Contradiction.NONE


@given(st.integers(0, 1 << 40), st.integers(-(WRAP // 2), WRAP // 2 - 1))
def test_ahead_counts_modulo_32_bits(old: int, by: int) -> None:
    assert ahead((old + by) % WRAP, old) == by
