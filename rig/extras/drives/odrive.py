"""Identify an ODrive, read its settings, and check what is required before a handle is mounted on it.

Source: the description of the messages of 0.6.10 (DBC) that the package odrive-can carries;
odriverobotics/ODriveResources, examples/can_param_access.py and can_watchdog.py; names of parameters from odrive
0.6.11. That its own encoder has 2¹⁴ counts is assumed.
"""

import json
import math
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Self

from rig.core.errors import ConfigError, DeviceNotFoundError, DeviceRefusedError, IncompatibleDeviceError
from rig.core.model import RigModel
from rig.core.regular_file import TABLE_BYTES, read_regular
from rig.extras.drives.fitting import Difference, Output, refuse
from rig.extras.drives.library import FittedDrive

if sys.platform == "linux":
    from rig.extras.drives.bus import Bus, CanFrame

assert sys.platform == "linux"

COMMAND_BITS = 5
GENERATION = (0, 6)  # of the firmware
LISTEN_S = 0.05  # for others on the bus, before the first frame
REPLY_S, TRIES = 0.2, 3
REST_S = 0.1  # longer than the drive's watchdog, at most 50 ms
LONGEST_WATCHDOG_S = 0.05  # the same as in the firmware of this project
WATCHED_PERIODS = 2.0  # periods without a command before the watchdog expires, at least
LONGEST_CYCLE_MS, LONGEST_BEAT_MS = 20, 10
FLOAT = 1e-6  # relative tolerance for values sent as float32
ONBOARD_COUNTS = 16384
INCREMENTAL, ONBOARD = 1, 13  # odrive.enums.EncoderId
WHERE_TO_GET = (
    "take the flat_endpoints.json of your drive's firmware and board from docs.odriverobotics.com/releases/firmware, "
    "and name it in the URL: ?endpoints=FILE"
)
FORMS = {
    "bool": "?",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "float": "f",
}


class OdriveCommand(IntEnum):
    """Commands (lower five bits of a CAN id) of the messages that this module requests or receives."""

    GET_VERSION = 0x00
    HEARTBEAT = 0x01
    RX_SDO = 0x04
    TX_SDO = 0x05


# Message ids that a host sends to a drive; the same set as `is_command` in odrive.c.
COMMANDS = {0x02, 0x04, 0x07, *range(0x0B, 0x14), 0x16, *range(0x18, 0x1C)}
IDLE, CLOSED_LOOP = 1, 8
WATCHDOG_EXPIRED = 0x01000000

_CONFIG, _CONTROLLER = "axis0.config", "axis0.controller.config"
ENCODER_MS = f"{_CONFIG}.can.encoder_msg_rate_ms"
TORQUES_MS = f"{_CONFIG}.can.torques_msg_rate_ms"
HEARTBEAT_MS = f"{_CONFIG}.can.heartbeat_msg_rate_ms"
WATCHDOG, WATCHDOG_S = f"{_CONFIG}.enable_watchdog", f"{_CONFIG}.watchdog_timeout"
VELOCITY_LIMITED = f"{_CONTROLLER}.enable_torque_mode_vel_limit"
OVERSPEED = f"{_CONTROLLER}.enable_overspeed_error"
VELOCITY, TOLERANCE = f"{_CONTROLLER}.vel_limit", f"{_CONTROLLER}.vel_limit_tolerance"
ENCODER, COUNTS, BANDWIDTH = (
    f"{_CONFIG}.load_encoder",
    "inc_encoder0.config.cpr",
    f"{_CONFIG}.encoder_bandwidth",
)
TORQUE_CONSTANT = f"{_CONFIG}.motor.torque_constant"
CURRENT = f"{_CONFIG}.motor.current_soft_max"
LEAST_TORQUE, MOST_TORQUE = f"{_CONFIG}.torque_soft_min", f"{_CONFIG}.torque_soft_max"
READ = (
    *(
        ENCODER_MS,
        TORQUES_MS,
        HEARTBEAT_MS,
        WATCHDOG,
        WATCHDOG_S,
        VELOCITY_LIMITED,
        OVERSPEED,
        VELOCITY,
        TOLERANCE,
    ),
    *(ENCODER, COUNTS, BANDWIDTH, TORQUE_CONSTANT, CURRENT, LEAST_TORQUE, MOST_TORQUE),
)


class RequiredParameter(NamedTuple):
    """A parameter, a test of all values (true if it is right), the value to set, and what a wrong one does."""

    path: str
    is_right: Callable[[Mapping[str, float]], bool]
    wanted: str
    why: str


