"""Third-party libraries operate the simulated drives: the maker's own for a moteus, `odrive-can` for an ODrive.

ODrive's maker has no Python library for CAN Simple; `odrive-can` contains the maker's description (DBC, of 0.6.10).
"""

import asyncio
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import tty
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from sim_backend.drives import simulated_drive
from sim_backend.drives.bus import Frame
from sim_backend.drives.can_simple import CanSimpleCommand, Error
from sim_backend.drives.socket_can import CLASSIC_BYTES, REMOTE
from tests.conformance.drives import CAN_FRAME, NAN, Moteus, Odrive, drive_rig
from tests.conformance.started import WAIT_S, started

TORQUE = {"position": NAN, "velocity": 0.0, "kp_scale": 0.0, "kd_scale": 0.0, "ilimit_scale": 0.0}
FREE = {
    "axis0.controller.config.enable_torque_mode_vel_limit": "0",
    "axis0.controller.config.enable_overspeed_error": "0",
}


def request(path: str, line: bytes, enough: bytes) -> bytes:
    """Send a line to a serial port and return the reply up to `enough`."""
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(port)
        os.write(port, line)
        reply, until = b"", time.monotonic() + WAIT_S
        while enough not in reply and time.monotonic() < until:
            readable, _, _ = select.select([port], [], [], 0.1)
            reply += os.read(port, 4096) if readable else b""
        return reply
    finally:
        os.close(port)


@pytest.mark.exhaustive("::test_its_codec_reads_each_of_our_replies_as_we_meant_it")
def test_a_moteus_is_driven_by_one_host_after_the_other_and_by_its_makers_library() -> None:
    with simulated_drive("moteus", drive_rig()) as drive:
        for _ in range(2):
            assert request(drive.path, b"can send 8001 1100\n", b"2100") == b"OK\r\nrcv 00000100 210000\r\n"
        moteus = pytest.importorskip("moteus")
        asyncio.run(asyncio.wait_for(moteus_session(moteus, drive.path), WAIT_S))


async def moteus_session(moteus: Any, path: str) -> None:
    """Configure the drive, command it, let its watchdog expire, and stop it."""
    transport = moteus.Fdcanusb(path)
    drive = moteus.Controller(id=1, transport=transport)
    register, mode = moteus.Register, moteus.Mode
    try:
        stopped = (await drive.set_stop(query=True)).values
        assert (stopped[register.MODE], stopped[register.FAULT]) == (mode.STOPPED, 0)
        assert stopped[register.VOLTAGE] == 24.0

        console = moteus.Stream(drive, use_flow_control=True)
        await console.command(b"conf set servo.timeout_mode 0")
        assert await console.command(b"conf get servo.timeout_mode", allow_any_response=True) == b"0"
        with pytest.raises(moteus.CommandError, match="unknown group"):
            await console.command(b"conf get unknown.name")

        velocity, until = 0.0, time.monotonic() + WAIT_S
        while velocity <= 0.1 and time.monotonic() < until:
            values = (await drive.set_position(**TORQUE, feedforward_torque=0.02, query=True)).values
            velocity = values[register.VELOCITY]
        assert velocity > 0.1
        assert values[register.MODE] == mode.POSITION
        assert values[register.TORQUE] == pytest.approx(0.02)

        await asyncio.sleep(0.15)  # beyond servo.default_timeout_s
        late = (await drive.set_position(**TORQUE, feedforward_torque=0.02, query=True)).values
        assert (late[register.MODE], late[register.TORQUE]) == (mode.TIMEOUT, 0.0)
        await drive.set_stop()
        assert (await drive.query()).values[register.MODE] == mode.STOPPED
    finally:
        transport.close()


def test_its_codec_reads_each_of_our_replies_as_we_meant_it() -> None:
    moteus = pytest.importorskip("moteus")
    multiplex, protocol = import_module("moteus.multiplex"), import_module("moteus.protocol")
    drive = Moteus()
    drive.start()
    drive.torque(0.05)
    drive.wait(0.05)
    exact = {register: drive.read(register) for register in (1, 2, 3, 0x00D, 0x00E)}
    tolerance = {multiplex.INT8: 0.51, multiplex.INT16: 0.11, multiplex.INT32: 0.0011, multiplex.F32: 0.0}
    for kind, error in tolerance.items():
        resolution = moteus.QueryResolution()
        for name in ("mode", "position", "velocity", "torque", "voltage", "temperature", "fault"):
            setattr(resolution, name, kind)
        command = moteus.Controller(id=1, query_resolution=resolution, transport=object()).make_query()
        answer = drive.send(command.data)
        values = protocol.parse_reply(answer)
        assert values[moteus.Register.MODE] == moteus.Mode.POSITION
        for register, value in exact.items():
            assert values[register] == pytest.approx(value, abs=error)


