"""List the registers of a moteus with meaning, scale and default (docs/protocol/registers.md of mjbots/moteus).

Command registers that this simulation does not use (PWM, voltages, GPIO) are stored and can be read back. `moteus` uses
it. The numbers are the maker's and must not change.
"""

import math
from typing import NamedTuple

from sim_backend.drives.moteus_law import MODES, W
from sim_backend.drives.multiplex import FLOAT, NOT_WRITEABLE, UNKNOWN_REGISTER, scale, unscale

Steps = tuple[float, float, float]  # value of one LSB of an int8, int16 and int32
CURRENT: Steps = (1.0, 0.1, 0.001)
TORQUE: Steps = (0.5, 0.01, 0.001)
VOLTAGE: Steps = (0.5, 0.1, 0.001)
TEMPERATURE: Steps = (1.0, 0.1, 0.001)
TIME: Steps = (0.01, 0.001, 0.000001)
TURNS: Steps = (0.01, 0.0001, 0.00001)
TURNS_A_SECOND: Steps = (0.1, 0.00025, 0.00001)
ACCELERATION: Steps = (0.05, 0.001, 0.00001)
SHARE: Steps = (1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0)
POWER: Steps = (10.0, 0.05, 0.0001)
WHOLE: Steps = (1, 1, 1)

MODE, FAULT_REGISTER, HOME_STATE = 0x000, 0x00F, 0x00C
SET_NEAREST, SET_EXACT, REQUIRE_REINDEX, RECAPTURE = range(0x130, 0x134)
UUID_MASK = range(0x154, 0x158)
NOT_MEANT = -1  # error of a write whose mask names another board: the frame is ignored

Q_CURRENT, D_CURRENT, ABSOLUTE_POSITION, ELECTRICAL_POWER = range(0x004, 0x008)
MOTOR_TEMPERATURE, TORQUE_ERROR, ENCODER_VALIDITY, MILLISECONDS = 0x00A, 0x03D, 0x058, 0x070
Q_COMMAND, D_COMMAND = 0x01C, 0x01D
POSITION_REGISTER, VELOCITY_REGISTER, FEEDFORWARD_TORQUE, KP_SCALE, KD_SCALE = range(0x020, 0x025)
MAX_TORQUE, STOP_POSITION, TIMEOUT_REGISTER, VELOCITY_LIMIT, ACCEL_LIMIT = range(0x025, 0x02A)
ILIMIT_SCALE, IGNORE_BOUNDS = 0x02B, 0x02D
LOWER_BOUND, UPPER_BOUND = 0x040, 0x041  # for the mode stay-within
ENCODER_POSITIONS, ENCODER_VELOCITIES = (0x050, 0x052, 0x054), (0x051, 0x053, 0x055)
GPIO_STATUS, DRIVER_FAULTS = (0x05E, 0x05F), (0x140, 0x141)
MODEL_NUMBER, FIRMWARE_VERSION, MAP_VERSION_REGISTER = range(0x100, 0x103)
SERIAL_NUMBER, UUID = range(0x120, 0x123), range(0x150, 0x154)
UUID_MASK_CAPABILITY, MULTIPLEX_ID = 0x158, 0x110


class Register(NamedTuple):
    """A register that shows a word of the law's memory: index of the word, scale in a frame, default of a command."""

    word: int
    steps: Steps
    default: float = 0.0


class _Written(NamedTuple):
    """Scale and default of a register that the host writes."""

    steps: Steps
    default: float


# Registers that are read from the memory of the law.
_STATUS = {
    MODE: Register(W.mode, WHOLE),
    0x001: Register(W.position, TURNS),
    0x002: Register(W.velocity, TURNS_A_SECOND),
    0x003: Register(W.torque, TORQUE),
    0x00B: Register(W.trajectory_done, WHOLE),
    0x00D: Register(W.voltage, VOLTAGE),
    0x00E: Register(W.temperature, TEMPERATURE),
    FAULT_REGISTER: Register(W.fault, WHOLE),
    0x030: Register(W.proportional, TORQUE),
    0x031: Register(W.integral, TORQUE),
    0x032: Register(W.derivative, TORQUE),
    0x033: Register(W.feedforward, TORQUE),
    0x034: Register(W.control_torque, TORQUE),
    0x038: Register(W.control_position, TURNS),
    0x039: Register(W.control_velocity, TURNS_A_SECOND),
    0x03A: Register(W.control_torque, TORQUE),
    0x03B: Register(W.error, TURNS),
    0x03C: Register(W.error_rate, TURNS_A_SECOND),
}

