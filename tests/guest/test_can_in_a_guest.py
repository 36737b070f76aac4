"""Simulated drives and a host on Linux's CAN driver, in a virtual machine that `.ci/guest` starts: vcan needs root."""

import os
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace

import pytest

from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.extras.drives import moteus, odrive
from rig.extras.drives.bus import CanBus, open_bus
from rig.extras.drives.faults import DriveFault
from rig.extras.drives.library import Bridge, FittedDrive
from sim_backend.drives.can_simple import AxisState, CanSimpleCommand
from sim_backend.drives.process import serve
from sim_backend.drives.socket_can import FD_BYTES
from tests.conformance.bridged import MOTEUS_SETUP, ODRIVE_SETUP, bridged_rig, endpoints
from tests.guest.boot import BUSYBOX

pytestmark = pytest.mark.skipif(not os.path.exists("/sys/module/vcan"), reason="no vcan here: run .ci/guest")

RATE_HZ = 50
WAIT_S = 60.0  # an emulated processor loads the compiled functions slowly
SLOW_ODRIVE_SETUP = {odrive.ENCODER_MS: "20", odrive.TORQUES_MS: "20", odrive.WATCHDOG_S: "0.05"}
IDLE = struct.pack("<I", AxisState.IDLE)


def ip_link(*words: str) -> None:
    subprocess.run([BUSYBOX, "ip", "link", *words], check=True)


@contextmanager
def served_drive(
    kind: str, interface: str, model: RigModel, settings: dict[str, str]
) -> Iterator[socket.socket]:
    """Serve a drive on a new interface in a thread; yield the socket of a host."""
    ip_link("add", interface, "type", "vcan")
    ip_link("set", interface, "mtu", str(FD_BYTES))  # the interface transmits frames of CAN FD, too
    ip_link("set", interface, "up")
    announced, stop = threading.Event(), threading.Event()
    options = {"place": interface, "stop": stop, "announce": lambda _: announced.set(), "settings": settings}
    drive = threading.Thread(target=serve, args=(kind, model), kwargs=options)
    host = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    host.settimeout(WAIT_S)
    host.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    host.bind((interface,))
    drive.start()
    try:
        assert announced.wait(WAIT_S)
        yield host
    finally:
        stop.set()
        drive.join(WAIT_S)
        host.close()
    assert not drive.is_alive()


def find_drive(kind: str, bus: CanBus, model: RigModel) -> FittedDrive:
    """Find a drive; its measured response time is that of the emulated processor and is not used."""
    if kind == "moteus":
        return moteus.fit(moteus.find(moteus.MoteusConversation(bus, 1), 1), model)
    facts = odrive.find(odrive.OdriveConversation(bus, 0, endpoints()))
    return odrive.fit(replace(facts, quickest_s=0.0), model)


@pytest.mark.parametrize("interface_lost", [False, True])
@pytest.mark.parametrize(
    ("kind", "settings", "stop_frame"),
    [
        # Lower byte of the identifier, first bytes; for drive 1: write 0 (stopped) to register 0 (mode)
        ("moteus", MOTEUS_SETUP, (0x01, bytes.fromhex("010000"))),
        ("odrive", ODRIVE_SETUP | SLOW_ODRIVE_SETUP, (CanSimpleCommand.SET_AXIS_STATE, IDLE)),
    ],
)
def test_a_bridge_on_the_kernels_own_can(
    kind: str, settings: dict[str, str], stop_frame: tuple[int, bytes], interface_lost: bool
) -> None:
    """The bridge receives samples; at its end it sends the stop, or reports that the interface is lost."""
    # An interface persists after its test, so each test has its own; a name has at most 15 characters.
    model, interface = bridged_rig(), f"{'lost' if interface_lost else 'stop'}-{kind}"
    with served_drive(kind, interface, model, settings) as host:
        bus = open_bus(DeviceUrl(kind, interface, {}, f"{kind}://{interface}"))
        with closing(bus):
            assert isinstance(bus, CanBus)
            bridge = Bridge(model, find_drive(kind, bus, model), socket=True, rate=RATE_HZ)
            with running(bridge, bus):
                wait_until(lambda: bridge.facts.replies > 10)
                take_waiting_frames(host)  # discard them: the stop needs room in the receive buffer
                if interface_lost:
                    ip_link("set", interface, "down")
                    wait_until(lambda: bridge.fault != 0)
            if interface_lost:
                # On a slow emulator the drive may time out before the interface is lost.
                assert bridge.fault in {DriveFault.BUS_LOST, DriveFault.DRIVE_SILENT}
            else:
                _, data = stop_frame
                starts = {(frame[0], frame[8 : 8 + len(data)]) for frame in take_waiting_frames(host)}
                assert stop_frame in starts


def take_waiting_frames(host: socket.socket) -> list[bytes]:
    frames = []
    host.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            frames.append(host.recv(FD_BYTES))
    return frames


@contextmanager
def running(bridge: Bridge, bus: CanBus) -> Iterator[None]:
    """Run a bridge in a thread until the block ends; its host is silent."""
    bridge_end, host_end = socket.socketpair()
    wake_read, wake_write = os.pipe()
    bridge_end.setblocking(False)
    ends = {"host": bridge_end.fileno(), "bus": bus.descriptor, "wake": wake_read, "host_stays": True}
    thread = threading.Thread(target=bridge.run, kwargs=ends)
    thread.start()
    try:
        yield
    finally:
        os.write(wake_write, b"x")
        thread.join(WAIT_S)
        for end in (bridge_end, host_end):
            end.close()
        os.close(wake_read)
        os.close(wake_write)


def wait_until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)
