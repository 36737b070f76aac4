"""A bridge as a process in real time: the link that starts it, the command, and zero torque after either is killed."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.connection import State
from rig import devices
from rig.core.errors import ConfigError, DeviceRefusedError, LinkLostError
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.extras.drives import describe, odrive
from rig.extras.drives.address import address_of
from rig.extras.drives.bus import CanBus, _connect
from rig.extras.drives.library import Bridge
from rig.extras.drives.link import BridgeLink
from rig.extras.drives.serve import look
from sim_backend.drives.process import serve as serve_drive
from tests.conformance.bridged import MOTEUS_SETUP, ODRIVE_SETUP, bridged_rig, plain_drive, write_endpoints
from tests.conformance.host import RUN_PARAMETERS
from tests.conformance.started import WAIT_S

# The tick rate (Hz) is low because a simulated drive is a program, and this computer may be busy.
SLOW_RUN_PARAMETERS = {**RUN_PARAMETERS, "position_rate": 100}


@contextmanager
def served_drive(kind: str, settings: dict[str, str], bus: str | None = None) -> Iterator[str]:
    """Serve a simulated drive from a thread; yield its bus, or its port if no bus is given."""
    places, stop = SimpleQueue[str](), threading.Event()
    options = {"place": bus, "settings": settings, "stop": stop, "announce": places.put}
    drive = threading.Thread(target=serve_drive, args=(kind, bridged_rig()), kwargs=options)
    drive.start()
    try:
        yield places.get(timeout=WAIT_S)
    finally:
        stop.set()
        drive.join(WAIT_S)


@pytest.fixture(scope="module")
def port() -> Iterator[str]:
    with served_drive("moteus", MOTEUS_SETUP) as served:
        yield served


def open_armed(url: str) -> FramedDevice:
    """Open and arm a device; open it again if the simulated drive was late, as it may be on a busy machine."""
    until = time.monotonic() + WAIT_S
    while True:
        device = devices.open_device(url, bridged_rig())
        try:
            device.configure(SLOW_RUN_PARAMETERS)
            device.arm()
            return device
        except DeviceRefusedError:
            device.close()
            if time.monotonic() > until:
                raise


def test_a_link_starts_a_bridge_and_one_that_is_killed_is_a_lost_link(port: str) -> None:
    with open_armed(f"moteus://{port}") as device:
        assert isinstance(device.link, BridgeLink)
        assert device.dictionary.firmware == "bridge to moteus 1.0.0"
        assert not device.dictionary.simulated
        while device.link.bus_facts()["replies"] <= 20:
            assert device.states(0.3)
        os.kill(device.link.process, signal.SIGKILL)
        with pytest.raises(LinkLostError):
            device.states(WAIT_S)


@pytest.mark.exhaustive("::test_a_link_starts_a_bridge_and_one_that_is_killed_is_a_lost_link")
def test_the_next_bridge_accepts_the_drive_of_one_that_was_killed_and_ends_with_its_link(port: str) -> None:
    """The drive's own watchdog ended the torque."""
    with open_armed(f"moteus://{port}") as device:
        os.kill(device.link.process, signal.SIGKILL)  # type: ignore[attr-defined]
    with ThreadPoolExecutor() as threads:  # the thread that opens it ends here
        device = threads.submit(open_armed, f"moteus://{port}").result()
    with device:
        assert isinstance(device.link, BridgeLink)
        bridge = device.link.process
        device.disarm(clear_fault=True)
    assert not Path(f"/proc/{bridge}").exists()


