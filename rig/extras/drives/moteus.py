"""Identify a moteus, read its settings, and check what is required before a handle is mounted on it.

Source: mjbots/moteus (firmware 1.1.0, register map 5), opened: docs/protocol/{can,registers,diagnostic}.md,
docs/reference/configuration.md, fw/bldc_servo_structs.h and fw/motor_position.h for names and meaning of settings,
fw/bldc_servo.cc for the torque constant.
"""

import math
import re
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from rig.core.errors import ConfigError, DeviceNotFoundError, DeviceRefusedError, IncompatibleDeviceError
from rig.core.model import RigModel
from rig.extras.drives.drive_law import DriveLaw
from rig.extras.drives.fitting import Difference, Output, refuse
from rig.extras.drives.library import FittedDrive, Switches

if sys.platform == "linux":
    from rig.extras.drives.bus import Bus, CanFrame

assert sys.platform == "linux"

SENDER = 0x10  # ours, see moteus.h
# Bit 15 of the identifier asks the drive for an answer; its sender is in bits 8 to 14.
REPLY = 0x8000
REGISTER_MAP = 5
LISTEN_S = 0.05  # for others on the bus, before the first frame
REPLY_S, TRIES = 0.2, 3
REST_S = 0.1  # longer than the drive's command timeout, at most 50 ms
LINE_S = 2.0  # for an answer of the diagnostic channel
DIAGNOSTIC_BYTES = 48
TORQUE_FACTOR = 1.5 / math.sqrt(3.0) * 60.0 / (2.0 * math.pi)  # N·m/A times Kv, from fw/bldc_servo.cc
STEPS_PER_TURN = 65536  # resolution of the reported position, fw/motor_position.h
SOURCE_KINDS = (
    "none",
    "SPI",
    "UART",
    "quadrature",
    "Hall",
    "index",
    "sine-cosine",
    "I2C",
    "sensorless",
    "BiSS-C",
)
# Registers (docs/protocol/registers.md): mode, fault, firmware version, register map; pins as inputs, by port.
MODE, FAULT, VERSION, MAP_VERSION = 0x000, 0x00F, 0x101, 0x102
AUX = {1: 0x05E, 2: 0x05F}
STOPPED, FAULTED, TIMED_OUT = 0, 1, 11
MODES = {5: "PWM", 6: "voltage", 7: "voltage FOC", 8: "voltage DQ", 9: "current", 10: "position"} | {
    2: "preparing",
    3: "preparing",
    4: "preparing",
    12: "zero velocity",
    13: "stay within",
    15: "brake",
}


class Asked(Protocol):
    """Interface (`typing.Protocol`) of a drive whose registers and settings can be read."""

    def register(self, number: int) -> int:
        """Return the value of a register as an integer."""
        ...

    def setting(self, name: str) -> float:
        """Return the value of the setting with a dotted name, such as ``servo.max_velocity``."""
        ...


