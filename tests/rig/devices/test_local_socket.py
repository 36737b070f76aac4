"""A simulated rig behind a Unix socket, in real time; no latency is asserted."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import messages as m
from firmware_protocol.faults import Fault
from rig.config._sections import Host as Scheduling
from rig.core.errors import ConfigError, DeviceNotFoundError, UnpluggedError
from rig.devices._local_socket import SocketLink, open_link
from rig.devices.device import DeviceUrl
from rig.devices.local import host_beside
from tests.conformance.device import check_device
from tests.conformance.firmware import need_compiler
from tests.conformance.host import Host
from tests.conformance.link import check_link
from tests.conformance.served import served_rig
from tests.conformance.started import WAIT_S
from tests.conformance.tiers import first_by_default

SLACK_S = 5.0  # of a loaded machine


def opened(path: Any, query: str = "") -> SocketLink:
    return open_link(DeviceUrl.parse(f"unix://{path}{query}"))


@pytest.fixture(params=first_by_default([None, False]), ids=["default", "readable"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    with served_rig(firmware=request.param, socket=tmp_path / "port") as served:
        yield Path(served)
    assert not (tmp_path / "port").exists()


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[socket.socket]:
    """A program that listens at ``silent`` and sends nothing."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "silent"))
        listening.listen()
        yield listening


def test_it_conforms_as_a_link(path: Path, tmp_path: Path, listener: Any) -> None:
    check_link(lambda: opened(path), lambda: opened(tmp_path / "silent"), slack_s=SLACK_S)


@pytest.mark.quiet  # a host that is halted for longer than a command's lifetime makes the device fault
def test_the_rig_behind_it_conforms_as_a_device(path: Path) -> None:
    check_device(lambda: opened(path), starts_in_boot=False)


def test_after_a_lost_host_the_next_one_finds_link_lost_and_an_empty_line(path: Path) -> None:
    host = Host(opened(path))
    host.begin()
    host.command(20)  # without one the device waits for half a second
    last = host.next_state()
    host.link.close()  # no STOP, no DISARM
    heir = Host(opened(path), first_nonce=500)
    heir.identify()
    while not (log := heir.ask(m.GetFaultLog(heir.nonce(), 0))).fault:
        pass
    assert log.fault == Fault.LINK_LOST
    assert heir.disarm(clear_fault=True).status == 0
    assert heir.next_state().sample_index > last.sample_index
    heir.link.close()


def test_a_program_that_ends_is_unplugged(tmp_path: Path, listener: socket.socket) -> None:
    link = opened(tmp_path / "silent")
    listener.accept()[0].close()
    with pytest.raises(UnpluggedError):
        link.read(WAIT_S)
    link.close()


def test_a_socket_without_a_listener_does_not_open(tmp_path: Path) -> None:
    with pytest.raises(DeviceNotFoundError, match="no program listens"):
        opened(tmp_path / "missing")
    for query in ("?cpu=one", "?seed=1"):
        with pytest.raises(ConfigError, match="cpu"):
            opened(tmp_path / "missing", query)


def test_a_loop_shares_its_device_s_processor_by_default(tmp_path: Path, listener: Any) -> None:
    link = opened(tmp_path / "silent", "?cpu=3")
    assert host_beside(Scheduling(), link).cpu == 3
    assert host_beside(Scheduling(cpu=1), link).cpu == 1
    link.close()


@pytest.mark.exhaustive(
    "tests/rig/devices/test_devices_table.py::test_a_device_process_is_that_of_its_url_and_ends_with_its_context"
)
def test_a_plain_script_may_start_one(tmp_path: Path) -> None:
    """The script has no `if __name__ == "__main__"`: the child must not run it again."""
    need_compiler()
    script = tmp_path / "mine.py"
    script.write_text(
        "from rig.config import presets, rig_model\n"
        "from rig.devices.local import serve_locally\n"
        "print('once')\n"
        "with serve_locally('sim://', rig_model(presets.load('koul-rigid')), realtime='off') as url:\n"
        "    print(url.partition(':')[0])\n"
    )
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert (done.stdout.split(), done.stderr) == (["once", "unix"], "")
