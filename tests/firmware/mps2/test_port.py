"""Emulated processors fulfil all duties of a port except the declared ones; time is counted in instructions."""

import os
import re
import struct
import subprocess
from pathlib import Path

import pytest

from rig.core.check import Outcome
from rig.devices import open_link
from rig.firmware._build import PORT_CHECK
from rig.firmware._port_check import PortCheckRequest, check_port
from tests.conformance.started import started
from tests.firmware import cross
from tests.firmware.mps2.lockstep import Partner, emulator
from tests.firmware.simulated_port import SimulatedPort

BOARD = "mps2-an386"
# device_on_uart.c: "There is no encoder, no motor and no watchdog".
LACKS = {"sync bits", "watchdog bites"}
REQUEST = struct.Struct("<IB3x64s")
REPLY = struct.Struct("<I")
SLICE_US = 2_000  # each is an exchange with another process


@pytest.mark.quiet  # on a busy machine the emulator stands still, which looks like a reset by a watchdog (2026-11-29)
def test_port_to_a_uart_lacks_only_its_declared_duties() -> None:
    built = cross.image(BOARD, PORT_CHECK)
    command = [*emulator(BOARD, serial="pty"), "-kernel", str(built.elf)]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with started(*command, text=True, **pipes) as process:
        assert process.stdout is not None
        printed = process.stdout.readline()
        place = re.search(r"/dev/pts/\d+", printed)
        assert place is not None, printed
        request = PortCheckRequest(current=400, wired=True, seconds=0.3, real_time=False)
        found = check_port(lambda: open_link(f"serial://{place[0]}"), request)
    broken = {one.name: one.text for one in found.checks if one.outcome is Outcome.REFUSED}
    assert set(broken) == LACKS, broken


class SimulatedPartner(Partner):
    """A process with the simulated board in the emulator."""

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