class MoteusConversation:
    """Requests to one moteus and its replies, before a bridge (program on this computer that commands the drive) runs.

    `drive` is the id of the drive on the bus, `prefix` its setting ``can.prefix``.
    """

    def __init__(self, bus: Bus, drive: int, prefix: int = 0) -> None:
        self._bus, self._drive, self._prefix = bus, drive, prefix

    @property
    def _name(self) -> str:
        return f"the moteus {self._drive} at {self._bus.place}"

    def refuse_others(self) -> None:
        """Listen for `LISTEN_S` (s); raise `DeviceRefusedError` if another host communicates with the drive."""
        deadline = time.monotonic() + LISTEN_S
        while (left := deadline - time.monotonic()) > 0:
            frame = self._bus.receive(left)
            if frame is None:
                return
            if self._drive in (frame.id & 0x7F, frame.id >> 8 & 0x7F):
                raise DeviceRefusedError(
                    f"another program communicates with {self._name}: a second bus master",
                    remedy="close tview, moteus_tool and other programs on this bus",
                )

    def stop(self) -> None:
        """Send the stop command: it switches the motor off, and clears the timeout state after an expired watchdog."""
        self._send(b"\x01\x00\x00", reply=False)

    def register(self, number: int) -> int:
        """Return the value of a register; raise `DeviceNotFoundError` without a reply."""
        address = bytes([number]) if number < 0x80 else bytes([number & 0x7F | 0x80, number >> 7])
        data = self.asked(b"\x19" + address, lambda data: data.startswith(b"\x29" + address))
        (value,) = struct.unpack_from("<i", data, 1 + len(address))
        return int(value)

    def setting(self, name: str) -> float:
        """Return the value of a setting (``conf get``); raise `IncompatibleDeviceError` if the drive lacks it."""
        line = f"conf get {name}\n".encode()
        for at in range(0, len(line), DIAGNOSTIC_BYTES):
            part = line[at : at + DIAGNOSTIC_BYTES]
            self._send(bytes([0x40, 1, len(part)]) + part, reply=False)
        text = self._line()
        try:
            return float(text)
        except ValueError:
            raise IncompatibleDeviceError(
                f"{self._name} has no setting {name}: {text!r}",
                remedy="update its firmware to 1.1 or later: python -m moteus.moteus_tool --flash",
            ) from None

    def asked(self, request: bytes, is_answer: Callable[[bytes], bool]) -> bytes:
        """Send a request up to `TRIES` times, and return the data of the first reply that `is_answer` accepts.

        Raises `DeviceNotFoundError` without a reply, or for replies from other ids only.
        """
        others: set[int] = set()
        for _ in range(TRIES):
            self._send(request, reply=True)
            deadline = time.monotonic() + REPLY_S
            while (left := deadline - time.monotonic()) > 0:
                frame = self._bus.receive(left)
                if frame is None:
                    break
                source = frame.id >> 8 & 0x7F
                if frame.id == self._prefix << 16 | self._drive << 8 | SENDER and is_answer(frame.data):
                    return frame.data
                if source != self._drive:
                    others.add(source)
        found = f"; ids that replied on this bus: {', '.join(map(str, sorted(others)))}" if others else ""
        raise DeviceNotFoundError(
            f"no reply from {self._name}{found}",
            remedy="check its power, the wiring and its id (moteus_tool --info); give the id as ?id=NUMBER",
        )

    def _send(self, data: bytes, *, reply: bool) -> None:
        sender = self._prefix << 16 | SENDER << 8 | self._drive
        self._bus.send(CanFrame(sender | (REPLY if reply else 0), data))

    def _line(self) -> str:
        line, deadline = b"", time.monotonic() + LINE_S
        while b"\n" not in line and time.monotonic() < deadline:
            reply = self.asked(bytes([0x42, 1, DIAGNOSTIC_BYTES]), lambda data: data.startswith(b"\x41\x01"))
            line += reply[3 : 3 + reply[2]]
        return line.decode("ascii", "replace").strip()


@dataclass(frozen=True, slots=True, kw_only=True)
class MoteusFacts:
    """What a bridge (firmware on this computer in front of a drive) must know about a moteus.

    Attributes
    ----------
    id, firmware
        Id on the bus; version, such as 1.1.0.
    mode, fault
        Registers 0x000 and 0x00f.
    counts, source
        Counts per turn of the output's encoder, and its kind.
    on_rotor, rotor_to_output
        True if the encoder is on the rotor; turns of the output for one turn of the rotor.
    torque_constant
        Torque constant of the rotor (N·m/A); 0 if the motor is not calibrated.
    most_current, most_speed
        ``servo.max_current_A`` (A), ``servo.max_velocity`` (turns/s of the output).
    minimum, maximum
        ``servopos.position_min`` and ``_max`` (turns of the output), NaN for none.
    law
        Settings with which the drive renders a wall itself.
    """

    id: int
    firmware: str
    mode: int
    fault: int
    counts: int
    source: str
    on_rotor: bool
    rotor_to_output: float
    torque_constant: float
    most_current: float
    most_speed: float
    minimum: float
    maximum: float
    law: DriveLaw

    @property
    def counts_per_turn(self) -> float:
        """Encoder counts per turn of the output."""
        return self.counts / self.rotor_to_output if self.on_rotor else float(self.counts)

    @property
    def output(self) -> Output:
        """Properties of the drive's output shaft."""
        return Output(
            kind="moteus",
            encoder=self.source,
            counts=self.counts,
            counts_per_turn=self.counts_per_turn,
            torque_constant=self.torque_constant / self.rotor_to_output,
            most_current=self.most_current,
            most_speed=self.most_speed,
            minimum=self.minimum,
            maximum=self.maximum,
            encoder_setting="motor_position.output.source",
            scale_setting="motor.Kv",
            current_setting="servo.max_current_A",
            scale_remedy="calibrate again",
        )


