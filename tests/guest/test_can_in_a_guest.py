"""SocketCAN by the kernel's own driver: simulated drives on a virtual CAN interface, a host on another socket."""

from __future__ import annotations

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
from sim_backend.drives.can_simple import CanSimpleCommand
from sim_backend.drives.process import serve
from tests.conformance.bridged import SAFE, WATCHED, bridged_rig, endpoints
from tests.conformance.drives import drive_rig
from tests.guest.boot import BUSYBOX

pytestmark = pytest.mark.skipif(not os.path.exists("/sys/module/vcan"), reason="no vcan here: run .ci/guest")

FD_MTU = 72  # include/uapi/linux/can.h: an interface that passes frames of CAN FD too
RATE = 50  # Hz
SLOWLY = {odrive.ENCODER_MS: "20", odrive.TORQUES_MS: "20", odrive.WATCHDOG_S: "0.05"}
WAIT_S = 60.0  # an emulated processor loads the kernels
FREE = {
    "axis0.controller.config.enable_torque_mode_vel_limit": "0",
    "axis0.controller.config.enable_overspeed_error": "0",
}


def ip_link(*words: str) -> None:
    subprocess.run([BUSYBOX, "ip", "link", *words], check=True)


@contextmanager
def on_the_bus(
    kind: str, interface: str, *, model: RigModel | None = None, **options: object
) -> Iterator[socket.socket]:
    """Serve a drive on a new interface; give the socket of a host."""
    ip_link("add", interface, "type", "vcan")
    ip_link("set", interface, "mtu", str(FD_MTU))
    ip_link("set", interface, "up")
    there, stop = threading.Event(), threading.Event()
    options |= {"place": interface, "stop": stop, "announce": lambda _: there.set()}
    drive = threading.Thread(target=serve, args=(kind, model or drive_rig()), kwargs=options)
    host = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    host.settimeout(WAIT_S)
    host.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    host.bind((interface,))
    drive.start()
    try:
        assert there.wait(WAIT_S)
        yield host
    finally:
        stop.set()
        drive.join(WAIT_S)
        host.close()
    assert not drive.is_alive()


def send(host: socket.socket, command: CanSimpleCommand, form: str, *values: float) -> None:
    """Send a message to node 0."""
    data = struct.pack("<" + form, *values)
    host.send(struct.pack("=IB3x8s", command, len(data), data))


def receive(host: socket.socket, command: CanSimpleCommand, form: str) -> tuple[float, ...]:
    while True:
        identifier, _, data = struct.unpack("=IB3x8s", host.recv(16))
        if identifier == command:
            return struct.unpack("<" + form, data)


def test_an_odrive_is_driven_over_the_kernels_own_can() -> None:
    with on_the_bus("odrive", "vcan0", settings=FREE) as host:
        assert receive(host, CanSimpleCommand.HEARTBEAT, "IBBBx")[:2] == (0, 1)
        host.send(struct.pack("=IB3x8s", socket.CAN_RTR_FLAG | CanSimpleCommand.GET_VERSION, 0, b""))
        assert receive(host, CanSimpleCommand.GET_VERSION, "8B")[4:7] == (0, 6, 11)
        send(host, CanSimpleCommand.SET_CONTROLLER_MODE, "II", 1, 1)
        send(host, CanSimpleCommand.SET_AXIS_STATE, "I", 8)
        send(host, CanSimpleCommand.SET_INPUT_TORQUE, "f", 0.02)
        until = time.monotonic() + WAIT_S
        velocity = 0.0
        while velocity <= 0.1 and time.monotonic() < until:
            _, velocity = receive(host, CanSimpleCommand.GET_ENCODER_ESTIMATES, "ff")
        assert velocity > 0.1
        send(host, CanSimpleCommand.ESTOP, "")
        while (beat := receive(host, CanSimpleCommand.HEARTBEAT, "IBBBx"))[1] != 1:
            assert time.monotonic() < until
        assert beat[0] == 0x02000000