def test_its_command_to_stay_within_is_a_wall_of_its_gains() -> None:
    """The library's `make_stay_within` is sent to a drive that stands a tenth of a turn beyond the bound."""
    moteus = pytest.importorskip("moteus")
    drive = Moteus(drive_rig(coulomb=1.0))  # friction holds it
    drive.start()
    host = moteus.Controller(id=1, transport=object())
    wall = {
        "lower_bound": NAN,
        "upper_bound": -0.1,
        "kp_scale": 0.5,
        "kd_scale": 1.0,
        "watchdog_timeout": NAN,
    }
    for feedforward, most, expected in ((0.0, 1.0, -0.2), (0.05, 1.0, -0.15), (0.0, 0.1, -0.1)):
        command = host.make_stay_within(**wall, feedforward_torque=feedforward, maximum_torque=most)
        drive.send(command.data)
        drive.wait(0.001)
        assert drive.read(0) == 13
        assert drive.read(0x03A) == pytest.approx(expected, abs=1e-4)  # kp = 4 N·m/turn, half of it
    drive.send(host.make_stay_within(**{**wall, "upper_bound": 0.1}, feedforward_torque=0.0).data)
    drive.wait(0.001)
    assert drive.read(0x03A) == 0.0


class Described:
    """A simulated ODrive whose messages are encoded by the names in its maker's description (DBC)."""

    def __init__(self, drive: Odrive) -> None:
        odrive_can = pytest.importorskip("odrive_can")
        self.base = odrive_can.get_dbc()
        self.drive = drive

    def send(self, name: str, **fields: Any) -> None:
        message = self.base.get_message_by_name(f"Axis0_{name}")
        self.drive.drive.receive(Frame(message.frame_id, message.encode(fields)))

    def ask(self, name: str) -> dict[str, Any]:
        message = self.base.get_message_by_name(f"Axis0_{name}")
        (answer,) = self.drive.drive.receive(Frame(message.frame_id, b"", remote=True))
        return dict(message.decode(answer.data))


def test_the_messages_are_those_of_the_makers_description() -> None:
    drive = Described(Odrive(settings=FREE))
    drive.send("Set_Controller_Mode", Control_Mode="TORQUE_CONTROL", Input_Mode="PASSTHROUGH")
    drive.send("Set_Axis_State", Axis_Requested_State="CLOSED_LOOP_CONTROL")
    drive.send("Set_Input_Torque", Input_Torque=0.05)
    drive.drive.wait(0.05)
    assert drive.ask("Heartbeat")["Axis_State"] == "CLOSED_LOOP_CONTROL"
    assert drive.ask("Get_Torques")["Torque_Estimate"] == pytest.approx(0.05)
    assert drive.ask("Get_Iq")["Iq_Measured"] == pytest.approx(1.0)
    estimates = drive.ask("Get_Encoder_Estimates")
    assert estimates["Vel_Estimate"] == pytest.approx(2.0 * estimates["Pos_Estimate"] / 0.05, rel=0.1)
    assert drive.ask("Get_Bus_Voltage_Current")["Bus_Voltage"] == 24.0
    assert drive.ask("Get_Temperature")["FET_Temperature"] == 25.0
    version = drive.ask("Get_Version")
    assert (version["Fw_Version_Major"], version["Fw_Version_Minor"]) == (0, 6)
    drive.send("Estop")
    drive.drive.wait(0.001)
    assert drive.ask("Heartbeat")["Axis_Error"] == "ESTOP_REQUESTED"
    assert drive.ask("Get_Error")["Disarm_Reason"] == "ESTOP_REQUESTED"
    drive.send("Clear_Errors", Identify=0)
    assert drive.ask("Get_Error")["Disarm_Reason"] == "NONE"


def test_each_error_has_the_name_that_the_maker_gives_its_bit() -> None:
    description = Described(Odrive()).base
    signal = description.get_message_by_name("Axis0_Get_Error").get_signal_by_name("Active_Errors")
    for error in Error:
        assert str(signal.choices[int(error)]) == error.name


def receive(host: socket.socket, identifier: int) -> bytes:
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        frame = host.recv(CLASSIC_BYTES)
        if struct.unpack_from("=I", frame) == (identifier,):
            return frame
    raise AssertionError(f"no frame {identifier:x}")


@pytest.mark.exhaustive("::test_the_messages_are_those_of_the_makers_description")
def test_an_odrive_is_on_a_bus_of_several_hosts(tmp_path: Path) -> None:
    place = str(tmp_path / "bus")
    command = ("-m", "sim_backend.drives", "odrive", "--rig", "koul-rigid", "--bus", place)
    with started(sys.executable, *command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == place
        one, two = (socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2))
        with one, two:
            for host in (one, two):
                host.settimeout(WAIT_S)
                host.connect(place)
            receive(two, CanSimpleCommand.HEARTBEAT)  # it is on the bus
            question = CAN_FRAME.pack(REMOTE | CanSimpleCommand.GET_VERSION, 0, b"")
            one.send(question)
            assert receive(one, CanSimpleCommand.GET_VERSION)[12:15] == bytes((0, 6, 11))
            assert receive(two, REMOTE | CanSimpleCommand.GET_VERSION) == question
        process.send_signal(signal.SIGTERM)
        assert process.wait(WAIT_S) == 0
    assert not Path(place).exists()
