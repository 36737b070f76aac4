"""The device on an emulated board, behind a UART that is a pseudo-terminal on this computer.

The emulator keeps no time on a busy machine: a lost link is accepted, time is not asserted.
"""

import re
import subprocess
import time
from collections.abc import Iterator

import pytest

from firmware_protocol.connection import State
from rig.core.errors import LinkLostError
from rig.devices import open_device
from rig.devices.framed import FramedDevice
from rig.firmware._build import BuildResult
from rig.firmware._info import about
from rig.firmware._selftest import SelfTestRequest, selftest
from tests.conformance.started import started
from tests.firmware import cross

BOOT_S = 30.0
BOARD = MACHINE = "mps2-an386"
UNTIMED = {"protocol", "fault memory", "parameters", "refusals"}


@pytest.fixture
def built() -> BuildResult:
    return cross.image(BOARD)


@pytest.fixture
def url(built: BuildResult) -> Iterator[str]:
    command = [cross.need_qemu(), "-M", MACHINE, "-display", "none", "-monitor", "none", "-serial", "pty"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with started(*command, "-kernel", built.elf, text=True, **pipes) as process:
        assert process.stdout is not None
        printed = process.stdout.readline()
        port = re.search(r"/dev/pts/\d+", printed)
        assert port is not None, printed
        yield f"serial://{port[0]}"


def wait_for_device(device: FramedDevice) -> None:
    """Wait until the device replies: the emulator notices an open pseudo-terminal after about a second."""
    deadline = time.monotonic() + BOOT_S
    while True:
        try:
            assert device.dictionary.device
            return
        except LinkLostError:
            assert time.monotonic() < deadline, "the device never answered"


def test_a_host_talks_with_the_board(built: BuildResult, url: str) -> None:
    with open_device(url) as device:
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
