"""What the Raspberry Pi Pico does when something is wrong, whole binary: the amplifier's enable pin falls, in time."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, Status
from tests.firmware.rp2040.emulator import START_US, WATCHDOG_US
from tests.firmware.rp2040.session import Session

Powered = Callable[..., Session]


def running(session: Session, current: int = 300, position_rate: int = 5_000) -> None:
    """An armed device that gives a current (quanta)."""
    session.configure(position_rate=position_rate, window_minimum=-(2**31), window_maximum=2**31 - 1)
    session.arm()
    session.host.command(current)
    session.listen(0.002)
    look = session.pico.look()
    assert look["enabled"]
    assert look["current"] == pytest.approx(current * 1e-3, abs=0.002)


def test_nothing_is_driven_before_a_host_says_so(powered: Powered) -> None:
    session = powered()
    look = session.pico.look()
    assert not look["enabled"]
    assert look["share"] == 0.0


@pytest.mark.parametrize(("rate", "bite_us"), [(1_000, 5_000.0), (20_000, 2_000.0)])
def test_the_watchdog_drops_enable_and_the_device_says_why_it_is_back(
    powered: Powered, rate: int, bite_us: float
) -> None:
    session = powered()
    running(session, position_rate=rate)
    session.pico.ask("hang")
    session.pico.run(bite_us - 1e6 / rate - 10.0)  # fed within the last tick
    assert session.pico.look()["resets"] == 0
    session.pico.run(1e6 / rate + 20.0)
    look = session.pico.look()
    assert look["resets"] == 1
    assert not look["enabled"]
    assert look["share"] == 0.0
    session.pico.run(START_US)
    assert not session.pico.look()["enabled"]
    session.connect()
    state = session.host.next_state()
    assert (state.state, state.fault) == (State.FAULT, Fault.WATCHDOG_RESET)


def test_a_crash_drops_enable_at_once_and_its_place_is_told_behind_the_reset(powered: Powered) -> None:
    session = powered()
    running(session)
    at = session.pico.ask("crash")["at"]
    session.pico.run(10.0)
    assert not session.pico.look()["enabled"]
    session.pico.run(WATCHDOG_US + START_US)
    session.connect()
    state = session.host.next_state()
    assert (state.state, state.fault) == (State.FAULT, Fault.PROCESSOR_STOPPED)
    assert session.host.ask(m.GetStatistics(session.host.nonce())).stopped_at == at


def test_a_board_that_is_not_armed_shows_its_drive_when_asked(powered: Powered) -> None:
    session = powered()
    assert session.host.ask(m.EnterBootloader(session.host.nonce())).status == Status.OK
    session.listen(0.1)
    assert session.pico.look()["bootloader"]


def test_a_main_loop_that_stands_still_ends_the_run_within_20_ms_and_the_watchdog_bites(
    powered: Powered,
) -> None:
    session = powered()
    running(session)
    session.pico.ask("hang", interrupts=True)
    session.pico.run(15_000.0)
    assert session.pico.look()["enabled"], "the tick goes on, and the command lives"
    session.pico.run(6_000.0)
    assert not session.pico.look()["enabled"]
    session.pico.run(WATCHDOG_US)
    assert session.pico.look()["resets"] == 1


def test_power_up_is_no_watchdog_reset(powered: Powered) -> None:
    state = powered().host.next_state()
    assert (state.state, state.fault) == (State.IDENTIFIED, Fault.NONE)


def test_a_silent_host_ends_in_an_amplifier_that_is_off(powered: Powered) -> None:
    session = powered()
    running(session)
    session.listen(0.05)
    state = session.host.states[-1]
    assert (state.state, state.fault) == (State.FAULT, Fault.LINK_LOST)
    assert not session.pico.look()["enabled"]


def test_an_emergency_stop_or_its_broken_wire_switches_the_amplifier_off(powered: Powered) -> None:
    session = powered()
    running(session)
    session.pico.ask("set", emergency_stop=True)  # the contact opens: the pull-up says so in either case
    session.listen(0.001)
    look = session.pico.look()
    assert not look["enabled"]
    state = session.host.states[-1]
    assert state.fault == Fault.EMERGENCY_STOP
    assert state.inputs & Input.EMERGENCY_STOP


def test_letting_go_of_hold_to_run_takes_the_current_away(powered: Powered) -> None:
    session = powered()
    session.configure(position_rate=5_000, hold_to_run=1)
    session.arm()
    session.host.command(300)
    session.listen(0.001)
    assert session.pico.look()["current"] == pytest.approx(0.3, abs=0.002)
    session.pico.ask("set", hold_to_run=False)
    session.host.command(300)
    session.listen(0.001)
    assert session.pico.look()["current"] == 0.0
    assert not session.host.states[-1].inputs & Input.HOLD_TO_RUN