def test_closing_a_link_hangs_up_and_waits_for_its_bridge(monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[bytes] = []

    @contextmanager
    def bridge(serve: object, url: object, model: object, host: int, *_: int, **__: object) -> Iterator[Any]:
        with socket.socket(fileno=os.dup(host)) as end:
            yield SimpleNamespace(drive=None, messages=None, process=0)
            received.append(end.recv(1, socket.MSG_DONTWAIT))

    monkeypatch.setattr("rig.extras.drives.link.start_announced", bridge)
    BridgeLink(DeviceUrl.parse("moteus:///dev/none"), bridged_rig()).close()
    assert received == [b""]


def test_a_drive_on_a_can_bus_is_asked_by_its_frames(tmp_path: Path) -> None:
    bus = str(tmp_path / "bus")
    with served_drive("moteus", MOTEUS_SETUP, bus):
        found = look(DeviceUrl("moteus", bus, {}, f"moteus://{bus}"))
    assert (found.counts, found.source) == (4 * 4096, "SPI")


@pytest.mark.exhaustive(
    "tests/extras/drives/test_bridge_core.py::test_a_bridge_that_is_killed_leaves_it_to_the_watchdog_of_the_drive"
)
def test_an_odrive_gets_no_torque_when_its_bridge_is_killed(tmp_path: Path) -> None:
    """A link starts its bridge on a bus; after the kill the drive's own watchdog ends the torque."""
    bus, file = str(tmp_path / "bus"), write_endpoints(tmp_path / "flat_endpoints.json")
    slow = ODRIVE_SETUP | {odrive.WATCHDOG_S: "0.05", odrive.ENCODER_MS: "10", odrive.TORQUES_MS: "10"}
    url = f"odrive://{bus}?endpoints={file}"
    with served_drive("odrive", slow, bus), open_armed(url) as device:
        assert isinstance(device.link, BridgeLink)
        assert device.dictionary.firmware == "bridge to ODrive 0.6.11"
        assert len(device.states(0.3)) > 5
        facts = device.link.bus_facts()
        assert (facts["cycle_us"], facts["temperature"]) == (10_000, 25)
        watching = CanBus(bus, _connect(bus))
        os.kill(device.link.process, signal.SIGKILL)
        until, state = time.monotonic() + WAIT_S, 8
        while state != 1 and time.monotonic() < until:
            frame = watching.receive(WAIT_S)
            if frame is not None and frame.id == odrive.OdriveCommand.HEARTBEAT:
                state = frame.data[4]
        assert state == 1
        watching.close()
        with pytest.raises(LinkLostError):
            device.states(WAIT_S)


def test_a_host_that_is_gone_ends_its_bridge_and_stops_the_drive() -> None:
    """The kernel closes the socket of a host even if it is killed."""
    bus, drive = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near, host = socket.socketpair()
    ear, mouth = os.pipe()
    for end in (bus, near):
        end.setblocking(False)
    bridge = Bridge(bridged_rig(), plain_drive(), socket=True)
    ends = {"host": near.fileno(), "bus": bus.fileno(), "wake": ear, "host_stays": False}
    running = threading.Thread(target=bridge.run, kwargs=ends)
    running.start()
    assert drive.recv(100)[8:10] == b"\x11\x00"  # a query without a command
    host.close()
    running.join(WAIT_S)
    assert not running.is_alive()
    bus.close()
    frames = list(iter(lambda: drive.recv(100), b""))
    assert [frame[8:11] for frame in frames[-3:]] == [b"\x01\x00\x00"] * 3  # mode: stopped
    for end in (near, drive):
        end.close()
    os.close(ear)
    os.close(mouth)


@pytest.mark.exhaustive("::test_a_link_starts_a_bridge_and_one_that_is_killed_is_a_lost_link")
def test_a_link_reports_the_refusal_of_its_bridge(port: str) -> None:
    model = bridged_rig()
    other = replace(model, amplifier=replace(model.amplifier, effort_per_ampere=1.0))
    with pytest.raises(DeviceRefusedError, match="the experiment has 1"):
        devices.open_device(f"moteus://{port}", other)
    with pytest.raises(ConfigError, match="the URL names no rig"):
        devices.open_device(f"moteus://{port}")
    with pytest.raises(ConfigError, match="whole number"):
        address_of(DeviceUrl.parse(f"moteus://{port}?id=nine"))


@pytest.mark.exhaustive("::test_a_link_starts_a_bridge_and_one_that_is_killed_is_a_lost_link")
def test_the_command_serves_one_host_after_the_other(port: str, tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(describe.text(look(DeviceUrl("moteus", port, {}, port)), f"moteus://{port}"))
    bridge = subprocess.Popen(
        [sys.executable, "-m", "rig", "serve", "moteus", port, "--rig", str(mine)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert bridge.stdout is not None
    try:
        url = bridge.stdout.readline().strip()
        for _ in range(2):
            with devices.open_device(url) as device:
                assert device.dictionary.device == "moteus-1"
                assert device.connection.state >= State.IDENTIFIED
    finally:
        bridge.send_signal(signal.SIGINT)
        bridge.stdout.close()
        assert bridge.wait(WAIT_S) == 0
