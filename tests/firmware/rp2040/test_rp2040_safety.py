"""Faults on the Pico (whole binary): the amplifier's enable pin falls in time."""

from collections.abc import Callable

import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.parameter import Value
from tests.conformance.faults import INEFFECTIVE, FarEnd, check_fault, faults_of
from tests.firmware.rp2040.emulator import START_US, WATCHDOG_US
from tests.firmware.rp2040.session import WIDE_OPEN, Session

Powered = Callable[..., Session]


def test_no_current_flows_before_a_host_commands_it(powered: Powered) -> None:
    session = powered()
    look = session.pico.look()
    assert not look["enabled"]
    assert look["share"] == 0.0
    state = session.host.next_state()
    assert (state.state, state.fault) == (State.IDENTIFIED, Fault.NONE), "power-up is no watchdog reset"


@pytest.mark.parametrize(("rate", "bite_us"), [(1_000, 5_000.0), (20_000, 2_000.0)])
def test_watchdog_drops_enable_and_the_device_reports_the_reset(
    powered: Powered, rate: int, bite_us: float
) -> None:
    session = powered()
    session.push(position_rate=rate)
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


def test_crash_drops_enable_at_once_and_its_address_is_reported_after_the_reset(powered: Powered) -> None:
    session = powered(image="full")
    session.push()
    at = session.pico.ask("crash")["at"]
    session.pico.run(10.0)
    look = session.pico.look()
    assert (look["enabled"], look["current"], look["volts"]) == (False, 0.0, 0.0)
    session.pico.run(WATCHDOG_US + START_US)
    session.connect()
    state = session.host.next_state()
    assert (state.state, state.fault) == (State.FAULT, Fault.PROCESSOR_STOPPED)
    assert session.host.ask(m.GetStatistics(session.host.nonce())).stopped_at == at


def test_a_main_loop_that_stands_still_ends_the_run_within_20_ms_and_the_watchdog_bites(
    powered: Powered,
) -> None:
    session = powered()
    session.push()
    session.pico.ask("hang", interrupts=True)
    session.pico.run(15_000.0)
    assert session.pico.look()["enabled"], "the tick continues, and the command lives"
    session.pico.run(6_000.0)
    assert not session.pico.look()["enabled"]
    session.pico.run(WATCHDOG_US)
    assert session.pico.look()["resets"] == 1


class OnTheBoard(FarEnd):
    """The board in the fault suite; its current is exactly zero, or exact to one step of its pulse width."""

    rate, current, lifetime_us, ramp_us, most = 2_000, 300, 10_000, 5_000, 300.0
    rest_ticks = 20
    grain = 2.0
    late = 2  # slices of the emulator

    def __init__(self, session: Session) -> None:
        super().__init__(session.link)
        self.pico = session.pico
        pressed, illegal = "the emergency stop is pressed", "an illegal transition of the encoder"
        # The contact of the stop opens: the pull-up shows that in the same way as a broken wire.
        self.strikes = {
            pressed: lambda: self.pico.ask("set", emergency_stop=True),
            illegal: lambda: self.pico.ask("jump"),
        }
        self.repairs = {pressed: lambda: self.pico.ask("set", emergency_stop=False)}

    def parameters(self) -> dict[str, Value]:
        return {**super().parameters(), **WIDE_OPEN}

    def effort(self) -> float:
        return float(self.pico.look()["current"]) * 1e3

    def enabled(self) -> bool:
        return bool(self.pico.look()["enabled"])

    def hold(self, held: bool) -> None:
        self.pico.ask("set", hold_to_run=held)


# The core's own reactions are tested on each processor in tests/firmware/mps2.
OF_THE_CORE = {name for name in INEFFECTIVE if name not in ("silence", "noise")}
OF_THE_CONVERTER = ["silence", "STOP", "the emergency stop is pressed"]


@pytest.mark.parametrize("image", ["usual", "full"])
def test_a_fault_of_the_board_is_zero_effort_in_time_latched_and_reported(
    powered: Powered, image: str
) -> None:
    far_end = OnTheBoard(powered(image=image))
    for name in OF_THE_CONVERTER if image == "full" else faults_of(far_end):
        if name not in OF_THE_CORE:
            check_fault(lambda: far_end, name)
