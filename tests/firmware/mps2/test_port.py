"""Emulated processors fulfil all duties of a port except the declared ones; time is counted in instructions."""

import os
import struct
import time
from pathlib import Path

import pytest

from firmware_protocol.connection import State
from rig.core.check import Outcome
from rig.core.errors import LinkLostError
from rig.devices import open_device, open_link
from rig.devices.framed import FramedDevice
from rig.firmware._build import PORT_CHECK
from rig.firmware._info import about
from rig.firmware._port_check import PortCheckRequest, check_port
from rig.firmware._selftest import SelfTestRequest, selftest
from tests.firmware import cross
from tests.firmware.mps2.lockstep import Partner, behind_uart, emulator
from tests.firmware.simulated_port import SimulatedPort

BOARD = "mps2-an386"
BOOT_S = 30.0
UNTIMED = {"protocol", "fault memory", "parameters", "refusals"}
# device_on_uart.c: "There is no encoder, no motor and no watchdog".
LACKS = {"sync bits", "watchdog bites"}
REQUEST = struct.Struct("<IB3x64s")
REPLY = struct.Struct("<I")
SLICE_US = 2_000  # each is an exchange with another process


@pytest.mark.quiet  # on a busy machine the emulator stands still, which looks like a reset by a watchdog (2026-11-29)
def test_port_to_a_uart_lacks_only_its_declared_duties() -> None:
    request = PortCheckRequest(current=400, wired=True, seconds=0.3, real_time=False)
    with behind_uart(emulator(BOARD, serial="pty"), cross.image(BOARD, PORT_CHECK)) as url:
        found = check_port(lambda: open_link(url), request)
    broken = {one.name: one.text for one in found.checks if one.outcome is Outcome.REFUSED}
    assert set(broken) == LACKS, broken


class SimulatedPartner(Partner):
    def run(self, us: int, data: bytes) -> bytes:
        os.write(self._requests, REQUEST.pack(us, len(data), data))
        received = self._read()
        while len(received) < REPLY.size or len(received) < REPLY.size + REPLY.unpack_from(received)[0]:
            received += self._read()
        return received[REPLY.size :]


def test_the_port_of_lockstep_keeps_every_duty_on_the_processor_too(tmp_path: Path) -> None:
    built = cross.image(BOARD, "tests")
    (tmp_path / "simulate").touch()
    partner = SimulatedPartner([*emulator(BOARD), "-kernel", str(built.elf)], tmp_path)
    try:
        link = SimulatedPort(partner.run, SLICE_US)
        found = check_port(
            lambda: link, PortCheckRequest(current=400, wired=True, seconds=0.5, bootloader=True)
        )
    finally:
        partner.close()
    assert {one.name: one.text for one in found.checks if one.outcome is not Outcome.OK} == {}


# ---------------------------------------------------------------------- the device on a UART


def wait_for_device(device: FramedDevice) -> None:
    """Wait until the device replies: the emulator notices an open pseudo-terminal after about a second."""
    deadline = time.monotonic() + BOOT_S
    while True:
        try:
            assert device.dictionary.device
            return
        except LinkLostError:
            assert time.monotonic() < deadline, "the device never answered"


def test_a_host_talks_with_the_board() -> None:
    """The emulator keeps no time on a busy machine: a lost link is accepted, time is not asserted."""
    built = cross.image(BOARD)
    with behind_uart(emulator(BOARD, serial="pty", time=()), built) as url, open_device(url) as device:
        wait_for_device(device)
        found = about(url, device.dictionary, device.dictionary_hash, None)
        assert found.compatible
        assert (found.firmware, found.dictionary_hash) == (built.firmware, built.dictionary_hash)
        try:
            result = selftest(device, SelfTestRequest(rate=1_000, seconds=0.2))
            state = device.connection.state
        except LinkLostError:
            return
    outcomes = {check.name: check for check in result.checks if check.name in UNTIMED}
    assert set(outcomes) == UNTIMED
    for check in outcomes.values():
        assert check.outcome == "ok" or "no reply to" in check.text, check
    assert state in (State.CONFIGURED, State.IDENTIFIED)
