"""The core with board hardware that a simulated device lacks: clock, timer, encoder, watchdog."""

import ctypes
from ctypes import CDLL
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.errors import LocalProtocolError
from firmware_protocol.faults import Fault, LimitFlag, Status
from firmware_protocol.framing import ENCODED_LIMIT
from firmware_protocol.messages import Message, Mode
from firmware_protocol.parameters import BY_NAME
from rig.core.model import RigModel
from sim_backend.board.safety import BUDGET, HEAT, configure_heat, flat, warm
from tests.conformance.rigs import rotary_rig
from tests.firmware import supervised
from tests.firmware.law.law_library import structure, u8, u32, u64

RATE = 2_000
PERIOD = 16_000_000 // RATE
POLL_BYTES = 64


class Board(supervised.Board):
    def __init__(self, library: CDLL, model: RigModel | None = None) -> None:
        super().__init__(library, model or rotary_rig())

    def tick(self, current: int | None = None, missed: int = 0) -> m.State | None:  # type: ignore[override]
        """Advance by one period and the missed ones, after a COMMAND if a current is given."""
        if current is not None:
            self.command(Mode.CURRENT, current)
        self.missed, before = missed, len(self.states)
        super().tick()
        return self.states[-1] if len(self.states) > before else None

    def ask(self, message: Message, session: int | None = None) -> Any:
        (answer,) = self.take(self.receive(self.host.send(message, session=session)))
        return answer


def seen(state: m.State | None) -> m.State:
    assert state is not None
    return state


# ---------------------------------------------------------------------- time


def test_a_board_drives_after_each_sample_and_feeds_its_watchdog_in_the_tick_alone(library: CDLL) -> None:
    board = Board(library).begin()
    fed = board.core.status.feeds
    state = seen(board.tick(70))
    assert state.current_commanded == 0  # what flowed until this sample
    assert board.core.status.current == 70
    assert seen(board.tick(70)).current_commanded == 70
    board.ask(m.GetTime(3, 0))
    assert board.core.status.feeds == fed + 2


def test_worst_execution_time_since_arming_is_reported_and_saturates(library: CDLL) -> None:
    board = Board(library).begin(position_rate=200)
    board.library.host_set_clock(board.core.address, board.core.status.time, 10)
    board.tick(0)
    board.library.host_set_clock(board.core.address, board.core.status.time, 0)
    worst = seen(board.tick(0)).execution_time
    assert worst > 0
    assert worst % 10 == 0
    board.library.host_set_clock(board.core.address, board.core.status.time, 35_000)
    board.tick(0)
    board.library.host_set_clock(board.core.address, board.core.status.time, 0)
    assert seen(board.tick(0)).execution_time == 0xFFFF
    assert board.core.status.fault == Fault.NONE


def test_a_tick_longer_than_its_period_is_an_overrun(library: CDLL) -> None:
    board = Board(library).begin()
    board.tick(100)
    assert board.core.status.current == 100
    board.library.host_set_clock(board.core.address, board.core.status.time, PERIOD)
    board.tick(100)
    status = board.core.status
    assert (status.fault, status.current, status.enabled) == (Fault.TICK_OVERRUN, 0, 0)


def test_missed_ticks_are_counted_and_show_as_lost_states(library: CDLL) -> None:
    board = Board(library).begin()
    before = seen(board.tick(10))
    state = seen(board.tick(10, missed=1))
    assert (state.missed_ticks, state.sample_index) == (1, before.sample_index + 2)
    assert (state.device_time - before.device_time) & 0xFFFFFFFF == 2 * PERIOD
    assert board.host.statistics.lost == 1
    assert state.fault == Fault.NONE
    board.late = PERIOD - 1
    late = seen(board.tick(10))
    assert (late.missed_ticks, late.sample_index) == (1, state.sample_index + 1), "late, not missed"


def test_two_missed_ticks_in_succession_end_an_armed_run(library: CDLL) -> None:
    board = Board(library)
    board.tick()
    board.tick(missed=7)
    assert board.core.status.fault == Fault.NONE, "a device that is not armed may take its time"
    board.begin()
    board.tick(100)
    assert seen(board.tick(100)).current_commanded == 100
    state = seen(board.tick(100, missed=2))
    assert (state.missed_ticks, state.fault) == (2, Fault.TICK_OVERRUN)
    assert (board.core.status.current, board.core.status.enabled) == (0, 0)