# Defaults: fw/bldc_servo_structs.h.
COMMAND = {
    Q_COMMAND: Register(W.q_command, CURRENT, 0.0),
    POSITION_REGISTER: Register(W.command_position, TURNS, 0.0),
    VELOCITY_REGISTER: Register(W.command_velocity, TURNS_A_SECOND, 0.0),
    FEEDFORWARD_TORQUE: Register(W.feedforward, TORQUE, 0.0),
    KP_SCALE: Register(W.kp_scale, SHARE, 1.0),
    KD_SCALE: Register(W.kd_scale, SHARE, 1.0),
    MAX_TORQUE: Register(W.max_torque, TORQUE, 100.0),
    TIMEOUT_REGISTER: Register(W.timeout_left, TIME, 0.0),
    VELOCITY_LIMIT: Register(W.velocity_limit, TURNS_A_SECOND, math.nan),
    ACCEL_LIMIT: Register(W.accel_limit, ACCELERATION, math.nan),
    ILIMIT_SCALE: Register(W.ilimit_scale, SHARE, 1.0),
    IGNORE_BOUNDS: Register(W.ignore_bounds, WHOLE, 0.0),
    LOWER_BOUND: Register(W.lower, TURNS, 0.0),
    UPPER_BOUND: Register(W.upper, TURNS, 0.0),
}
# Registers of a command that the simulated drive stores and sends back, but does not use.
_STORED = {
    **dict.fromkeys((0x010, 0x011, 0x012, 0x018), _Written(SHARE, 0.0)),
    **dict.fromkeys((0x014, 0x015, 0x016, 0x019, 0x01A, 0x01B), _Written(VOLTAGE, 0.0)),
    D_COMMAND: _Written(CURRENT, 0.0),
    0x01E: _Written(TURNS_A_SECOND, 0.0),
    STOP_POSITION: _Written(TURNS, math.nan),
    0x02A: _Written(VOLTAGE, math.nan),
    0x02C: _Written(CURRENT, math.nan),
    **dict.fromkeys((0x05C, 0x05D), _Written(WHOLE, 0.0)),
}
# Second numbers of registers, for shorter frames: number → the register that it stands for.
_SHADOWED = (
    FEEDFORWARD_TORQUE,
    KP_SCALE,
    KD_SCALE,
    MAX_TORQUE,
    TIMEOUT_REGISTER,
    ILIMIT_SCALE,
    IGNORE_BOUNDS,
)
SHADOWS = dict(zip(range(0x042, 0x049), _SHADOWED, strict=True))
_WRITTEN = {register: _Written(each.steps, each.default) for register, each in COMMAND.items()} | _STORED
_ACTIONS = dict.fromkeys((SET_NEAREST, SET_EXACT), TURNS)
_ACTIONS |= dict.fromkeys((REQUIRE_REINDEX, RECAPTURE, *UUID_MASK), WHOLE)
_READ_ONLY = {
    *_STATUS, Q_CURRENT, D_CURRENT, ABSOLUTE_POSITION, ELECTRICAL_POWER, MOTOR_TEMPERATURE, HOME_STATE,
    *ENCODER_POSITIONS, *ENCODER_VELOCITIES, ENCODER_VALIDITY, *GPIO_STATUS, MILLISECONDS, *DRIVER_FAULTS,
    MODEL_NUMBER, FIRMWARE_VERSION, MAP_VERSION_REGISTER, MULTIPLEX_ID, *SERIAL_NUMBER, *UUID, UUID_MASK_CAPABILITY,
} - {MODE}  # fmt: skip


# Built once: every frame with a mode begins a command.
_DEFAULTS = {register: each.default for register, each in _WRITTEN.items()}


def fresh_command() -> dict[int, float]:
    """Return the default of every command register by number; a write to the mode register starts with these values."""
    return dict(_DEFAULTS)


def parse_write(register: int, kind: int, raw: float) -> tuple[int, float] | int:
    """Return register number and scaled value of a write, or the error number if the write is not allowed.

    `kind` is the number's type in the frame, `raw` the number. A shadow register is replaced by its original.
    """
    register = SHADOWS.get(register, register)
    if register == MODE:
        return (MODE, raw) if 0 <= raw < MODES else UNKNOWN_REGISTER
    if register in _WRITTEN:
        return register, scale(raw, kind, _WRITTEN[register].steps)
    if register in _ACTIONS:
        return register, scale(raw, kind, _ACTIONS[register])
    return NOT_WRITEABLE if register in _READ_ONLY else UNKNOWN_REGISTER


def read(register: int, kind: int, words: list[float], command: dict[int, float]) -> float | None:
    """Return the value of a register, scaled for a frame as the type `kind`; None if the register cannot be read.

    `words` is the memory of `moteus_law`, `command` the last command by register number.
    """
    known = _STATUS.get(register)
    if known is not None:
        value, steps = words[known.word], known.steps
    else:
        register = SHADOWS.get(register, register)
        if register not in _WRITTEN:
            return None
        value, steps = command[register], _WRITTEN[register].steps
    return value if kind == FLOAT else unscale(value, kind, steps)
