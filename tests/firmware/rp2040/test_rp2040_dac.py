"""The Pico's set-point as a voltage: every frame on the pins, decoded by a model of the converter.

The converter's RESET is the enable pin, as in wiring.toml: at its low level the output is 0 V.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.packing import unpack_batch_samples
from tests.firmware.rp2040.emulator import FULL_SCALE_A, START_US, WATCHDOG_US
from tests.firmware.rp2040.session import WIDE_OPEN, Session

Powered = Callable[..., Session]
QUANTUM_A = 0.001
PEAK = 5_555  # quanta, of this rig
MIDDLE = 0x8000
WRITE, RANGE = 0x3, 0x40228  # AD5761R: middle at clear and at power-up, its own reference, ±10 V
STEP_A = FULL_SCALE_A / MIDDLE
NEAREST = 0.5 + 0.5 / 65536 * FULL_SCALE_A / QUANTUM_A  # steps: the scale itself is rounded to 1/65536
TRANSFER_NS = 1_000.0
PERIOD_US = 200.0
WORK_US = 20.0  # of a tick, before enable falls


@pytest.fixture
def powered_dac(powered: Callable[..., Session]) -> Powered:
    return lambda position=None: powered(position, "full")


@dataclass(frozen=True, slots=True)
class Frame:
    began: float
    ended: float
    word: int
    accepted: bool

    @property
    def code(self) -> int:
        assert self.word >> 16 == WRITE
        return self.word & 0xFFFF


def frames(session: Session) -> list[Frame]:
    """Return the frames since the last call; the converter must accept the format of each."""
    assert session.pico.look()["complaints"] == {}
    return [Frame(**one) for one in session.pico.ask("frames")["frames"]]


def steps_off(code: int, quanta: int) -> float:
    """Return the error (in steps) of a code against its current, in straight binary about the middle."""
    return abs(code - MIDDLE - quanta * QUANTUM_A / FULL_SCALE_A * (MIDDLE - 1))


def test_converter_gets_nothing_before_arming_and_its_range_before_each_current(powered_dac: Powered) -> None:
    session = powered_dac()
    assert session.pico.look()["volts"] == 0.0
    assert {(frame.word, frame.accepted) for frame in frames(session)} == {(RANGE, False)}
    session.push()
    accepted = [frame for frame in frames(session) if frame.accepted]
    assert accepted[0].word == RANGE
    assert steps_off(accepted[-1].code, 300) <= NEAREST
    session.host.disarm()  # which resets the converter
    session.arm(session=2)
    assert session.pico.look()["volts"] == 0.0
    session.listen(0.001)  # a command answers a STATE of its session
    session.host.command(-400)
    session.listen(0.002)
    assert session.pico.look()["current"] == pytest.approx(-0.4, abs=STEP_A)


def test_the_pins_carry_every_current_to_the_step_within_a_microsecond(powered_dac: Powered) -> None:
    session = powered_dac()
    session.configure(position_rate=5_000, slew_limit=32_767, current_limit=PEAK, **WIDE_OPEN)
    session.arm()
    for quanta in (1, -1, 37, 500, -500, PEAK, -PEAK):
        session.host.command(quanta)
        session.listen(0.0006)
        frames(session)
        session.host.command(quanta)
        session.listen(0.0006)
        sent = frames(session)
        assert sent
        assert all(steps_off(frame.code, quanta) <= NEAREST for frame in sent)
        assert all(frame.ended - frame.began < TRANSFER_NS for frame in sent)
        assert session.pico.look()["current"] == pytest.approx(quanta * QUANTUM_A, abs=STEP_A)


def test_wall_leaves_as_the_reported_currents_frame_by_frame(powered_dac: Powered) -> None:
    session = powered_dac(position=0.0)
    session.begin_law(20_000, 2_000)
    frames(session)
    session.supervise(0.08)
    assert session.pico.look()["most"] > 1.0, "the wall pushed back (A)"
    _, indices = session.counts()
    reported = [sample[1] for batch in session.batches for sample in unpack_batch_samples(batch)]
    sent = frames(session)
    ended = np.array([frame.ended for frame in sent])
    # The current of a sample was set in the tick before: its frame is the first that ends after that tick began.
    came = session.ticks_of(indices - 1).came
    which = np.searchsorted(ended, came)
    codes = [MIDDLE if sent[i].word == RANGE else sent[i].code for i in which]
    assert max(map(steps_off, codes, reported)) <= NEAREST


@pytest.mark.parametrize("amid", [False, True])
def test_a_transfer_that_stalls_is_a_fault_and_zero_volts_within_two_ticks(
    powered_dac: Powered, amid: bool
) -> None:
    session = powered_dac()
    session.push()
    session.pico.ask("stall", amid=amid)
    took_us = session.pico.ask("off", us=1e3)["took"] / 1e3
    assert took_us < 2.0 * PERIOD_US + WORK_US
    assert session.pico.look()["volts"] == 0.0
    session.listen(0.002)
    state = session.host.states[-1]
    assert (state.state, state.fault) == (State.FAULT, Fault.OUTPUT_STALLED)


def test_no_burst_of_requests_looks_like_a_stall(powered_dac: Powered) -> None:
    session = powered_dac()
    session.configure(position_rate=5_000)
    for number in range(1, 4):
        session.arm(session=number)
        for _ in range(20):
            session.host.command(mode=m.Mode.STOP)
        session.listen(0.001)
        session.host.disarm()
    assert session.host.next_state().fault == Fault.NONE
    assert len(frames(session)) > 30


def test_a_hung_board_is_at_zero_volts_with_its_watchdog_and_again_after_the_reset(
    powered_dac: Powered,
) -> None:
    session = powered_dac()
    session.push()
    session.pico.ask("hang")
    session.pico.run(WATCHDOG_US)
    assert session.pico.look()["resets"] == 1
    assert session.pico.look()["volts"] == 0.0
    session.pico.run(START_US)
    session.connect()
    state = session.host.next_state()
    assert (state.state, state.fault) == (State.FAULT, Fault.WATCHDOG_RESET)
    assert session.pico.look()["volts"] == 0.0
    assert not any(frame.accepted for frame in frames(session))


def test_a_contact_behind_the_board_is_zero_volts_whatever_it_sends_and_until_it_has_been_at_rest(
    powered_dac: Powered,
) -> None:
    session = powered_dac()
    session.push()
    frames(session)

    def volts_with(current: int) -> float:
        session.host.command(current)
        session.listen(0.001)
        assert session.pico.look()["enabled"]
        return float(session.pico.look()["volts"])

    session.pico.ask("contact", closed=False)
    assert volts_with(300) == 0.0
    assert not any(frame.accepted for frame in frames(session))
    session.pico.ask("contact", closed=True)
    assert volts_with(300) == 0.0
    assert any(frame.accepted for frame in frames(session)), "a current without a range"
    assert volts_with(0) == 0.0
    assert volts_with(-300) == pytest.approx(-0.3 / FULL_SCALE_A * 10.0, abs=1e-3)
