"""Simulate a moteus drive: it receives and sends CAN frames, and its shaft moves a simulated rig.

The file follows docs/protocol/{can,registers,diagnostic}.md of mjbots/moteus at db1a762 (2026-06) and the firmware of
that commit (fw/moteus_controller.cc, mjlib/multiplex/micro_server.cc). `moteus_law` computes a control cycle,
`moteus_registers` lists the registers, `moteus_settings` contains configuration and console. `process` serves it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from sim_backend.drives import moteus_registers as registers
from sim_backend.drives.bus import Frame
from sim_backend.drives.moteus_law import (
    BRAKE,
    CALIBRATION_COMPLETE,
    FAULT,
    PLL_SHAPE,
    POSITION,
    RATE_HZ,
    STAY_WITHIN,
    STOP_POSITION_DEPRECATED,
    STOPPED,
    TIMEOUT,
    WORDS,
    ZERO_VELOCITY,
    W,
    law,
)
from sim_backend.drives.moteus_law import CURRENT as CURRENT_MODE
from sim_backend.drives.moteus_registers import (
    CURRENT,
    POWER,
    TEMPERATURE,
    TURNS,
    TURNS_A_SECOND,
    WHOLE,
    Steps,
)
from sim_backend.drives.moteus_settings import (
    SPI,
    TORQUE_TIMES_KV,
    DiagnosticChannel,
    MoteusSettings,
    defaults,
)
from sim_backend.drives.motor import Motor
from sim_backend.drives.multiplex import (
    FLOAT,
    INT32,
    NUMBERED_REPLY,
    READ_ERROR,
    SERVER_TO_CLIENT,
    UNKNOWN_REGISTER,
    WRITE_ERROR,
    ReadRegisters,
    StreamData,
    StreamPoll,
    WriteRegisters,
    error,
    reply,
    subframes,
    unscale,
    varuint,
)

BROADCAST = 0x7F  # mjlib/multiplex/format.h
WANTS_REPLY = 0x80  # docs/protocol/can.md, of the source
FIRMWARE = 0x010000  # 1.0.0, CHANGELOG.md
MAP_VERSION = 5  # fw/moteus_controller.cc, kRegisterMapVersion
CONSOLE_CHANNEL = 1  # fw/moteus.cc
STREAM_BYTES = 41  # largest reply on the stream: mjlib/multiplex/micro_server.cc
UNCONFIGURED_TORQUE_CONSTANT = 0.1  # N·m/A, fw/bldc_servo_control.h, kDefaultTorqueConstant
OTHER_MASTER = 2  # source of the frames of a second host, where one is simulated


@dataclass(frozen=True, slots=True)
class MoteusOptions:
    """State of a moteus drive at power-up: stored settings, version, serial number, supply.

    Attributes
    ----------
    settings
        Stored settings, by name, that differ from `moteus_settings.defaults`.
    firmware
        Firmware version, one byte for each number: 0x010203 is 1.2.3.
    serial
        Serial number, three words.
    voltage, temperature
        Supply voltage (V) and temperature of the board (°C).
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    firmware: int = FIRMWARE
    serial: tuple[int, int, int] = (0x4D4F5445, 0x55530000, 0x00000001)
    voltage: float = 24.0
    temperature: float = 25.0


