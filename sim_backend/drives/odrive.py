"""Simulate an ODrive: it receives and sends CAN Simple messages, and its shaft moves a simulated rig.

It follows the page manual/can-protocol of docs.odriverobotics.com for firmware 0.6 and, for the parts of that page that
could not be read, the maker's programs in odriverobotics/ODriveResources. `odrive_law` computes a control cycle.
`process` serves it.
"""

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from sim_backend.drives.bus import Frame
from sim_backend.drives.can_simple import (
    ADDRESS,
    COMMAND_BITS,
    ERRORS,
    FEED_FORWARD_STEP,
    FLOATS,
    FORMS,
    HEARTBEAT,
    READ,
    SDO,
    WRITE,
    AxisState,
    CanSimpleCommand,
    Error,
    Result,
)
from sim_backend.drives.motor import Motor
from sim_backend.drives.odrive_law import CLOSED_LOOP, IDLE, POSITION_CONTROL, RATE_HZ, WORDS, W, law

FIRMWARE = (0, 6, 11)
HARDWARE = (4, 4, 58)  # product line, version, variant: an ODrive Pro (odrive 0.6.11, data/odrive-v4.4.json)
PROTOCOL = 2  # version of CAN Simple: the maker's example reads it and compares nothing
ONBOARD_COUNTS = 16384  # counts per turn of the absolute encoder on the board
REBOOT, SAVE, ERASE = range(3)  # actions of the message REBOOT: ODriveArduino, src/ODriveCAN.h
TICKS_A_MS = RATE_HZ // 1000
_FOREVER = 1 << 62  # a tick that never comes

Value = float | int | bool
_STRUCT_FORMAT = {"bool": "?", "uint8": "B", "uint32": "I", "float": "f"}


class _Parameter(NamedTuple):
    """A parameter of an ODrive; `word` is the index of the word of the law's memory that has its value."""

    kind: str
    default: Value
    word: int | None = None


# Parameters by path. Defaults: Firmware/MotorControl/*.hpp of ODrive 0.5.6, where 0.6 has the name.
_PARAMETERS = {
    "axis0.config.can.node_id": _Parameter("uint32", 0),
    "axis0.config.can.heartbeat_msg_rate_ms": _Parameter("uint32", 100),
    "axis0.config.can.encoder_msg_rate_ms": _Parameter("uint32", 10),
    "axis0.config.can.error_msg_rate_ms": _Parameter("uint32", 0),
    "axis0.config.can.iq_msg_rate_ms": _Parameter("uint32", 0),
    "axis0.config.can.temperature_msg_rate_ms": _Parameter("uint32", 0),
    "axis0.config.can.bus_voltage_msg_rate_ms": _Parameter("uint32", 0),
    "axis0.config.can.torques_msg_rate_ms": _Parameter("uint32", 0),
    "axis0.config.enable_watchdog": _Parameter("bool", False, W.enable_watchdog),
    "axis0.config.watchdog_timeout": _Parameter("float", 0.0, W.watchdog_timeout),
    "axis0.config.encoder_bandwidth": _Parameter("float", 1000.0, W.bandwidth),
    "axis0.config.load_encoder": _Parameter("uint8", 13),  # EncoderId.ONBOARD_ENCODER0; 1: INC_ENCODER0
    "axis0.config.commutation_encoder": _Parameter("uint8", 13),
    "axis0.config.torque_soft_min": _Parameter("float", -math.inf, W.torque_soft_min),
    "axis0.config.torque_soft_max": _Parameter("float", math.inf, W.torque_soft_max),
    "axis0.config.motor.torque_constant": _Parameter("float", 0.04, W.torque_constant),
    "axis0.config.motor.current_soft_max": _Parameter("float", 10.0, W.current_soft_max),
    "axis0.controller.config.control_mode": _Parameter("uint8", POSITION_CONTROL, W.control_mode),
    "axis0.controller.config.input_mode": _Parameter("uint8", 1, W.input_mode),
    "axis0.controller.config.pos_gain": _Parameter("float", 20.0, W.pos_gain),
    "axis0.controller.config.vel_gain": _Parameter("float", 1.0 / 6.0, W.vel_gain),
    "axis0.controller.config.vel_integrator_gain": _Parameter("float", 2.0 / 6.0, W.vel_integrator_gain),
    "axis0.controller.config.vel_integrator_limit": _Parameter("float", math.inf, W.vel_integrator_limit),
    "axis0.controller.config.vel_limit": _Parameter("float", 2.0, W.vel_limit),
    "axis0.controller.config.vel_limit_tolerance": _Parameter("float", 1.2, W.vel_limit_tolerance),
    "axis0.controller.config.vel_ramp_rate": _Parameter("float", 1.0, W.vel_ramp_rate),
    "axis0.controller.config.torque_ramp_rate": _Parameter("float", 0.01, W.torque_ramp_rate),
    "axis0.controller.config.inertia": _Parameter("float", 0.0, W.inertia),
    "axis0.controller.config.input_filter_bandwidth": _Parameter("float", 2.0, W.input_filter_bandwidth),
    "axis0.controller.config.enable_vel_limit": _Parameter("bool", True, W.enable_vel_limit),
    "axis0.controller.config.enable_overspeed_error": _Parameter("bool", True, W.enable_overspeed_error),
    "axis0.controller.config.enable_torque_mode_vel_limit": _Parameter(
        "bool", True, W.enable_torque_mode_vel_limit
    ),
    "inc_encoder0.config.cpr": _Parameter("uint32", 8192),
}
_SAVE = "save_configuration"
# The numbers of endpoints differ between firmwares, and the maker publishes them as ``flat_endpoints.json``: these are
# the simulation's own, in a file of the same form (`SimulatedOdrive.flat_endpoints`).
_IDS = {path: number for number, path in enumerate((*_PARAMETERS, _SAVE), start=1)}
_PATHS = {number: path for path, number in _IDS.items()}
_ENCODER, _COUNTS = "axis0.config.load_encoder", "inc_encoder0.config.cpr"
_INCREMENTAL, _ONBOARD = 1, 13  # odrive.enums.EncoderId