# Settings that would leave a torque, or change one, or report too little, and what they should be.
REQUIRED = (
    RequiredParameter(
        WATCHDOG,
        lambda values: values[WATCHDOG] == 1,
        "True",
        "the last torque would persist when this computer stops sending",
    ),
    RequiredParameter(
        WATCHDOG_S,
        lambda values: 0.0 < values[WATCHDOG_S] <= LONGEST_WATCHDOG_S * (1.0 + FLOAT),
        "0.005",
        "the last torque would persist for this time when this computer stops sending; "
        f"allowed: above 0, at most {LONGEST_WATCHDOG_S:g} s",
    ),
    RequiredParameter(
        VELOCITY_LIMITED,
        lambda values: values[VELOCITY_LIMITED] == 0,
        "False",
        "it would reduce the commanded torque",
    ),
    RequiredParameter(
        ENCODER_MS,
        lambda values: 1 <= values[ENCODER_MS] <= LONGEST_CYCLE_MS,
        "1",
        f"the drive sends its position too rarely or not at all; allowed: 1 to {LONGEST_CYCLE_MS} ms",
    ),
    RequiredParameter(
        TORQUES_MS,
        lambda values: values[TORQUES_MS] == values[ENCODER_MS],
        f"odrv0.{ENCODER_MS}",
        f"it must equal {ENCODER_MS}, since each position needs a measured torque",
    ),
    RequiredParameter(
        HEARTBEAT_MS,
        lambda values: 1 <= values[HEARTBEAT_MS] <= max(LONGEST_BEAT_MS, values[ENCODER_MS]),
        f"{LONGEST_BEAT_MS}",
        f"heartbeats show that the drive has stopped; allowed: 1 to {LONGEST_BEAT_MS} ms, or to {ENCODER_MS} if longer",
    ),
    RequiredParameter(
        ENCODER,
        lambda values: values[ENCODER] in (ONBOARD, INCREMENTAL),
        f"{ONBOARD}",
        f"this encoder is not supported; allowed: {ONBOARD} (onboard encoder) and {INCREMENTAL} (incremental encoder)",
    ),
)


@dataclass(frozen=True, slots=True)
class Endpoints:
    """Numbers and types of a firmware's parameters, by their path, such as ``axis0.config.enable_watchdog``.

    `place` is the file that lists them, for the version `firmware`; `by_path` has number and `struct` format of each.
    """

    place: str
    firmware: str
    by_path: Mapping[str, tuple[int, struct.Struct]]

    @classmethod
    def load(cls, place: str) -> Self:
        """Read the manufacturer's file; raise `ConfigError` if it is not a valid ``flat_endpoints.json``."""
        try:
            return cls.of(place, json.loads(read_regular(place, TABLE_BYTES)))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ConfigError(
                f"{place} is not an ODrive's flat_endpoints.json: {error!r}", remedy=WHERE_TO_GET
            ) from None

    @classmethod
    def of(cls, place: str, content: Mapping[str, Any]) -> Self:
        """Read the parameters from the content of a ``flat_endpoints.json``; `place` is its path."""
        found = {
            path: (int(one["id"]), struct.Struct("<" + FORMS[one["type"]]))
            for path, one in content["endpoints"].items()
            if one["type"] in FORMS
        }
        return cls(place, str(content["fw_version"]), found)