class RequiredSetting(NamedTuple):
    """A value that a setting must have: nan or 0, as text for the drive, and what happens otherwise."""

    value: str
    why: str

    def accepts(self, value: float) -> bool:
        """Return True if a setting has the required value."""
        return math.isnan(value) if self.value == "nan" else value == float(self.value)


# Settings that would add a torque of their own, or take some away, and the values that do not.
REQUIRED = {
    "servo.timeout_mode": RequiredSetting(
        "0",
        "after a timeout of this computer's commands the drive would brake or hold instead of giving zero torque",
    ),
    "servo.voltage_mode_control": RequiredSetting("0", "the drive would not apply the commanded torque"),
    "servo.fixed_voltage_mode": RequiredSetting("0", "the drive would not apply the commanded torque"),
    "servo.inertia_feedforward": RequiredSetting("0", "the drive would add torque to the commanded one"),
    "servo.fault_position_error": RequiredSetting(
        "nan", "the drive would stop with a fault when the handle moves"
    ),
    "servo.fault_velocity_error": RequiredSetting(
        "nan", "the drive would stop with a fault when the handle moves"
    ),
}


def find(talk: MoteusConversation, drive: int) -> MoteusFacts:
    """Read the settings of a moteus, and refuse settings with which it would not execute torque commands as sent.

    Raise `IncompatibleDeviceError` if the firmware has another register map, `DeviceRefusedError` if another host
    commands the drive, it has a fault, or a setting would change the torque.
    """
    talk.refuse_others()
    version, registers = talk.register(VERSION), talk.register(MAP_VERSION)
    firmware = f"{version >> 16 & 0xFF}.{version >> 8 & 0xFF}.{version & 0xFF}"
    if registers != REGISTER_MAP:
        raise IncompatibleDeviceError(
            f"the moteus {drive} has firmware {firmware} with register map {registers}; this package supports "
            f"register map {REGISTER_MAP}",
            remedy="update its firmware (python -m moteus.moteus_tool --flash), or this package",
        )
    mode = _mode_at_rest(talk)
    _refuse_mode(drive, mode, talk.register(FAULT))
    for name, required in REQUIRED.items():
        value = talk.setting(name)
        if not required.accepts(value):
            raise DeviceRefusedError(
                f"the moteus {drive} has {name} = {value:g}: {required.why}",
                remedy=f"set it: in tview, conf set {name} {required.value}, then conf write",
            )
    return _facts(talk, drive, firmware, mode)


def _mode_at_rest(talk: MoteusConversation) -> int:
    # After a killed bridge the drive keeps its mode until its watchdog expires; a stop then ends the time-out mode.
    deadline = time.monotonic() + REST_S
    while (mode := talk.register(MODE)) not in (STOPPED, FAULTED) and time.monotonic() < deadline:
        if mode == TIMED_OUT:
            talk.stop()
        time.sleep(REST_S / 20.0)
    return mode


def _refuse_mode(drive: int, mode: int, fault: int) -> None:
    if mode == FAULTED:
        raise DeviceRefusedError(
            f"the moteus {drive} has stopped with fault {fault}",
            remedy="look the fault up (docs/protocol/registers.md of moteus, 0x00f), remove its cause, then power it "
            "off and on",
        )
    if mode != STOPPED:
        name = MODES.get(mode, "unknown")
        raise DeviceRefusedError(
            f"the moteus {drive} is in mode {mode} ({name}): another program drives it",
            remedy="end that program; in tview: d stop",
        )