class SimulatedMoteus:
    """A simulated moteus with its rig, as a `sim_backend.drives.bus.DriveModel`.

    Raise `ConfigError` if the rig is linear, or a setting does not exist on the simulated moteus.

    Parameters
    ----------
    model
        Rig to simulate. The drive reads its encoder and has the current loop and torque constant of its amplifier.
    options
        State of the drive at power-up.
    """

    rate_hz = RATE_HZ
    next_due: int | None = None  # a moteus sends only replies

    def __init__(self, model: RigModel, options: MoteusOptions = MoteusOptions()) -> None:
        self._words = np.zeros(WORDS)
        self.motor = Motor(model, RATE_HZ, law, self._words)
        self._torque_constant = model.amplifier.effort_per_ampere / abs(self.motor.effort_per_torque)
        self._options = options
        self.settings = MoteusSettings(defaults(self.motor.counts_per_turn, self._torque_constant))
        self._encoder_type = self.settings.values["motor_position.sources.0.type"]
        for name, text in options.settings.items():
            if not self.settings.set(name, text):
                raise ConfigError(
                    f"{name} = {text} is not valid: unknown setting of a simulated moteus, or not a number",
                    remedy=f"give a number for one of {', '.join(self.settings.values)}",
                )
        self.settings.store()
        self._console = DiagnosticChannel(self.settings, self._run_console_command)
        self._packet_number = 0
        self._last_packet = b""
        self.ticks = 0
        self._writes: dict[int, float] = {}
        self._integer_registers = {
            registers.MODEL_NUMBER: 0,
            registers.FIRMWARE_VERSION: options.firmware,
            registers.MAP_VERSION_REGISTER: MAP_VERSION,
            **dict(zip(registers.SERIAL_NUMBER, map(_to_signed, options.serial), strict=True)),
            **dict(zip(registers.UUID, map(_to_signed, (*options.serial, 0x5349_4D00)), strict=True)),
        }
        self._computed_registers = self._list_computed_registers()
        self.power_up()

    def power_up(self) -> None:
        """Restart the drive with its stored settings: stopped, with the position from the encoder."""
        self._words[:] = 0.0
        self._words[[W.voltage, W.temperature]] = self._options.voltage, self._options.temperature
        self._command = registers.fresh_command()
        self._homed = False
        self.settings.watch(self._configure)
        self.settings.load()
        turn = self.settings.values["motor_position.sources.0.cpr"]
        count = self.motor.count
        if self._absolute:  # within half a turn of the shaft either way
            self._words[W.output_shift] = -math.floor(count / turn + 0.5) * self._words[W.rotor_to_output]
        else:
            self._words[W.output_shift] = -count / turn * self._words[W.rotor_to_output]

    # ------------------------------------------------------------------ time

    def run(self, until: int) -> list[Frame]:
        """Simulate the drive up to tick `until`; return no frames, because a moteus sends only replies."""
        if until > self.ticks:
            self.motor.run(until - self.ticks)
            self.ticks = until
        return []

    @property
    def events(self) -> frozenset[str]:
        """Return the names of the external events that `happen` accepts."""
        return frozenset(self._happenings())

    def happen(self, name: str, value: float) -> list[Frame]:
        """Apply an external event to the drive by name; return the frames that the event puts on the bus.

        Events are ``fault`` (`value`: a fault code), the other events of all drives (`Motor.happenings`), ``mode`` (the
        console commands the mode `value`) and ``master`` (a second host commands a torque of `value` N·m; the drive's
        reply to it is on the bus).
        """
        return self._happenings()[name](value) or []

    def _happenings(self) -> dict[str, Callable[[float], list[Frame] | None]]:
        return {
            **self.motor.happenings(W, W.timeout_left, self.power_up),
            "mode": lambda mode: self._apply_command(
                {**registers.fresh_command(), registers.TIMEOUT_REGISTER: math.nan}, mode
            ),
            "master": self._second_master,
        }

    def _second_master(self, torque: float) -> list[Frame]:
        command = {**registers.fresh_command(), registers.POSITION_REGISTER: math.nan}
        command[registers.FEEDFORWARD_TORQUE] = torque
        # Without gains the position mode drives this torque alone.
        command |= dict.fromkeys((registers.KP_SCALE, registers.KD_SCALE, registers.ILIMIT_SCALE), 0.0)
        self._apply_command(command, POSITION)
        answer = self._read_registers(ReadRegisters(registers.MODE, 1, FLOAT))
        return [Frame(self._id << 8 | OTHER_MASTER, answer)]

    # ------------------------------------------------------------------ frames

    @property
    def _id(self) -> int:
        return int(self.settings.values["id.id"])

    def receive(self, frame: Frame) -> list[Frame]:
        """Process a CAN frame at the present time and return the reply: at most one frame."""
        destination, source = frame.identifier & 0xFF, frame.identifier >> 8 & 0xFF
        if destination not in {self._id, BROADCAST}:
            return []
        wanted = bool(source & WANTS_REPLY)
        answer = bytearray()
        self._writes = {}
        for part in subframes(frame.data):
            if isinstance(part, WriteRegisters):
                answer += self._write(part)
                # The mask of another board's UUID: the whole frame does nothing, its answer included.
                if registers.NOT_MEANT in self._writes:
                    return []
            elif isinstance(part, ReadRegisters):
                answer += self._read_registers(part)
            elif isinstance(part, StreamData):
                answer += self._receive_console(part, wanted)
            elif wanted:
                answer += self._answer_poll(part)
        # The mode must be written first; a frame without it commands nothing.
        if registers.MODE in self._writes:
            self._apply_command(self._writes, self._writes[registers.MODE])
        return [Frame(self._id << 8 | source & 0x7F, bytes(answer))] if wanted else []

    def _write(self, part: WriteRegisters) -> bytes:
        refused = b""
        for number, raw in enumerate(part.raws, part.first):
            found = registers.parse_write(number, part.kind, raw)
            if isinstance(found, int):
                refused += error(WRITE_ERROR, number, found)
                continue
            register, value = found
            if register == registers.MODE:
                # A command is a whole: writing the mode begins one with the defaults of all others.
                self._writes = registers.fresh_command()
                self._writes[registers.MODE] = value
            elif register in registers.UUID_MASK:
                if raw != self._integer_registers[register - 4]:
                    self._writes[registers.NOT_MEANT] = 1.0
            elif register >= registers.SET_NEAREST:
                self._write_action_register(register, value)
            else:
                self._writes[register] = value
        return refused

    def _read_registers(self, part: ReadRegisters) -> bytes:
        words = self._words.tolist()
        values: list[float] = []
        for register in range(part.first, part.first + part.number):
            value = self._value(register, part.kind, words)
            if value is None:
                return error(READ_ERROR, register, UNKNOWN_REGISTER)
            values.append(value)
        return reply(part.first, part.kind, values)

    def _value(self, register: int, kind: int, words: list[float]) -> float | None:
        """Return a register's value, scaled for a frame as the type `kind`; None if it cannot be read as this type."""
        if register in self._integer_registers:
            return self._integer_registers[register] if kind == INT32 else None
        computed = self._computed_registers.get(register)
        if computed is None:
            return registers.read(register, kind, words, self._command)
        compute, steps = computed
        value = compute(words)
        return value if kind == FLOAT else unscale(value, kind, steps)

    def _list_computed_registers(self) -> dict[int, tuple[Callable[[list[float]], float], Steps]]:
        """Return by register number a function that computes it from the law's memory, and its scale in frames."""

        def rotor_angle(w: list[float]) -> float:
            turns = w[W.filtered] / w[W.counts_per_turn]
            return float(turns - math.floor(turns))

        def zero(_: list[float]) -> float:
            return 0.0

        valid_bits = 3.0 if self._absolute else 2.0  # theta and velocity, or velocity alone
        return {
            registers.Q_CURRENT: (
                lambda w: w[W.torque] * w[W.rotor_to_output] / w[W.torque_constant],
                CURRENT,
            ),
            registers.D_CURRENT: (zero, CURRENT),
            registers.ABSOLUTE_POSITION: (zero, TURNS),
            registers.ELECTRICAL_POWER: (lambda w: w[W.torque] * w[W.velocity] * 2.0 * math.pi, POWER),
            registers.MOTOR_TEMPERATURE: (zero, TEMPERATURE),
            registers.HOME_STATE: (lambda _: 2.0 if self._homed else valid_bits - 2.0, WHOLE),
            registers.TORQUE_ERROR: (lambda w: w[W.torque] - w[W.control_torque], registers.TORQUE),
            # The drive has one encoder: the registers of the other two read 0.
            **dict.fromkeys(registers.ENCODER_POSITIONS, (zero, TURNS)),
            **dict.fromkeys(registers.ENCODER_VELOCITIES, (zero, TURNS_A_SECOND)),
            registers.ENCODER_POSITIONS[0]: (rotor_angle, TURNS),
            registers.ENCODER_VELOCITIES[0]: (
                lambda w: w[W.pll_velocity] / w[W.counts_per_turn],
                TURNS_A_SECOND,
            ),
            registers.ENCODER_VALIDITY: (lambda _: valid_bits, WHOLE),
            **dict.fromkeys((*registers.GPIO_STATUS, *registers.DRIVER_FAULTS), (zero, WHOLE)),
            registers.MILLISECONDS: (lambda _: float(self.ticks * 1000 // RATE_HZ % (1 << 23)), WHOLE),
            registers.UUID_MASK_CAPABILITY: (lambda _: 1.0, WHOLE),
        }

    # ------------------------------------------------------------------ stream

    def _receive_console(self, part: StreamData, wanted: bool) -> bytes:
        if part.channel != CONSOLE_CHANNEL:
            return b""
        self._console.hear(part.data)
        return self._unnumbered_reply(STREAM_BYTES) if wanted else b""

    def _answer_poll(self, part: StreamPoll) -> bytes:
        if part.channel != CONSOLE_CHANNEL:
            return b""
        most = min(part.most, STREAM_BYTES)
        if part.acknowledged is None:
            return self._unnumbered_reply(most)
        # An unacknowledged packet is repeated unchanged: the poll or its answer was lost.
        if part.acknowledged == self._packet_number:
            self._last_packet = self._console.say(most)
            self._packet_number = (self._packet_number + 1) & 0xFF
        head = bytes((NUMBERED_REPLY,)) + varuint(part.channel) + bytes((self._packet_number,))
        return head + self._prefix_size(self._last_packet)

    def _unnumbered_reply(self, most: int) -> bytes:
        return bytes((SERVER_TO_CLIENT, CONSOLE_CHANNEL)) + self._prefix_size(self._console.say(most))

    @staticmethod
    def _prefix_size(data: bytes) -> bytes:
        return varuint(len(data)) + data

    # ------------------------------------------------------------------ commands

    def _run_console_command(self, words: list[str]) -> bool:
        """Run a console command (docs/protocol/diagnostic.md, `d`), without timeout by default; False if invalid."""
        kind, *rest = words
        if kind == "stop":
            self._apply_command(registers.fresh_command(), STOPPED)
            return True
        try:
            if kind in _CONSOLE_ACTIONS:
                self._write_action_register(_CONSOLE_ACTIONS[kind], float(rest[0]) if rest else 0.0)
                return True
            return self._parse_drive_command(kind, rest)
        except (ValueError, IndexError):
            return False

    def _parse_drive_command(self, kind: str, rest: list[str]) -> bool:
        if kind not in _CONSOLE_MODES:
            return False
        mode, arguments = _CONSOLE_MODES[kind]
        command = {**registers.fresh_command(), registers.TIMEOUT_REGISTER: math.nan}
        command.update(zip(arguments, map(float, rest), strict=False))
        for option in rest[len(arguments) :]:
            if option[0] not in _CONSOLE_OPTIONS:
                return False
            command[_CONSOLE_OPTIONS[option[0]]] = float(option[1:])
        self._apply_command(command, mode)
        return True

    def _apply_command(self, command: dict[int, float], mode: float) -> None:
        """Start a command (a value for each command register) in a mode; ignore modes that only the drive may enter."""
        # Fault, enabling and calibrating are entered by the drive alone.
        if mode in range(FAULT, CALIBRATION_COMPLETE + 1):
            return
        words, values = self._words, self.settings.values
        self._command = command
        for register, followed in registers.COMMAND.items():
            words[followed.word] = command[register]
        # 0 means the default time-out; NaN means the default limit below, and a negative one no limit.
        if words[W.timeout_left] == 0.0:
            words[W.timeout_left] = values["servo.default_timeout_s"]
        for word, name in (
            (W.velocity_limit, "servo.default_velocity_limit"),
            (W.accel_limit, "servo.default_accel_limit"),
        ):
            words[word] = values[name] if math.isnan(words[word]) else words[word]
            if words[word] < 0.0:
                words[word] = math.nan
        limited = not (math.isnan(words[W.velocity_limit]) and math.isnan(words[W.accel_limit]))
        if not math.isnan(command[registers.STOP_POSITION]) and limited:
            words[W.mode], words[W.fault] = FAULT, STOP_POSITION_DEPRECATED
        if words[W.mode] == STOPPED and mode != STOPPED:
            # The simulated person begins when the drive is switched on, as with a board after ARM.
            self.motor.begin_session()
        words[W.command] = mode

    def _write_action_register(self, register: int, value: float) -> None:
        """Execute a write to one of the write-only registers 0x130 to 0x133 (docs/protocol/registers.md)."""
        words = self._words
        if register == registers.SET_EXACT:
            words[W.output_shift] += value - words[W.position]
            self._homed = True
        elif register == registers.SET_NEAREST:
            turn = words[W.rotor_to_output]
            words[W.output_shift] += turn * math.floor((value - words[W.position]) / turn + 0.5)
            self._homed = True
        elif register == registers.REQUIRE_REINDEX:
            self._homed = False
        elif register == registers.RECAPTURE:
            words[W.control_position], words[W.control_velocity] = words[W.position], words[W.velocity]
            words[W.integral] = 0.0

    # ------------------------------------------------------------------ configuration

    @property
    def _absolute(self) -> bool:
        return self._encoder_type == SPI

    def _configure(self) -> None:
        """Copy the settings to the memory of the law. They act at once (docs/reference/configuration.md)."""
        values, words = self.settings.values, self._words
        for word, name in _SETTING_OF_WORD.items():
            words[word] = values[name]
        natural_frequency = 2.0 * math.pi * values["motor_position.sources.0.pll_filter_hz"] / PLL_SHAPE
        words[W.pll_kp], words[W.pll_ki] = 2.0 * natural_frequency, natural_frequency**2
        kv = values["motor.Kv"]
        configured_constant = TORQUE_TIMES_KV / kv if kv else UNCONFIGURED_TORQUE_CONSTANT
        words[W.torque_constant], words[W.motor_constant] = configured_constant, self._torque_constant
        source = values["motor_position.output.source"]
        words[W.source_valid] = values.get(f"motor_position.sources.{source}.type", 0) == self._encoder_type
        words[W.sign] = values["motor_position.sources.0.sign"] * values["motor_position.output.sign"]
        # Braking shorts the phases: torque = −(k_t · ω) · k_t / R, at the output through the ratio twice.
        resistance = 1.5 * values["motor.resistance_ohm"]  # of one phase, as the q current sees it
        per_turn = 2.0 * math.pi * self._torque_constant * configured_constant / resistance
        words[W.brake_damping] = per_turn / values["motor_position.rotor_to_output_ratio"] ** 2


_CONSOLE_ACTIONS = {
    "nearest": registers.SET_NEAREST,
    "exact": registers.SET_EXACT,
    "recapture": registers.RECAPTURE,
    "req-reindex": registers.REQUIRE_REINDEX,
}
_MOTION_ARGUMENTS = (registers.POSITION_REGISTER, registers.VELOCITY_REGISTER, registers.MAX_TORQUE)
# Mode, and the registers of the arguments in their order.
_CONSOLE_MODES: dict[str, tuple[int, tuple[int, ...]]] = {
    "pos": (POSITION, _MOTION_ARGUMENTS),
    "tmt": (TIMEOUT, _MOTION_ARGUMENTS),
    "zero": (ZERO_VELOCITY, _MOTION_ARGUMENTS),
    "within": (STAY_WITHIN, (registers.LOWER_BOUND, registers.UPPER_BOUND, registers.MAX_TORQUE)),
    "brake": (BRAKE, ()),
    "dq": (CURRENT_MODE, (registers.D_COMMAND, registers.Q_COMMAND)),
}
_CONSOLE_OPTIONS = {
    "p": registers.KP_SCALE,
    "d": registers.KD_SCALE,
    "i": registers.ILIMIT_SCALE,
    "s": registers.STOP_POSITION,
    "f": registers.FEEDFORWARD_TORQUE,
    "t": registers.TIMEOUT_REGISTER,
    "v": registers.VELOCITY_LIMIT,
    "a": registers.ACCEL_LIMIT,
    "b": registers.IGNORE_BOUNDS,
}

# Word of the control law: the setting whose value it has.
_SETTING_OF_WORD: dict[int, str] = {
    W.counts_per_turn: "motor_position.sources.0.cpr",
    W.output_offset: "motor_position.output.offset",
    W.rotor_to_output: "motor_position.rotor_to_output_ratio",
    W.kp: "servo.pid_position.kp",
    W.ki: "servo.pid_position.ki",
    W.kd: "servo.pid_position.kd",
    W.ilimit: "servo.pid_position.ilimit",
    W.iratelimit: "servo.pid_position.iratelimit",
    W.max_current: "servo.max_current_A",
    W.position_min: "servopos.position_min",
    W.position_max: "servopos.position_max",
    W.position_derate: "servo.position_derate",
    W.default_velocity_limit: "servo.default_velocity_limit",
    W.default_accel_limit: "servo.default_accel_limit",
    W.max_velocity: "servo.max_velocity",
    W.max_velocity_derate: "servo.max_velocity_derate",
    W.max_position_slip: "servo.max_position_slip",
    W.fault_position_error: "servo.fault_position_error",
    W.fault_velocity_error: "servo.fault_velocity_error",
    W.velocity_threshold: "servo.velocity_threshold",
    W.max_voltage: "servo.max_voltage",
    W.fault_temperature: "servo.fault_temperature",
    W.timeout_mode: "servo.timeout_mode",
    W.timeout_max_torque: "servo.timeout_max_torque_Nm",
}


def _to_signed(word: int) -> int:
    return (word & 0xFFFFFFFF ^ 0x80000000) - 0x80000000