# Message that the drive sends unrequested: the parameter that contains its period (ms; 0: never).
_PERIODS = {
    CanSimpleCommand.HEARTBEAT: "axis0.config.can.heartbeat_msg_rate_ms",
    CanSimpleCommand.GET_ENCODER_ESTIMATES: "axis0.config.can.encoder_msg_rate_ms",
    CanSimpleCommand.GET_ERROR: "axis0.config.can.error_msg_rate_ms",
    CanSimpleCommand.GET_IQ: "axis0.config.can.iq_msg_rate_ms",
    CanSimpleCommand.GET_TEMPERATURE: "axis0.config.can.temperature_msg_rate_ms",
    CanSimpleCommand.GET_BUS_VOLTAGE_CURRENT: "axis0.config.can.bus_voltage_msg_rate_ms",
    CanSimpleCommand.GET_TORQUES: "axis0.config.can.torques_msg_rate_ms",
}


@dataclass(frozen=True, slots=True)
class OdriveOptions:
    """State of an ODrive at power-up: saved parameters, version, serial number, supply.

    Attributes
    ----------
    settings
        Saved parameters, by path, that differ from the maker's defaults.
    firmware
        Firmware version: major, minor, revision.
    serial
        Serial number, 48 bits.
    voltage, temperature
        Supply voltage (V) and temperature of the inverter (°C).
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    firmware: tuple[int, int, int] = FIRMWARE
    serial: int = 0x53494D554C41
    voltage: float = 24.0
    temperature: float = 25.0


class SimulatedOdrive:
    """A simulated, calibrated ODrive with its rig, as a `sim_backend.drives.bus.DriveModel`.

    Raise `ConfigError` if the rig is linear, or a setting is not simulated.

    Parameters
    ----------
    model
        Rig to simulate. The drive has the current loop and torque constant of its amplifier. With 2¹⁴ counts per turn
        its encoder is the absolute one on the board, otherwise an incremental one.
    options
        State of the drive at power-up.
    """

    rate_hz = RATE_HZ

    def __init__(self, model: RigModel, options: OdriveOptions = OdriveOptions()) -> None:
        self._words = np.zeros(WORDS)
        self.motor = Motor(model, RATE_HZ, law, self._words)
        self._options = options
        counts = self.motor.counts_per_turn
        self._encoder = _ONBOARD if counts == ONBOARD_COUNTS else _INCREMENTAL
        self.values: dict[str, Value] = {path: each.default for path, each in _PARAMETERS.items()}
        self.values[_COUNTS] = counts
        self.values[_ENCODER] = self.values["axis0.config.commutation_encoder"] = self._encoder
        self._torque_constant = model.amplifier.effort_per_ampere / abs(self.motor.effort_per_torque)
        self.values["axis0.config.motor.torque_constant"] = self._torque_constant
        for path, text in options.settings.items():
            self._set_from_text(path, text)
        self._saved = dict(self.values)
        self.ticks = 0
        self._due: dict[CanSimpleCommand, int] = {}
        self._off_until = 0
        self.power_up()

    def power_up(self) -> None:
        """Restart the drive with its saved parameters: idle, with the position from the encoder."""
        words = self._words
        words[:] = 0.0
        words[W.state] = IDLE
        words[[W.voltage, W.temperature]] = self._options.voltage, self._options.temperature
        self.values = dict(self._saved)
        turns = self.motor.count / self.motor.counts_per_turn
        absolute = self._encoder == _ONBOARD
        words[W.shift] = -math.floor(turns + 0.5) if absolute else -turns
        self._result, self._requested_state = Result.SUCCESS, AxisState.UNDEFINED
        self._configure()
        self._feed_watchdog()
        self._due = dict.fromkeys(_PERIODS, self.ticks + 1)

    # ------------------------------------------------------------------ time

    @property
    def next_due(self) -> int | None:
        """Return the tick of the next unrequested message, or None if all cyclic messages are off."""
        due = [at for command, at in self._due.items() if self.values[_PERIODS[command]]]
        return min(due, default=None)

    def run(self, until: int) -> list[Frame]:
        """Simulate the drive up to tick `until`; return the cyclic messages that it sends meanwhile."""
        sent: list[Frame] = []
        while self.ticks < until:
            due = self.next_due
            stop = until if due is None else min(until, max(due, self.ticks + 1))
            self.motor.run(stop - self.ticks)
            self.ticks = stop
            for command, name in _PERIODS.items():
                period_ms = int(self.values[name])
                if period_ms and self._due[command] <= self.ticks:
                    self._due[command] = self.ticks + period_ms * TICKS_A_MS
                    sent.append(self._reply(command))
        return [] if self._is_off else sent

    @property
    def _is_off(self) -> bool:
        return self.ticks < self._off_until

    @property
    def events(self) -> frozenset[str]:
        """Return the names of the external events that `happen` accepts."""
        return frozenset(self._happenings())

    def happen(self, name: str, value: float) -> list[Frame]:
        """Apply an external event to the drive by name; return the frames that the event puts on the bus.

        Events are ``fault`` (`value`: error bits), the other events of all drives (`Motor.happenings`), ``mode`` (the
        control mode changes), ``master`` (a second host commands a torque of `value` N·m; its frame is on the bus),
        ``estop`` and ``bus-off`` (the drive's CAN controller is off for `value` seconds; 0: for ever).
        """
        return self._happenings()[name](value) or []

    def _happenings(self) -> dict[str, Callable[[float], list[Frame] | None]]:
        return {
            **self.motor.happenings(W, W.watchdog_left, self.power_up),
            "mode": lambda mode: self._write_parameter("axis0.controller.config.control_mode", int(mode)),
            "master": self._second_master,
            "estop": lambda _: self._stop_with_error(Error.ESTOP_REQUESTED),
            "bus-off": self._leave_bus,
        }

    def _second_master(self, torque: float) -> list[Frame]:
        data = FORMS[CanSimpleCommand.SET_INPUT_TORQUE].pack(torque)
        frame = Frame(self._identifier(CanSimpleCommand.SET_INPUT_TORQUE), data)
        self.receive(frame)
        return [frame]

    def _leave_bus(self, seconds: float) -> None:
        self._off_until = self.ticks + round(seconds * RATE_HZ) if seconds else _FOREVER

    # ------------------------------------------------------------------ frames

    @property
    def _node(self) -> int:
        return int(self.values["axis0.config.can.node_id"])

    def _identifier(self, command: CanSimpleCommand) -> int:
        return self._node << COMMAND_BITS | command

    def receive(self, frame: Frame) -> list[Frame]:
        """Process a CAN frame at the present time and return the reply: at most one frame."""
        if self._is_off or frame.extended or frame.identifier >> COMMAND_BITS != self._node:
            return []
        try:
            command = CanSimpleCommand(frame.identifier & (1 << COMMAND_BITS) - 1)
        except ValueError:
            return []
        if command in _REQUESTS:
            # A request is a remote frame, or a data frame without data; with data it is an answer.
            return [self._reply(command)] if frame.remote or not frame.data else []
        if command is CanSimpleCommand.RX_SDO:
            return self._access_parameter(frame.data)
        form = FORMS.get(command)
        if form is not None and len(frame.data) < form.size:
            return []
        self._apply_command(command, form.unpack_from(frame.data) if form is not None else ())
        return []

    def _reply(self, command: CanSimpleCommand) -> Frame:
        return Frame(self._identifier(command), self._payload(command))

    def _payload(self, command: CanSimpleCommand) -> bytes:
        words, kt = self._words, self._words[W.torque_constant]
        if command is CanSimpleCommand.GET_VERSION:
            return bytes((PROTOCOL, *HARDWARE, *self._options.firmware, 0))
        if command is CanSimpleCommand.HEARTBEAT:
            done = int(words[W.control_mode] >= POSITION_CONTROL)
            # Assumed: not checked against ODrive's page.
            errors = int(words[W.active_errors]) | int(words[W.disarm_reason])
            return HEARTBEAT.pack(errors, int(words[W.state]), self._request_result(), done)
        if command is CanSimpleCommand.GET_ERROR:
            return ERRORS.pack(int(words[W.active_errors]), int(words[W.disarm_reason]))
        if command is CanSimpleCommand.ADDRESS:
            return ADDRESS.pack(self._node, self._options.serial.to_bytes(6, "little"), 0)
        power = words[W.torque] * words[W.vel_estimate] * 2.0 * math.pi
        bus_current = power / words[W.voltage] if words[W.voltage] else 0.0
        pairs = {
            CanSimpleCommand.GET_ENCODER_ESTIMATES: (words[W.pos_estimate], words[W.vel_estimate]),
            CanSimpleCommand.GET_IQ: (words[W.torque_target] / kt, words[W.torque] / kt),
            CanSimpleCommand.GET_TEMPERATURE: (words[W.temperature], math.nan),  # no thermistor at the motor
            CanSimpleCommand.GET_BUS_VOLTAGE_CURRENT: (words[W.voltage], bus_current),
            CanSimpleCommand.GET_TORQUES: (words[W.torque_target], words[W.torque]),
            CanSimpleCommand.GET_POWERS: (power, power),
        }
        return FLOATS.pack(*pairs[command])

    def _request_result(self) -> Result:
        if self._requested_state == AxisState.CLOSED_LOOP_CONTROL and self._words[W.state] != CLOSED_LOOP:
            return Result.DISARMED
        return self._result

    def _apply_command(self, command: CanSimpleCommand, values: tuple[Any, ...]) -> None:
        words = self._words
        if command is CanSimpleCommand.SET_AXIS_STATE:
            self._request_state(*values)
        elif command is CanSimpleCommand.SET_INPUT_TORQUE:
            (words[W.input_torque],) = values
        elif command is CanSimpleCommand.SET_INPUT_VEL:
            words[W.input_vel], words[W.input_torque] = values
        elif command is CanSimpleCommand.SET_INPUT_POS:
            words[W.input_pos] = values[0]
            words[[W.input_vel, W.input_torque]] = np.multiply(values[1:], FEED_FORWARD_STEP)
        elif command is CanSimpleCommand.ESTOP:
            self._stop_with_error(Error.ESTOP_REQUESTED)
        elif command is CanSimpleCommand.CLEAR_ERRORS:
            words[[W.active_errors, W.disarm_reason]] = 0.0
            self._feed_watchdog()
        elif command is CanSimpleCommand.REBOOT:
            self._restart(*values)
        elif command is CanSimpleCommand.SET_ABSOLUTE_POSITION:
            words[W.shift] += values[0] - words[W.pos_estimate]
        elif command in _PARAMETERS_OF_COMMAND:
            for path, value in zip(_PARAMETERS_OF_COMMAND[command], values, strict=True):
                self._write_parameter(path, value)
        if command in _FEED_WATCHDOG:
            self._feed_watchdog()

    def _request_state(self, state: int) -> None:
        """Request an axis state (idle or closed loop); reject a calibration, which is not simulated."""
        if state not in {IDLE, CLOSED_LOOP}:
            self._result = Result.INVALID_STATE
            return
        self._result, self._requested_state = Result.SUCCESS, AxisState(state)
        if state == CLOSED_LOOP and self._words[W.state] == IDLE:
            self.motor.begin_session()
        self._words[W.requested] = state

    def _feed_watchdog(self) -> None:
        self._words[W.watchdog_left] = self._words[W.watchdog_timeout]

    def _stop_with_error(self, error: Error) -> None:
        words = self._words
        words[W.active_errors] = int(words[W.active_errors]) | error
        if words[W.state] == CLOSED_LOOP:
            words[W.state], words[W.disarm_reason] = IDLE, error

    def _restart(self, action: int) -> None:
        if action == SAVE:
            self._saved = dict(self.values)
        self.power_up()

    # ------------------------------------------------------------------ parameters

    @staticmethod
    def flat_endpoints(firmware: tuple[int, int, int] = FIRMWARE) -> dict[str, Any]:
        """Return the contents of the maker's flat_endpoints.json: number and type of each parameter by its path."""
        endpoints: dict[str, Any] = {
            path: {"id": _IDS[path], "type": each.kind, "access": "rw"} for path, each in _PARAMETERS.items()
        }
        endpoints[_SAVE] = {"id": _IDS[_SAVE], "type": "function", "inputs": [], "outputs": []}
        return {
            "fw_version": ".".join(map(str, firmware)),
            "hw_version": ".".join(map(str, HARDWARE)),
            "endpoints": endpoints,
        }

    def _access_parameter(self, data: bytes) -> list[Frame]:
        if len(data) < SDO.size:
            return []
        # Order of an access: examples/can_param_access.py of odriverobotics/ODriveResources.
        opcode, number, _ = SDO.unpack_from(data)
        path = _PATHS.get(number)
        if path is None or opcode not in {READ, WRITE}:
            return []
        stored = b""
        if path == _SAVE:
            self._saved = dict(self.values)
        else:
            form = struct.Struct("<" + _STRUCT_FORMAT[_PARAMETERS[path].kind])
            if opcode == WRITE:
                if len(data) < SDO.size + form.size:
                    return []
                (value,) = form.unpack_from(data, SDO.size)
                self._write_parameter(path, value)
            else:
                stored = form.pack(self.values[path])
        if opcode == WRITE and self._options.firmware < FIRMWARE:
            return []  # confirmed from 0.6.11 on
        return [Frame(self._identifier(CanSimpleCommand.TX_SDO), SDO.pack(0, number, 0) + stored)]

    def _set_from_text(self, path: str, text: str) -> None:
        known = _PARAMETERS.get(path)
        try:
            if known is None:
                raise ValueError("the ODrive has no parameter with this name")
            kinds: dict[str, Callable[[str], Value]] = {"float": float, "bool": lambda word: bool(int(word))}
            self.values[path] = kinds.get(known.kind, int)(text)
        except ValueError as error:
            raise ConfigError(
                f"{path} = {text} is not a valid setting of a simulated ODrive: {error}",
                remedy=f"give a value for one of {', '.join(_PARAMETERS)}",
            ) from error

    def _write_parameter(self, path: str, value: Value) -> None:
        self.values[path] = value
        self._configure()

    def _configure(self) -> None:
        words = self._words
        for path, parameter in _PARAMETERS.items():
            if parameter.word is not None:
                words[parameter.word] = self.values[path]
        words[W.motor_constant] = self._torque_constant
        onboard = self.values[_ENCODER] == _ONBOARD
        words[W.counts_per_turn] = ONBOARD_COUNTS if onboard else self.values[_COUNTS]
        words[W.encoder_valid] = self.values[_ENCODER] == self._encoder


_REQUESTS = {*_PERIODS, CanSimpleCommand.GET_VERSION, CanSimpleCommand.ADDRESS, CanSimpleCommand.GET_POWERS}
# What feeds the watchdog: examples/can_watchdog.py of odriverobotics/ODriveResources; nothing else does here.
_FEED_WATCHDOG = {
    CanSimpleCommand.SET_AXIS_STATE,
    CanSimpleCommand.SET_INPUT_POS,
    CanSimpleCommand.SET_INPUT_VEL,
    CanSimpleCommand.SET_INPUT_TORQUE,
}
_CONTROLLER = "axis0.controller.config"
_PARAMETERS_OF_COMMAND = {
    CanSimpleCommand.SET_CONTROLLER_MODE: (f"{_CONTROLLER}.control_mode", f"{_CONTROLLER}.input_mode"),
    CanSimpleCommand.SET_LIMITS: (f"{_CONTROLLER}.vel_limit", "axis0.config.motor.current_soft_max"),
    CanSimpleCommand.SET_TRAJ_INERTIA: (f"{_CONTROLLER}.inertia",),
    CanSimpleCommand.SET_POS_GAIN: (f"{_CONTROLLER}.pos_gain",),
    CanSimpleCommand.SET_VEL_GAINS: (f"{_CONTROLLER}.vel_gain", f"{_CONTROLLER}.vel_integrator_gain"),
}
