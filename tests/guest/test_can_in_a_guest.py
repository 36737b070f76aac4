"""SocketCAN by the kernel's own driver: simulated drives on a virtual CAN interface, a host on another socket."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from sim_backend.drives.can_simple import Command
from sim_backend.drives.process import serve
from tests.conformance.drives import drive_rig
from tests.guest.boot import BUSYBOX

pytestmark = pytest.mark.skipif(not os.path.exists("/sys/module/vcan"), reason="no vcan here: run .ci/guest")

FD_MTU = 72  # include/uapi/linux/can.h: an interface that passes frames of CAN FD too
WAIT_S = 60.0  # an emulated processor loads the kernels
FREE = {
    "axis0.controller.config.enable_torque_mode_vel_limit": "0",
    "axis0.controller.config.enable_overspeed_error": "0",
}


@contextmanager
def on_the_bus(kind: str, interface: str, **options: object) -> Iterator[socket.socket]:
    """An interface with a drive on it, and a host's socket."""
    words = (
        ("add", interface, "type", "vcan"),
        ("set", interface, "mtu", str(FD_MTU)),
        ("set", interface, "up"),
    )
    for command in words:
        subprocess.run([BUSYBOX, "ip", "link", *command], check=True)
    there, stop = threading.Event(), threading.Event()
    options |= {"place": interface, "stop": stop, "announce": lambda _: there.set()}
    drive = threading.Thread(target=serve, args=(kind, drive_rig()), kwargs=options)
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


def send(host: socket.socket, command: Command, form: str, *values: float) -> None:
    """Send a message to node 0."""
    data = struct.pack("<" + form, *values)
    host.send(struct.pack("=IB3x8s", command, len(data), data))


def heard(host: socket.socket, command: Command, form: str) -> tuple[float, ...]:
    """The next message of a kind."""
    while True:
        identifier, _, data = struct.unpack("=IB3x8s", host.recv(16))
        if identifier == command:
            return struct.unpack("<" + form, data)


def test_an_odrive_is_driven_over_the_kernels_own_can() -> None:
    with on_the_bus("odrive", "vcan0", settings=FREE) as host:
        assert heard(host, Command.HEARTBEAT, "IBBBx")[:2] == (0, 1)
        host.send(struct.pack("=IB3x8s", socket.CAN_RTR_FLAG | Command.GET_VERSION, 0, b""))
        assert heard(host, Command.GET_VERSION, "8B")[4:7] == (0, 6, 11)
        send(host, Command.SET_CONTROLLER_MODE, "II", 1, 1)
        send(host, Command.SET_AXIS_STATE, "I", 8)
        send(host, Command.SET_INPUT_TORQUE, "f", 0.02)
        until = time.monotonic() + WAIT_S
        velocity = 0.0
        while velocity <= 0.1 and time.monotonic() < until:
            _, velocity = heard(host, Command.GET_ENCODER_ESTIMATES, "ff")
        assert velocity > 0.1
        send(host, Command.ESTOP, "")
        while (beat := heard(host, Command.HEARTBEAT, "IBBBx"))[1] != 1:
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