def _facts(talk: Asked, drive: int, firmware: str, mode: int) -> MoteusFacts:
    source = int(talk.setting("motor_position.output.source"))
    place = f"motor_position.sources.{source}"
    kind = int(talk.setting(f"{place}.type"))
    kv = talk.setting("motor.Kv") if talk.setting("motor.poles") > 0 else 0.0
    return MoteusFacts(
        id=drive,
        firmware=firmware,
        mode=mode,
        fault=0,
        counts=int(talk.setting(f"{place}.cpr")),
        source=SOURCE_KINDS[kind] if 0 <= kind < len(SOURCE_KINDS) else f"kind {kind}",
        on_rotor=int(talk.setting(f"{place}.reference")) == 0,
        rotor_to_output=talk.setting("motor_position.rotor_to_output_ratio"),
        torque_constant=TORQUE_FACTOR / kv if kv > 0.0 else 0.0,
        most_current=talk.setting("servo.max_current_A"),
        most_speed=talk.setting("servo.max_velocity"),
        minimum=talk.setting("servopos.position_min"),
        maximum=talk.setting("servopos.position_max"),
        law=DriveLaw.read(talk.setting, place),
    )


def switches_of(texts: Mapping[str, str]) -> Switches:
    """Read the hold and stop switches from texts like ``{"hold": "aux1.2"}``: a port of the drive, and a pin's bit.

    Raises `ConfigError` for a text of another form, and for switches on two ports.
    """
    ports, bits = set(), {"hold": 0, "stop": 0}
    for name, text in texts.items():
        match = re.fullmatch(r"aux(?P<port>[12])\.(?P<bit>[0-4])", text)
        if match is None:
            raise ConfigError(
                f"{name} = {text!r} is not a pin",
                remedy="give aux1 or aux2, a dot and a bit from 0 to 4, for example aux1.2",
            )
        ports.add(AUX[int(match["port"])])
        bits[name] = 1 << int(match["bit"])
    if len(ports) > 1:
        raise ConfigError(
            "the hold-to-run switch and the stop switch are on different ports of the drive",
            remedy="wire both to pins of aux1, or both to pins of aux2",
        )
    return Switches(ports.pop() if ports else 0, bits["hold"], bits["stop"])


def fit(
    found: MoteusFacts, model: RigModel, *, prefix: int = 0, switches: Switches | None = None
) -> FittedDrive:
    """Compare a moteus with an experiment's rig; return what a bridge (firmware for the drive) must know about it.

    Raises `DeviceRefusedError` if calibration, gear or wiring differ from the experiment; the error has a sentence for
    each difference.
    """
    refuse(_differences(found, model))
    transmission = found.output.transmission(model)
    return FittedDrive(
        kind="moteus",
        firmware=f"moteus {found.firmware}",
        id=found.id,
        prefix=prefix,
        counts_per_turn=found.counts_per_turn,
        transmission=transmission,
        ranges=found.output.ranges(model),
        settings={
            "drive": "moteus",
            "drive_id": found.id,
            "drive_firmware": found.firmware,
            "drive_encoder": found.source,
            "drive_counts": found.counts,
            "rotor_to_output": found.rotor_to_output,
            "torque_constant": found.torque_constant,
            "transmission": transmission,
            **found.law.describe(transmission),
        },
        gains=found.law.gains,
        switches=switches or Switches(),
    )


def _differences(found: MoteusFacts, model: RigModel) -> Iterator[Difference]:
    if found.torque_constant == 0.0:
        yield "the motor is not calibrated (motor.poles or motor.Kv is 0)", "run moteus_tool --calibrate"
        return
    if found.source in ("none", "index", "sensorless", "Hall"):
        yield (
            f"the output's encoder is {found.source}, which does not measure the position",
            "set motor_position.output.source to an encoder",
        )
    if not found.rotor_to_output > 0.0 or found.counts <= 0:
        yield (
            f"rotor_to_output_ratio = {found.rotor_to_output:g} and cpr = {found.counts}: both must be above 0",
            "configure the drive's encoder",
        )
        return
    if found.counts_per_turn > STEPS_PER_TURN:
        yield (
            f"the drive reports its position in {STEPS_PER_TURN} steps per turn, too coarse for its encoder's "
            f"{found.counts_per_turn:.0f} counts per turn of the output",
            "use an encoder at the output, or a motor without a gear",
        )
    yield from found.output.differences(model)
