"""The simulated device in readable Python: its protocol, physics and safety monitors."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.packing import unpack_fault_entries
from firmware_protocol.parameter import Value
from firmware_protocol.parameters import DEFAULTS
from rig.core.model import RigModel
from rig.core.sample import TRUTH
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.safety import (
    AT,
    IDLE_LIFETIME_S,
    LARGEST_SHARE,
    RING_TICKS,
    Safety,
    check,
    compute_wanted,
    feed,
    flat,
    large_effort,
    stall_time,
    warm,
)
from sim_backend.ends.link import MemoryLink
from sim_backend.mechanics.plant import DiscretePlant, advance
from tests.conformance.device import check_device
from tests.conformance.host import RUN_PARAMETERS, Host
from tests.conformance.rigs import linear_rig, rotary_rig
from tests.conformance.tiers import first_by_default

RATE = 2_000
TICK_S = 1.0 / RATE


def host_of(model: RigModel | None = None, **device: object) -> Host:
    return Host(MemoryLink(SimulatedDevice(model or rotary_rig(), **device)))  # type: ignore[arg-type]


def device_of(host: Host) -> SimulatedDevice:
    assert isinstance(host.link, MemoryLink)
    return host.link.device


def armed(model: RigModel | None = None, **values: Value) -> Host:
    host = host_of(model)
    host.begin(**{"position_rate": RATE, **values})
    return host


def exchange(host: Host, current: int, ticks: int = 1, **command: int) -> m.State:
    """Command a current for some ticks, one COMMAND for each STATE, and return the last STATE."""
    for _ in range(ticks):
        host.command(current, **command)
        state = host.next_state()
    return state


def silence(host: Host, ticks: int) -> list[m.State]:
    """Return the STATEs of some ticks in which the host sends no COMMAND."""
    host.states.clear()
    while len(host.states) < ticks:
        list(host.events(0.1))
    return list(host.states)


def log_of(host: Host) -> tuple[m.FaultLog, list[m.FaultEntry]]:
    entries: list[m.FaultEntry] = []
    while True:
        page: m.FaultLog = host.ask(m.GetFaultLog(host.nonce(), len(entries)))
        entries += unpack_fault_entries(page.data)
        if len(entries) == page.total:
            return page, entries


# ---------------------------------------------------------------------- the protocol


@pytest.mark.parametrize("model", [rotary_rig(), linear_rig()], ids=["rotary", "linear"])
def test_the_device_conforms(model: RigModel) -> None:
    check_device(lambda: MemoryLink(SimulatedDevice(model)))


def test_dictionary_contains_the_rig_and_its_limits() -> None:
    about = host_of(position_rate_default=4_000, position_rate_maximum=8_000, name="bench").identify()
    assert (about.device, about.simulated, about.current_quantum_a) == ("bench", True, 0.001)
    assert (about.position_rate_default, about.position_rate_maximum) == (4_000, 8_000)
    limit = about.parameter("current_limit")
    assert limit is not None
    assert limit.maximum == 10_000  # effort limit 1 N·m at 0.1 N·m/A and 1 mA


def test_device_sends_state_at_100_hz_from_identify_until_armed() -> None:
    host = host_of()
    assert host.link.read(1.0) == b""
    host.identify()
    states = silence(host, 3)
    assert [b.sample_index - a.sample_index for a, b in pairwise(states)] == [10, 10]
    assert {state.current_commanded for state in states} == {0}


def test_the_sync_input_is_shown_with_the_time_at_which_it_rose() -> None:
    host = armed()
    device = device_of(host)
    assert host.next_state().sync_time == 0
    device.sync_input(True)
    rose = device.time
    for _ in range(3):
        device.sync_input(True)
        state = exchange(host, 0)
        assert (state.sync_time, state.inputs & Input.SYNC) == (rose, Input.SYNC)
    device.sync_input(False)
    state = exchange(host, 0)
    assert (state.sync_time, state.inputs & Input.SYNC) == (rose, 0)
    device.sync_input(True, at=device.time + 77)  # between two samples
    assert exchange(host, 0).sync_time == device.time + 77 - round(TICK_S * 16e6)


# ---------------------------------------------------------------------- time


@pytest.mark.parametrize("rate", [1_000, 777])
def test_a_tick_that_is_no_whole_number_of_units_does_not_drift(rate: int) -> None:
    device = SimulatedDevice(rotary_rig(), position_rate_default=rate)
    for _ in range(rate):
        device.tick()
    assert device.time == 16_000_000
    assert device.time_ns == device.elapsed_ns == 10**9


def test_a_new_rate_keeps_time_and_motion() -> None:
    model = rotary_rig(initial_position=0.01)
    host = host_of(model)
    device = device_of(host)
    host.identify()
    host.link.read(0.01)
    before, count = device.time_ns, silence(host, 1)[-1].count
    host.configure(position_rate=RATE)
    assert device.next_tick_ns - device.elapsed_ns == 500_000
    assert device.time_ns >= before
    assert silence(host, 1)[-1].count == count == round(0.01 / model.encoder.resolution)


@pytest.mark.exhaustive("tests/firmware/test_core.py::test_an_old_edge_never_looks_fresh")
def test_the_32_bit_edge_time_of_a_handle_at_rest_never_looks_fresh() -> None:
    host = host_of(position_rate_default=50)
    host.identify()
    host.link.elapse(300.0)  # beyond the 268 s after which device times repeat
    host.link.read(0.0)  # discard the STATEs in between
    state = host.next_state()
    assert (state.device_time - state.edge_time) & 0xFFFFFFFF == m.OLDEST_EDGE


# ---------------------------------------------------------------------- physics


def test_a_constant_current_accelerates_the_link_as_newton_says() -> None:
    """0.05 A give 5 mN·m on 1e-3 kg·m²: 5 rad/s², so after 0.1 s 0.5 rad/s and 25 mrad."""
    host = armed()
    state = exchange(host, 50, ticks=RATE // 10)
    truth = device_of(host).truth()
    assert truth["velocity_true"][-1] == pytest.approx(0.5)
    assert truth["position_true"][-1] == pytest.approx(0.025)
    assert state.count == math.floor(0.025 / rotary_rig().encoder.resolution + 0.5)
    edge_age = (state.device_time - state.edge_time) * 62.5e-9
    since_edge = 0.025 - (state.count - 0.5) * rotary_rig().encoder.resolution
    assert edge_age == pytest.approx(since_edge / 0.5, rel=2e-3)


def test_it_moves_as_the_plant_without_bytes_bit_for_bit() -> None:
    model = rotary_rig(
        damping=1e-3, coulomb=2e-3, lag_s=1e-4, computation_delay_ticks=2, initial_position=0.003
    )
    host = armed(model)
    plant = DiscretePlant.build(model, TICK_S)
    state = plant.at_rest(0.003)
    for _ in range(device_of(host).sample_index):
        advance(plant.arguments(state), 0.0, 0.0)
    currents = [round(400 * math.sin(0.1 * k)) for k in range(200)]
    counts = [exchange(host, current).count for current in currents]
    alone = [
        advance(plant.arguments(state), current * model.amplifier.effort_quantum, 0.0) for current in currents
    ]
    assert counts == alone
    assert device_of(host).truth()["position_true"][-1] == state[plant.sensed_position]


def test_truth_has_one_row_for_each_tick_of_a_session() -> None:
    host = armed()
    first = device_of(host).sample_index + 1
    exchange(host, 10, ticks=1_100)
    truth = device_of(host).truth()
    assert truth.dtype == TRUTH
    np.testing.assert_array_equal(truth["sample_index"], np.arange(first, first + 1_100))


def test_a_command_is_active_in_the_tick_after_the_state_that_it_answers() -> None:
    host = armed()
    host.next_state()
    state = exchange(host, 77)
    assert (state.current_commanded, state.command_age, state.command_sequence) == (77, 1, 0)
    later = silence(host, 2)[-1]
    assert (later.current_commanded, later.command_age) == (77, 3)


def test_the_measured_current_lags_and_is_noisy_alike_for_the_same_seed() -> None:
    def currents(seed: int) -> list[int]:
        host = host_of(rotary_rig(lag_s=1e-3, current_noise_a=0.005), seed=seed)
        host.begin(position_rate=RATE)
        return [exchange(host, 200).current_measured for _ in range(300)]

    run = currents(1)
    assert run == currents(1) != currents(2)
    assert run[0] < 100 < run[3]
    assert np.std(run[100:]) == pytest.approx(5.0, rel=0.2)


# ---------------------------------------------------------------------- limits


def test_the_current_limit_clips_and_says_so() -> None:
    host = armed(current_limit=40)
    state = exchange(host, -5_000)
    assert (state.current_commanded, state.limits) == (-40, LimitFlag.CURRENT)
    assert exchange(host, 40).limits == 0


def test_the_slew_limit_binds_in_both_directions_and_lets_stop_pass() -> None:
    host = armed(slew_limit=30)
    ramp = [exchange(host, 100) for _ in range(4)]
    assert [state.current_commanded for state in ramp] == [30, 60, 90, 100]
    assert [bool(state.limits & LimitFlag.SLEW) for state in ramp] == [True, True, True, False]
    assert exchange(host, -100).current_commanded == 70
    assert exchange(host, 0, mode=m.Mode.STOP).current_commanded == 0


def test_the_thermal_model_brings_the_current_down_to_what_the_motor_bears() -> None:
    """From cold, 400 reach the budget of 200² after t = −τ ln(1 − (200/400)²) = 0.288 τ."""
    model = rotary_rig(inertia=1.0)
    host = armed(model, continuous_current=200, thermal_time_constant=0.5)
    states = [exchange(host, 400) for _ in range(RATE // 2)]
    reduced = next(k for k, state in enumerate(states) if state.current_commanded == 200)
    assert reduced * TICK_S == pytest.approx(-0.5 * math.log(1 - 0.25), rel=0.01)
    assert states[reduced].limits & LimitFlag.THERMAL
    assert states[-1].fault == Fault.NONE
    assert np.mean([state.current_commanded for state in states[reduced:]]) == pytest.approx(200, rel=0.05)


# ---------------------------------------------------------------------- the watchdog


@pytest.mark.parametrize(
    ("lifetime_us", "rate"), [(100, 3_000), (3_333, 200), (3_333, 20_000), (20_000, 1_000)]
)
def test_silence_ends_in_exactly_zero_effort_within_lifetime_and_ramp(lifetime_us: int, rate: int) -> None:
    host = armed(position_rate=rate)
    exchange(host, 300, ticks=3)
    host.command(300, lifetime_us=lifetime_us)
    commanded_at = device_of(host).time
    states = silence(host, math.ceil(0.035 * rate) + 3)
    currents = [state.current_commanded for state in states]
    assert currents == sorted(currents, reverse=True)
    deadline = commanded_at + (lifetime_us + 10_000) * 16
    assert all(state.current_commanded == 0 for state in states if state.device_time >= deadline)
    assert (states[-1].state, states[-1].fault) == (State.FAULT, Fault.LINK_LOST)
    ramping = [state for state in states if state.current_commanded and state.limits & LimitFlag.RAMPING]
    for state in ramping:  # linear, judged at the end of the tick: never above the line
        line = 300 * (deadline - state.device_time) / 160_000
        assert line - 1 < state.current_commanded <= max(line, 0)


def test_the_lifetime_is_capped_by_the_parameter() -> None:
    host = armed(command_lifetime_us=2_000, ramp_us=0)
    host.next_state()
    exchange(host, 300, lifetime_us=2**32 - 1)
    states = silence(host, 10)
    assert [state.current_commanded for state in states[:4]] == [300, 300, 300, 0]
    assert states[3].fault == Fault.LINK_LOST


def test_limits_stay_active_in_the_ramp_which_begins_at_what_they_left() -> None:
    host = armed(current_limit=100, slew_limit=20)
    exchange(host, 500, ticks=2, lifetime_us=3_000)
    states = silence(host, 60)
    currents = [state.current_commanded for state in states]
    top = currents.index(max(currents))
    assert max(currents) == 100
    assert currents[top:] == sorted(currents[top:], reverse=True)
    assert currents[-1] == 0


@given(st.integers(-500, 500), st.integers(0, 400), st.integers(0, 400), st.integers(1, 50))
def test_the_ramp_never_rises_or_changes_sign(current: int, lifetime: int, ramp: int, step: int) -> None:
    rules = flat(np.int64, len(AT))
    feed(rules, 0, current, lifetime, ramp)
    sizes, rules[AT.current] = [], current
    for until in range(step, lifetime + ramp + 2 * step, step):
        flows = rules[AT.current] = compute_wanted(rules, until)
        sizes.append(abs(flows))
        assert flows * current >= 0
        assert until < lifetime + ramp or until <= lifetime or flows == 0
    assert sizes == sorted(sizes, reverse=True)
    assert rules[AT.lost]


@pytest.mark.parametrize("stopped", first_by_default([True, False]), ids=["after-stop", "after-arm"])
def test_host_timeout_is_longer_without_effort(stopped: bool) -> None:
    host = armed()
    if stopped:
        exchange(host, 200, ticks=5)
        assert exchange(host, 200, mode=m.Mode.STOP).current_commanded == 0
    states = silence(host, RATE)
    assert {state.current_commanded for state in states} == {0}
    lost = next(k for k, state in enumerate(states) if state.fault == Fault.LINK_LOST)
    assert lost * TICK_S == pytest.approx(IDLE_LIFETIME_S, abs=3 * TICK_S)


# ---------------------------------------------------------------------- faults


def test_a_fault_cuts_the_commands_on_their_way_through_the_computation_delay_too() -> None:
    host = armed(rotary_rig(computation_delay_ticks=10))
    exchange(host, 200, ticks=20)
    device_of(host).inject_fault(Fault.ENCODER)
    exchange(host, 200, ticks=2)
    assert device_of(host).truth()["effort_true"][-1] == 0.0


def test_the_first_fault_is_kept_and_later_ones_go_into_the_mask() -> None:
    host = armed()
    device = device_of(host)
    device.inject_fault(Fault.ENCODER)
    device.inject_fault(Fault.ENCODER)
    device.inject_fault(Fault.TICK_OVERRUN)
    assert host.next_state().fault == Fault.ENCODER
    page, _ = log_of(host)
    assert (page.fault, page.later) == (Fault.ENCODER, 1 << Fault.TICK_OVERRUN)


def test_the_fault_log_holds_the_ticks_before_the_fault_and_freezes() -> None:
    host = armed()
    states = [exchange(host, k % 50) for k in range(400)]
    device_of(host).inject_fault(Fault.ENCODER)
    exchange(host, 10, ticks=20)
    page, entries = log_of(host)
    assert len(entries) == RING_TICKS
    assert page.device_time == states[-1].device_time
    expected = [
        (s.sample_index, s.count, s.current_commanded, s.current_measured, s.limits)
        for s in states[-RING_TICKS:]
    ]
    got = [(e.sample_index, e.count, e.current_commanded, e.current_measured, e.limits) for e in entries]
    assert got == expected
    host.disarm(clear_fault=True)
    assert log_of(host)[0].fault == Fault.ENCODER  # still there for a host that cleared first


def test_over_speed_cuts_when_the_limit_is_passed_and_not_by_one_count() -> None:
    # 5 rad/s² reach 1000 counts/s (0.314 rad/s) after 62.8 ms. Over 5 ms that is 5 counts; the sixth, which either end
    # of the window may hide, takes 12.6 ms more, and the mean over the window lags by half of it.
    host = armed(speed_limit=1_000, current_limit=10_000)
    begun = host.next_state().device_time
    while not (state := exchange(host, 50)).fault:
        pass
    assert state.fault == Fault.OVER_SPEED
    assert 0.0628 < (state.device_time - begun) * 62.5e-9 < 0.0628 + 0.0126 + 0.0025 + 2 * TICK_S + 0.0126
    assert exchange(host, 50).current_commanded == 0


def test_a_toggling_count_is_no_speed() -> None:
    safety = safety_of(position_rate=20_000, speed_limit=10)
    assert all(judge(safety, k % 2, 0, 0) == 0 for k in range(1_000))
    assert safety.rules[AT.flags] == 0


def test_near_the_limits_the_state_warns() -> None:
    host = armed(window_minimum=-100, window_maximum=100, speed_limit=100_000)
    states = []
    while not (states and states[-1].fault):
        states.append(exchange(host, 50))
    warned = next(state.count for state in states if state.limits & LimitFlag.POSITION)
    assert 90 < warned <= 93
    assert states[-1].fault == Fault.POSITION_WINDOW
    assert states[-1].count > 100


def test_outside_the_window_it_does_not_arm() -> None:
    host = host_of(rotary_rig(initial_position=0.1))
    host.identify()
    ack = host.arm(1, host.configure(**{**RUN_PARAMETERS, "window_minimum": 0, "window_maximum": 10}).crc)
    assert (ack.status, ack.detail) == (Status.FAULT_PRESENT, Fault.POSITION_WINDOW)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_motor_that_runs_away_under_its_own_effort_is_called_a_runaway(sign: int) -> None:
    host = armed(rotary_rig(sign=sign), speed_limit=1_000)
    while not exchange(host, 200).fault:
        pass
    page, _ = log_of(host)
    assert page.fault == Fault.RUNAWAY
    assert page.later == 1 << Fault.OVER_SPEED


def test_speed_against_the_effort_is_over_speed_alone() -> None:
    host = armed(speed_limit=1_000)
    device_of(host).hardware.external_effort = 0.2
    while not exchange(host, -200).fault:
        pass
    assert log_of(host)[0].fault == Fault.OVER_SPEED


@pytest.mark.parametrize("toggles", [False, True], ids=["unplugged", "one channel"])
def test_a_dead_encoder_is_found_by_the_edges_that_do_not_come(toggles: bool) -> None:
    model = rotary_rig(inertia=1e-3, coulomb=5e-3)
    least = large_effort(model, 500) / LARGEST_SHARE  # friction of 50 quanta, and a twentieth of the limit
    assert least == 75
    safety = safety_of(model, current_limit=500, position_rate=RATE)
    ticks = next(k for k in range(RATE) if judge(safety, k % 2 * toggles, 76, 76))
    assert ticks * TICK_S == pytest.approx(stall_time(model, least), abs=2 * TICK_S)


def test_a_dead_encoder_is_found_however_much_of_the_limit_friction_takes() -> None:
    # Friction holds 200 of the 500 quanta: with the next twentieth and one more the rig must move.
    model = rotary_rig(inertia=1e-3, coulomb=0.02)
    safety = safety_of(model, current_limit=500, position_rate=RATE)
    assert not any(judge(safety, 0, 225, 225) for _ in range(RATE))
    ticks = next(k for k in range(RATE) if judge(safety, 0, 226, 226))
    assert ticks * TICK_S == pytest.approx(stall_time(model, 225), abs=2 * TICK_S)


def test_a_limit_that_friction_holds_makes_no_effort_large() -> None:
    assert large_effort(rotary_rig(coulomb=0.06), 500) == LARGEST_SHARE * 500
    assert large_effort(rotary_rig(coulomb=0.0), 500) == 125


def test_the_free_rig_shows_edges_long_before_it_is_called_stalled() -> None:
    # The worst start: the least effort that is monitored, friction against it, a whole cell to cross.
    model = rotary_rig(coulomb=5e-3, offset=0.0)
    host = armed(model, speed_limit=100_000)
    state = exchange(host, 76, ticks=math.ceil(stall_time(model, 75) / 3 * RATE))
    assert state.count >= 1
    state = exchange(host, 76, ticks=math.ceil(stall_time(model, 75) * RATE))
    assert state.count >= 2
    assert not state.fault


def test_a_person_may_hold_the_handle_still_as_long_as_she_holds_the_switch() -> None:
    model = rotary_rig(coulomb=5e-3)
    safety = safety_of(model, current_limit=500, position_rate=RATE, hold_to_run=1)
    assert all(judge(safety, 0, 400, 400) == 0 for _ in range(10 * RATE))


def test_an_effort_that_friction_may_hold_demands_no_edge() -> None:
    assert stall_time(rotary_rig(coulomb=0.02), 200) == math.inf
    assert stall_time(rotary_rig(coulomb=0.02), 201) < math.inf


def test_a_current_above_the_amplifiers_peak_is_over_current() -> None:
    safety = safety_of()
    assert judge(safety, 0, 0, 10_500) == 0
    assert judge(safety, 0, 0, -11_001) == 0, "one alone is a spike of the converter"
    assert judge(safety, 0, 0, 0) == 0
    assert judge(safety, 0, 0, -11_001) == 1 << Fault.OVER_CURRENT, "two of three are not"


def test_heat_that_the_reduction_does_not_stop_cuts() -> None:
    safety = safety_of(position_rate=1_000, continuous_current=100, thermal_time_constant=0.5)
    for _ in range(2_000):
        warm(safety.heat, 150)
    assert judge(safety, 0, 0, 150) == 1 << Fault.THERMAL


def judge(safety: Safety, count: int, current: int, measured: int) -> int:
    return check(safety.rules, safety.heat, safety.counts, safety.currents, count, current, measured)


def safety_of(model: RigModel | None = None, **values: Value) -> Safety:
    safety = Safety(model or rotary_rig())
    safety.configure({**DEFAULTS, **RUN_PARAMETERS, **values}, 0)
    return safety