def test_a_flag_says_when_more_than_ten_ticks_are_missed_within_a_second(library: CDLL) -> None:
    board = Board(library).begin()
    board.tick(0)

    def flags(missed: int) -> list[bool]:
        return [bool(seen(board.tick(0, missed=missed)).limits & LimitFlag.MISSED_TICKS) for _ in range(10)]

    assert flags(1) == [False] * 10
    assert seen(board.tick(0)).limits == 0
    assert seen(board.tick(0, missed=1)).limits & LimitFlag.MISSED_TICKS
    for _ in range(RATE):
        board.tick(0)
    assert flags(1) == [False] * 10


@pytest.mark.parametrize(
    ("rate", "bite_us"), [(100, 50_000), (1_000, 5_000), (2_000, 2_500), (20_000, 2_000)]
)
def test_an_armed_device_lets_its_watchdog_bite_early(library: CDLL, rate: int, bite_us: int) -> None:
    board = Board(library)
    board.tick()
    assert board.core.status.bite_us == 40_000
    board.begin(position_rate=rate)
    board.tick(0)
    assert board.core.status.bite_us == bite_us
    board.ask(m.Disarm(9, 0))
    board.tick()
    assert board.core.status.bite_us == 40_000


def test_it_enters_its_boot_loader_when_asked_and_not_armed(library: CDLL) -> None:
    board = Board(library)
    board.ask(m.Identify(1, 0))
    question = m.EnterBootloader(2)
    assert board.ask(question).status == Status.UNSUPPORTED
    library.host_let_leave(board.core.address)
    board.begin()
    with pytest.raises(LocalProtocolError, match="ARMED"):
        board.ask(question)
    board.ask(m.Disarm(9, 0))
    assert board.ask(question).status == Status.OK
    for _ in range(RATE // 20):
        assert not board.core.status.left, "the answer has 50 ms to leave"
        board.tick()
        board.core.receive(b"\0")
    assert board.core.status.left
    assert board.core.status.state == State.BOOT


def test_cause_of_the_last_reset_is_reported(library: CDLL) -> None:
    board = Board(library)
    board.ask(m.Identify(1, 0))
    for place, fault in ((0x2000_1234, Fault.PROCESSOR_STOPPED), (0, Fault.WATCHDOG_RESET)):
        library.host_restart(board.core.address)
        library.host_was_reset(board.core.address, place)
        assert board.core.status.fault == fault
        assert board.ask(m.GetStatistics(2)).stopped_at == place


def test_a_main_loop_that_stands_for_20_ms_ends_the_run_and_starves_the_watchdog(library: CDLL) -> None:
    board = Board(library).begin()
    board.tick(100)
    fed = board.core.status.feeds
    for tick in range(1, RATE // 50 + 5):
        world = (board.core.status.due, 0, 0, 0, 0)
        board.library.host_set_world(board.core.address, *world)
        board.library.host_tick_alone(board.core.address)
        stands = tick > RATE // 50
        status = board.core.status
        assert (status.fault, status.enabled) == ((Fault.INTERNAL, 0) if stands else (Fault.NONE, 1))
        assert status.feeds == fed + min(tick, RATE // 50)


def test_a_timer_beside_the_grid_draws_the_grid_along(library: CDLL) -> None:
    # The end of a tick is judged within half a period, however far the timer has drifted.
    board = Board(library).begin()
    for late in (0, PERIOD // 2, PERIOD // 2 + 1, 3 * PERIOD):
        board.late = late
        board.tick(5)
        status = board.core.status
        assert abs(status.due - status.time - PERIOD) <= PERIOD // 2


def test_an_edge_that_is_younger_than_the_sample_is_not_in_the_future(library: CDLL) -> None:
    board = Board(library).begin()
    board.edge_time = 2**40
    state = seen(board.tick(0))
    assert state.edge_time == state.device_time


def test_an_old_edge_never_looks_fresh(library: CDLL) -> None:
    board = Board(library)
    board.ask(m.Identify(1, 0))
    board.late = 300 * 16_000_000
    state = None
    while state is None:
        state = board.tick()
    assert (state.device_time - state.edge_time) & 0xFFFFFFFF == m.OLDEST_EDGE


# ---------------------------------------------------------------------- hardware


def test_the_age_of_a_command_saturates(library: CDLL) -> None:
    board = Board(library).begin()
    board.tick(50)
    for _ in range(RATE // 10):
        state = seen(board.tick())
    assert state.fault == Fault.LINK_LOST
    assert seen(board.tick(missed=70_000)).command_age == 0xFFFF  # a device that is not armed may miss ticks


def test_encoder_failure_is_a_fault_before_arming_too(library: CDLL) -> None:
    board = Board(library)
    board.ask(m.Identify(1, 0))
    board.library.host_fail_encoder(board.core.address)
    board.tick()
    assert board.core.status.state == State.FAULT


def test_the_amplifier_is_on_in_a_session_alone(library: CDLL) -> None:
    board = Board(library)
    assert not board.core.status.enabled
    board.begin()
    assert board.core.status.enabled
    board.ask(m.Disarm(9, 0))
    assert not board.core.status.enabled


def test_stop_cuts_in_the_middle_of_a_tick(library: CDLL) -> None:
    board = Board(library).begin()
    board.tick(100)
    board.core.receive(board.host.send(m.Command(0, 20_000, m.Mode.STOP, 0, 100)))
    assert board.core.status.current == 0
    assert seen(board.tick()).current_commanded == 0
    assert board.core.status.enabled


def test_a_rate_that_the_timer_cannot_do_is_refused_and_changes_nothing(library: CDLL) -> None:
    board = Board(library)
    board.ask(m.Identify(1, 0))
    before = board.ask(m.GetParameters(2, 0))
    board.library.host_refuse_rate(board.core.address, 3_000)
    ack = board.configure(position_rate=3_000, current_limit=5)
    assert (ack.status, ack.detail) == (Status.INCONSISTENT, BY_NAME["position_rate"].id)
    assert board.ask(m.GetParameters(2, 0)) == before


def test_a_board_whose_timer_cannot_do_its_own_rate_says_so_at_once(library: CDLL) -> None:
    board = Board(library)
    board.library.host_refuse_rate(board.core.address, 1_000)
    board.library.host_restart(board.core.address)
    assert (board.core.status.state, board.core.status.fault) == (State.FAULT, Fault.INTERNAL)


# ---------------------------------------------------------------------- the link


def test_a_flood_of_bytes_is_taken_in_bounded_pieces(library: CDLL) -> None:
    board = Board(library)
    flood = bytes([1]) * 1_000
    assert library.host_poll(board.core.address, flood, len(flood)) == POLL_BYTES
    assert library.host_poll(board.core.address, b"", 0) == 0


def test_bytes_without_an_end_are_counted_once_and_forgotten(library: CDLL) -> None:
    board = Board(library)
    board.core.receive(bytes([7]) * (20 * ENCODED_LIMIT))
    assert board.core.status.counters.framing_errors == 1
    board.core.receive(b"\0")
    assert isinstance(board.ask(m.Identify(1, 0)), m.Identity)


# ---------------------------------------------------------------------- heat


# `struct thermal` of thermal.h.
CThermal = structure("CThermal", (u64, "heat budget"), (u32, "decay"), (u8, "shift"))


@pytest.mark.parametrize("rate", [50, 1_000, 50_000])
@pytest.mark.parametrize("time_constant_s", [0.125, 8.0, 8_192.0])
def test_heat_in_integers_is_heat_in_doubles(library: CDLL, rate: int, time_constant_s: float) -> None:
    ours, theirs = CThermal(), flat(np.float64, 3)
    library.thermal_configure.argtypes = [ctypes.c_void_p, ctypes.c_uint16, ctypes.c_float, ctypes.c_uint32]
    library.thermal_update.argtypes = [ctypes.c_void_p, ctypes.c_int16]
    library.thermal_configure(ctypes.byref(ours), 1_000, time_constant_s, rate)
    configure_heat(theirs, 1_000, time_constant_s, rate)
    assert ours.budget == int(theirs[BUDGET]) << 32
    for tick in range(8_000):
        measured = (1, -32_767, 300, 0)[tick // 2_000]
        library.thermal_update(ctypes.byref(ours), measured)
        warm(theirs, measured)
        if tick % 500 == 499:
            assert ours.heat / 2**32 == pytest.approx(theirs[HEAT], rel=1e-6, abs=1e-6)
