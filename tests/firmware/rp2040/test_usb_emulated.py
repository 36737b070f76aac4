"""The whole binary on an emulated USB bus: its USB registers, the core behind them, and ticks in between."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import Connection, Received, State
from firmware_protocol.messages import Message, Role
from rig.config._derive import rig_model
from rig.config.presets import load
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.firmware._build import BuildResult
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.session import WIDE_OPEN, Session
from tests.firmware.rp2040.usb_line import EmulatedUsb, UsbLine, UsbSupervisor
from tests.firmware.test_core_law import push, run_values

RIG, PORT = 1, 2
STALL = -32
RESET = -104  # Linux' ECONNRESET, negated: withdrawn
STREAM_US = 40_000.0
FULL_SPEED_BYTES = 19 * 64 * 1000  # a second, in bulk: USB 2.0, table 5-9
IDENTIFY = m.Identify(nonce=7, offset=0)
ON_DEVICE: dict[str, Any] = {
    "controller.loop": "device",
    "controller.estimator": "fdm-butterworth-fixed",
    "controller.position_rate": 20_000,
    "controller.velocity_rate": 2_000,
    "wall.stiffness": 150.0,
    "wall.damping": 0.1,
    "homing.settle_s": 0.02,
    "homing.speed": 1.0,
    "trial.duration_s": 0.15,
    "trial.release_s": 0.01,
    "verdict.tail_s": 0.05,
}
MODEL = rig_model(load(emulator.PRESET))


@pytest.fixture
def pico(built: BuildResult) -> Iterator[emulator.Pico]:
    with emulator.Pico(MODEL, built.bin) as board:
        yield board
        look = board.ask("usb_look")
        assert look["errors"] == []
        assert board.look()["complaints"] == {}


def answer_of(data: bytes) -> Message:
    connection = Connection(Role.HOST)
    connection.send(IDENTIFY)
    connection.receive_data(data)
    event = connection.next_event()
    assert isinstance(event, Received)
    return event.message


@pytest.mark.parametrize("flash", [emulator.FLASH_ID, "ffffffffffffffff", "0000000000000000"])
def test_its_serial_number_is_that_of_its_flash_or_else_of_its_build(built: BuildResult, flash: str) -> None:
    with emulator.Pico(MODEL, built.bin, flash=flash) as pico:
        line = UsbLine(pico)
        assert line.plugged["status"] == 0
        assert line.plugged["address"] == 7
        device = bytes.fromhex(line.plugged["device"])
        status, text = line.control(0x80, 6, 0x300 | device[16], 0x409)
        assert not [text for text in pico.look()["complaints"] if text.startswith("SSI")]
    assert status == 0
    serial = text[2:].decode("utf-16-le")
    assert serial.lower() == (flash if len(set(flash)) > 1 else built.dictionary_hash)


def test_after_a_fault_on_the_serial_line_it_answers_by_usb(powered: Callable[..., Session]) -> None:
    session = powered()
    session.configure(position_rate=5_000)
    session.arm()
    session.host.command(0)
    line = UsbLine(session.pico)
    line.send(Connection(Role.HOST).send(IDENTIFY))
    assert line.run(5_000.0) == b"", "an armed device keeps its link"
    session.listen(0.05)
    assert session.host.states[-1].state == State.FAULT
    line.send(Connection(Role.HOST).send(IDENTIFY))
    assert isinstance(answer_of(line.run(5_000.0)), m.Identity)


def test_both_links_take_turns_in_one_memory(powered: Callable[..., Session]) -> None:
    session = powered()
    session.configure(position_rate=5_000)
    line = UsbLine(session.pico)
    for _ in range(2):
        line.send(Connection(Role.HOST).send(IDENTIFY))
        answered = line.run(5_000.0)
        assert isinstance(answer_of(answered), m.Identity)
        session.host.ask(m.GetTime(session.host.nonce(), 0))  # STATEs by USB still wait for their packet
        session.listen(0.02)
    counted = session.host.connection.statistics
    assert counted.crc_errors == 0


def test_a_transfer_that_is_withdrawn_at_any_time_ends_once(pico: emulator.Pico) -> None:
    """Also with a packet on the wire, the reply to the withdrawal follows the end of the transfer."""
    line = UsbLine(pico)
    seen = set()
    for us in range(0, 200, 3):
        (first, status, length), *rest = pico.ask("usb_withdraw", us=us, after=1_000)["told"]
        assert first == "done"
        assert (status, length) == (0, 18) or status == RESET
        assert rest == [["withdrawn", status == RESET]]
        seen.add(status)
    assert seen == {0, RESET}
    assert line.control(0x80, 6, 0x100, 0, 18)[0] == 0


def test_each_pipe_replies_behind_an_unknown_request_and_a_pulled_cable(pico: emulator.Pico) -> None:
    for pipe in (PORT, RIG):
        line = UsbLine(pico, pipe)
        assert line.control(0x80, 6, 0x600, 0, 10)[0] == STALL
        assert line.control(0xC0, 0x77)[0] == STALL
        assert line.control(0xC0, 0x20, 0, 7)[0] == 0
        line.send(Connection(Role.HOST).send(IDENTIFY))
        assert isinstance(answer_of(line.run(5_000.0)), m.Identity)
        pico.ask("usb_suspend", asleep=True)
        pico.run(5_000.0)


def test_every_tick_of_a_law_arrives(pico: emulator.Pico, built: BuildResult) -> None:
    """BATCH arrives without a gap at the speed of the bus; the used share of the bus is printed."""
    rate = 50_000
    host = UsbSupervisor(UsbLine(pico), int(built.dictionary_hash, 16))
    host.begin(**run_values(push(), position_rate=rate, batch_layout=0, **WIDE_OPEN))
    before = host.line.look()
    host.watch(STREAM_US)
    after = host.line.look()
    indices = [sample.index for sample in host.samples]
    assert indices == list(range(indices[0], indices[0] + len(indices)))
    assert len(indices) >= (STREAM_US * 1e-6 - 0.003) * rate
    state = host.states[-1]
    assert (state.fault, state.missed_ticks) == (0, 0)
    used = (after["bytesIn"] - before["bytesIn"]) / (STREAM_US * 1e-6)
    print(f"{len(indices)} ticks, {used / 1e3:.0f} kB/s, {used / FULL_SPEED_BYTES:.0%} of the bus")
    assert used < 0.5 * FULL_SPEED_BYTES


def test_a_cable_that_is_pulled_in_a_session_ends_with_no_current(
    pico: emulator.Pico, built: BuildResult
) -> None:
    host = UsbSupervisor(UsbLine(pico), int(built.dictionary_hash, 16))
    host.begin(**run_values(push(), position_rate=20_000, **WIDE_OPEN))
    host.watch(10_000.0)
    assert pico.look()["enabled"]
    pico.ask("usb_suspend", asleep=True)
    pico.run(35_000.0)
    look = pico.look()
    assert not look["enabled"]
    assert look["share"] == 0
    host.line = UsbLine(pico)
    host.identify()
    assert host.states[-1].state == State.FAULT


def test_a_whole_hit_by_rig_itself(built: BuildResult, tmp_path: Path) -> None:
    """Plan, supervising loop and recording work as on any device, with the plant at the pins of the board."""
    with emulator.Pico(MODEL, built.bin, position=0.0) as pico:
        line = UsbLine(pico)
        with FramedDevice(EmulatedUsb(line)) as device:
            (result,) = hit(
                HitRequest(
                    experiment=load(emulator.PRESET),
                    changes=ON_DEVICE,
                    device=device,
                    verified=True,
                    output=tmp_path,
                ),
                admit,
            )
        look = pico.look()
        assert line.look()["errors"] == []
    recording = result.recording
    rows = recording.rows
    assert result.verdict.kind.value == "stable"
    assert recording.trailer["device_host_agreement"]["holds"]
    assert recording.trailer["device_host_agreement"]["compared"] > 0.9 * len(rows)
    assert (look["enabled"], look["share"]) == (False, 0)
    assert np.array_equal(np.diff(rows["sample_index"]), np.ones(len(rows) - 1))
    assert look["truth"] == rows["count"][-1]