def test_a_moteus_answers_in_frames_of_can_fd() -> None:
    with on_the_bus("moteus", "vcan1") as host:
        query = bytes.fromhex("1404001f0d505050")  # int16 from 0, four registers; float from 13, three
        host.send(struct.pack("=IBB2x64s", socket.CAN_EFF_FLAG | 0x8001, len(query), 1, query))
        identifier, size, _, data = struct.unpack("=IBB2x64s", host.recv(72))
        assert (identifier, size) == (0x0100, 32)
        assert data[:3] == bytes.fromhex("240400")
        assert struct.unpack_from("<f", data, 13) == (24.0,)
        assert data[25:32] == b"\x50" * 7


def found(kind: str, bus: CanBus, model: RigModel) -> FittedDrive:
    """Find a drive; its response time is that of the emulated processor and is not used."""
    if kind == "moteus":
        return moteus.fit(moteus.find(moteus.MoteusConversation(bus, 1), 1), model)
    facts = odrive.find(odrive.OdriveConversation(bus, 0, endpoints()))
    return odrive.fit(replace(facts, quickest_s=0.0), model)


@pytest.mark.parametrize(
    ("kind", "settings", "end"),
    [
        ("moteus", SAFE, (0x01, bytes.fromhex("010000"))),  # to drive 1: mode 0
        ("odrive", WATCHED | SLOWLY, (CanSimpleCommand.SET_AXIS_STATE, bytes((1, 0, 0, 0)))),  # idle
    ],
)
def test_a_bridge_on_the_kernels_own_can(kind: str, settings: dict[str, str], end: tuple[int, bytes]) -> None:
    """The bridge receives the samples, sends the stop at its end, and reports a lost interface."""
    model, interface = bridged_rig(), f"bridge-{kind}"
    with on_the_bus(kind, interface, model=model, settings=settings) as other:
        bus = open_bus(DeviceUrl(kind, interface, {}, f"{kind}://{interface}"))
        with closing(bus):
            assert isinstance(bus, CanBus)
            drive = found(kind, bus, model)
            for goes in (False, True):  # without a lost interface the bridge sends the stop
                bridge = Bridge(model, drive, socket=True, rate=RATE)
                with running(bridge, bus):
                    wait_until(lambda bridge=bridge: bridge.facts.replies > 10)
                    waiting_frames(other, 0)  # make room for the stop
                    if goes:
                        ip_link("set", interface, "down")
                        wait_until(lambda bridge=bridge: bridge.fault != 0)
                assert goes or end in waiting_frames(other, len(end[1]))
            slow = DriveFault.DRIVE_SILENT  # an emulated processor may be, before it went
            assert bridge.fault in {DriveFault.BUS_LOST, slow}


def waiting_frames(host: socket.socket, size: int) -> set[tuple[int, bytes]]:
    """Return the lower byte of the identifier and the first bytes of all waiting frames."""
    frames = []
    host.setblocking(False)
    with suppress(BlockingIOError):
        while True:
            frames.append(host.recv(FD_MTU))
    return {(frame[0], frame[8 : 8 + size]) for frame in frames}


@contextmanager
def running(bridge: Bridge, bus: CanBus) -> Iterator[None]:
    """Run a bridge in a thread, without a host, until the block ends."""
    ours, host = socket.socketpair()
    ear, mouth = os.pipe()
    ours.setblocking(False)
    ends = {"host": ours.fileno(), "bus": bus.descriptor, "wake": ear, "host_stays": True}
    thread = threading.Thread(target=bridge.run, kwargs=ends)
    thread.start()
    try:
        yield
    finally:
        os.write(mouth, b"x")
        thread.join(WAIT_S)
        for end in (ours, host):
            end.close()
        os.close(ear)
        os.close(mouth)


def wait_until(true: Callable[[], bool]) -> None:
    until = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < until
        time.sleep(0.02)