class OdriveConversation:
    """Requests to one ODrive and its replies, before a bridge (firmware on this computer in front of a drive) runs.

    `node` is the drive's id on the CAN bus; `endpoints` are the parameters of its firmware. `quickest_s` is the
    shortest round-trip time so far (s).
    """

    def __init__(self, bus: Bus, node: int, endpoints: Endpoints) -> None:
        self._bus, self.node, self.endpoints = bus, node, endpoints
        self._others: set[int] = set()
        self.quickest_s = math.inf

    @property
    def name(self) -> str:
        """Name of the drive for messages, such as "the ODrive 0 at can0"."""
        return f"the ODrive {self.node} at {self._bus.place}"

    def refuse_others(self) -> None:
        """Listen for `LISTEN_S` (s); raise `DeviceRefusedError` if another host sends commands to the drive."""
        deadline = time.monotonic() + LISTEN_S
        while (left := deadline - time.monotonic()) > 0:
            reply = self._bus.receive(left)
            if reply is None:
                return
            node, command = reply.id >> COMMAND_BITS, reply.id & (1 << COMMAND_BITS) - 1
            if node == self.node and command in COMMANDS:
                raise DeviceRefusedError(
                    f"another program sends commands to {self.name}: a second bus master",
                    remedy="end the other programs on this bus",
                )
            self._others.add(node)

    def request(self, command: OdriveCommand) -> bytes:
        """Request a message from the drive; return its 8 bytes, or raise `DeviceNotFoundError` without a reply."""
        frame = CanFrame(self.node << COMMAND_BITS | command, b"", classic=True, remote=True)
        return self._request(frame, command, lambda data: len(data) == 8)

    def parameter(self, path: str) -> float:
        """Return the value of a parameter; raise `IncompatibleDeviceError` if the firmware has no such path."""
        found = self.endpoints.by_path.get(path)
        if found is None:
            raise IncompatibleDeviceError(
                f"{self.endpoints.place} has no parameter {path}",
                remedy="update the drive's firmware to 0.6.10 or later, with the file of that version",
            )
        number, form = found
        question = struct.pack("<BHB", 0, number, 0)
        frame = CanFrame(self.node << COMMAND_BITS | OdriveCommand.RX_SDO, question, classic=True)
        answer = self._request(
            frame,
            OdriveCommand.TX_SDO,
            lambda data: data[1:3] == question[1:3] and len(data) >= 4 + form.size,
        )
        return float(form.unpack_from(answer, 4)[0])

    def _request(
        self, question: CanFrame, command: OdriveCommand, is_answer: Callable[[bytes], bool]
    ) -> bytes:
        for _ in range(TRIES):
            self._bus.send(question)
            asked = time.monotonic()
            while (left := asked + REPLY_S - time.monotonic()) > 0:
                reply = self._bus.receive(left)
                if reply is None:
                    break
                if reply.id == self.node << COMMAND_BITS | command and is_answer(reply.data):
                    self.quickest_s = min(self.quickest_s, time.monotonic() - asked)
                    return reply.data
                self._others.add(reply.id >> COMMAND_BITS)
        others = sorted(self._others - {self.node})
        found = f"; nodes seen on this bus: {', '.join(map(str, others))}" if others else ""
        raise DeviceNotFoundError(
            f"no reply from {self.name}{found}",
            remedy="check its power, bit rate, wiring, protocol (CAN Simple) and node id; give the id as ?id=NUMBER",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class OdriveFacts:
    """What a bridge (firmware on this computer in front of a drive) must know about an ODrive.

    `id` is the node id of the drive, `firmware` its version, such as 0.6.11; `values` are its parameters, by path;
    `quickest_s` is the shortest round-trip time (s).
    """

    id: int
    firmware: str
    values: Mapping[str, float]
    quickest_s: float

    @property
    def output(self) -> Output:
        """Properties of the drive's shaft."""
        values = self.values
        onboard = values[ENCODER] == ONBOARD
        constant = values[TORQUE_CONSTANT]
        most_torque = min(values[MOST_TORQUE], -values[LEAST_TORQUE], values[CURRENT] * constant)
        counts = ONBOARD_COUNTS if onboard else int(values[COUNTS])
        return Output(
            kind="odrive",
            encoder="onboard" if onboard else "incremental",
            counts=counts,
            counts_per_turn=float(counts),
            torque_constant=constant,
            most_current=most_torque / constant,
            most_speed=values[VELOCITY] * max(values[TOLERANCE], 1.0) if values[OVERSPEED] else math.inf,
            encoder_setting=ENCODER,
            scale_setting=TORQUE_CONSTANT,
            current_setting="current_soft_max and torque_soft_max",
            scale_remedy=f"correct {TORQUE_CONSTANT} of the drive",
        )


def find(talk: OdriveConversation) -> OdriveFacts:
    """Read the settings of an ODrive, and refuse settings with which it would not execute torque commands as sent.

    Raise `IncompatibleDeviceError` if the firmware is not 0.6 or the endpoints are for another version,
    `DeviceRefusedError` if another host commands the drive, it has an error, or settings would drop or change a torque;
    the error lists all of them.
    """
    talk.refuse_others()
    version = tuple(talk.request(OdriveCommand.GET_VERSION)[4:7])
    firmware = ".".join(map(str, version))
    if version[:2] != GENERATION:
        raise IncompatibleDeviceError(
            f"{talk.name} has firmware {firmware}; this package supports CAN Simple of firmware 0.6",
            remedy="update its firmware (odrivetool dfu); boards that cannot run 0.6 are not supported",
        )
    if firmware != talk.endpoints.firmware:
        raise IncompatibleDeviceError(
            f"{talk.name} has firmware {firmware}, but {talk.endpoints.place} is for {talk.endpoints.firmware}, whose "
            "parameters have other numbers",
            remedy=WHERE_TO_GET,
        )
    error = _error_at_rest(talk)
    values = {path: talk.parameter(path) for path in READ}
    refuse(
        (
            f"{talk.name} has {one.path} = {values[one.path]:g}: {one.why}",
            f"set odrv0.{one.path} = {one.wanted}, then save_configuration()",
        )
        for one in REQUIRED
        if not one.is_right(values)
    )
    if error & ~WATCHDOG_EXPIRED:
        raise DeviceRefusedError(
            f"{talk.name} has stopped with the error 0x{error:08x}",
            remedy="see dump_errors(odrv0) in odrivetool, remove the cause, then odrv0.clear_errors()",
        )
    return OdriveFacts(id=talk.node, firmware=firmware, values=values, quickest_s=talk.quickest_s)


def _error_at_rest(talk: OdriveConversation) -> int:
    # A killed bridge leaves the drive in closed loop until the drive's own watchdog expires.
    deadline = time.monotonic() + REST_S
    while True:
        error, state, _ = struct.unpack_from("<IBB", talk.request(OdriveCommand.HEARTBEAT))
        if state == IDLE:
            return int(error)
        if time.monotonic() > deadline:
            break
        time.sleep(REST_S / 20.0)
    what = (
        "closed loop: another program drives it"
        if state == CLOSED_LOOP
        else "a procedure such as calibration"
    )
    raise DeviceRefusedError(
        f"{talk.name} is in state {state} ({what}); it must be idle",
        remedy="end that program or procedure; with odrivetool: odrv0.axis0.requested_state = AxisState.IDLE",
    )


def fit(found: OdriveFacts, model: RigModel) -> FittedDrive:
    """Compare an ODrive with an experiment's rig; return what a bridge (firmware for the drive) must know about it.

    Raises `DeviceRefusedError` if scale, wiring or limits differ from the experiment; the error has a sentence for each
    difference.
    """
    refuse(_differences(found, model))
    values, output = found.values, found.output
    cycle_ms, transmission = int(values[ENCODER_MS]), output.transmission(model)
    fastest = 1000 // cycle_ms
    slowest = math.ceil(WATCHED_PERIODS / values[WATCHDOG_S] * (1.0 - FLOAT))
    return FittedDrive(
        kind="odrive",
        firmware=f"ODrive {found.firmware}",
        id=found.id,
        counts_per_turn=output.counts_per_turn,
        transmission=transmission,
        ranges={**output.ranges(model), "position_rate": (min(slowest, fastest), fastest)},
        settings={
            "drive": "odrive",
            "drive_id": found.id,
            "drive_firmware": found.firmware,
            "drive_encoder": output.encoder,
            "drive_counts": output.counts,
            "drive_cycle_ms": cycle_ms,
            "drive_watchdog_s": round(values[WATCHDOG_S], 6),
            "encoder_bandwidth": values[BANDWIDTH],
            "torque_constant": output.torque_constant,
            "transmission": transmission,
        },
        rate_maximum=fastest,
        cycle_us=1000 * cycle_ms,
        beat_us=1000 * int(values[HEARTBEAT_MS]),
    )


def _differences(found: OdriveFacts, model: RigModel) -> Iterator[Difference]:
    values = found.values
    if not values[TORQUE_CONSTANT] > 0.0 or not found.output.counts > 0:
        yield (
            f"the motor is not set up: torque_constant = {values[TORQUE_CONSTANT]:g}, cpr = {values[COUNTS]:g} (of an "
            "incremental encoder); these must be above 0",
            "calibrate the motor",
        )
        return
    half_s = 0.5e-3 * values[ENCODER_MS]
    if found.quickest_s > half_s:
        yield (
            f"the round trip to the drive takes {1e3 * found.quickest_s:.2g} ms; allowed: at most {1e3 * half_s:g} ms, "
            "half of encoder_msg_rate_ms",
            "set odrv0.can.config.baud_rate = 1000000 and the same rate at the interface, or a longer "
            "encoder_msg_rate_ms",
        )
    if values[WATCHDOG_S] < WATCHED_PERIODS * 1e-3 * values[ENCODER_MS] * (1.0 - FLOAT):
        yield (
            f"the drive's watchdog expires after {1e3 * values[WATCHDOG_S]:g} ms, less than "
            f"{WATCHED_PERIODS:g} times encoder_msg_rate_ms",
            f"set odrv0.{WATCHDOG_S} to five times encoder_msg_rate_ms",
        )
    yield from found.output.differences(model)
