"""List the device's parameters, and encode and decode the parameter block.

A block is a sequence of entries in ascending order of id, each an id (u16) and a value in four bytes, both
little-endian. The device activates all values of a block or none. Defaults are safe: a device that was never configured
drives no current. Host, device and code generator use it. An id must not be reused, and a default must not drive
current.
"""

import struct
from collections.abc import Mapping
from zlib import crc32

from firmware_protocol.errors import ProtocolError
from firmware_protocol.faults import Status
from firmware_protocol.law_parameters import LAW_PARAMETERS
from firmware_protocol.parameter import Parameter, Value

ENTRY_BYTES = 6
_I16_MAXIMUM = 2**15 - 1
_I32_MINIMUM, _I32_MAXIMUM = -(2**31), 2**31 - 1
_U32_MAXIMUM = 2**32 - 1
# Every value travels in four bytes; the C type says how they are read and what the device stores.
_FORMATS = {"u8": "<HI", "u16": "<HI", "u32": "<HI", "i8": "<Hi", "i32": "<Hi", "f32": "<Hf"}


class ParameterError(ProtocolError):
    """A parameter or a parameter block is not valid.

    `status` and `detail` are the fields of the ACK that rejects the block; `detail` is the id of the parameter, or 0
    for the whole block. `name` is the name of the parameter, or empty.
    """

    def __init__(self, status: Status, message: str, *, detail: int = 0, name: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.detail = detail
        self.name = name


PARAMETERS: tuple[Parameter, ...] = (
    Parameter(1, "motion", "u8", "", 0, 1, 0, "0 rotary, 1 linear; a device accepts only its own value"),
    Parameter(
        2, "position_rate", "u32", "Hz", 50, 50_000, 1_000, "ticks a second; see the device's own maximum"
    ),
    Parameter(
        3,
        "reference_count",
        "i32",
        "count",
        _I32_MINIMUM,
        _I32_MAXIMUM,
        0,
        "the count of position zero; setting it makes the rig homed until the device restarts",
    ),
    Parameter(
        4,
        "verified",
        "u8",
        "",
        0,
        1,
        0,
        "1: signs and scale of encoder and motor were checked for this configuration; a COMMIT "
        "without it clears it",
    ),
    Parameter(
        5,
        "command_lifetime_us",
        "u16",
        "µs",
        100,
        20_000,
        3_000,
        "cap on the lifetime of a COMMAND of the host loop; the host chooses max(5 periods, 3 ms)",
    ),
    Parameter(
        6,
        "ramp_us",
        "u16",
        "µs",
        0,
        10_000,
        10_000,
        "time in which the effort falls to zero after the link is lost",
    ),
    Parameter(7, "current_limit", "u16", "quantum", 0, _I16_MAXIMUM, 0, "largest current, either sign"),
    Parameter(
        8,
        "slew_limit",
        "u16",
        "quantum/tick",
        1,
        65_535,
        65_535,
        "largest change of current in a tick; 65535: none",
    ),
    Parameter(
        9, "speed_limit", "u32", "count/s", 0, _U32_MAXIMUM, 0, "speed above which the device latches a fault"
    ),
    Parameter(
        10,
        "window_minimum",
        "i32",
        "count",
        _I32_MINIMUM,
        _I32_MAXIMUM,
        0,
        "count below which the device latches a fault",
    ),
    Parameter(
        11,
        "window_maximum",
        "i32",
        "count",
        _I32_MINIMUM,
        _I32_MAXIMUM,
        0,
        "count above which the device latches a fault; at least window_minimum",
    ),
    Parameter(
        12,
        "continuous_current",
        "u16",
        "quantum",
        0,
        _I16_MAXIMUM,
        0,
        "continuous current of the motor (I²t, nominal)",
    ),
    Parameter(
        13,
        "thermal_time_constant",
        "f32",
        "s",
        0.125,
        8192.0,
        8.0,
        "thermal time constant of the winding, for the I²t budget",
    ),
    Parameter(14, "hold_to_run", "u8", "", 0, 1, 0, "1: effort only while the hold-to-run input is active"),
    Parameter(
        15,
        "supervise_lifetime_us",
        "u32",
        "µs",
        100,
        100_000,
        20_000,
        "cap on the lifetime of a COMMAND that supervises a law on the device",
    ),
    Parameter(
        16,
        "encoder_sign",
        "i8",
        "",
        -1,
        1,
        1,
        "-1: counts fall while the position rises; a device accepts only its own value",
        excluded=(0,),
    ),
    Parameter(
        17,
        "confirm_ms",
        "u32",
        "ms",
        0,
        4_000_000,
        0,
        "if the count stays on two neighbouring values under effort for longer than this, the "
        "position is not confirmed and the effort fades out and stays zero until the commanded "
        "effort is zero; 0: never",
    ),
    Parameter(
        18,
        "reference",
        "u8",
        "",
        0,
        1,
        0,
        "origin of reference_count: 0 the position at which the handle was placed, 1 an index of the encoder",
    ),
    *LAW_PARAMETERS,
)

BY_NAME: dict[str, Parameter] = {parameter.name: parameter for parameter in PARAMETERS}
BY_ID: dict[int, Parameter] = {parameter.id: parameter for parameter in PARAMETERS}
DEFAULTS: dict[str, Value] = {parameter.name: parameter.default for parameter in PARAMETERS}
LIVE: frozenset[str] = frozenset(parameter.name for parameter in PARAMETERS if parameter.live)
BLOCK_LIMIT = 1024  # a longer block is refused at BEGIN; above one entry for every parameter


def check_together(values: Mapping[str, Value]) -> None:
    """Raise `ParameterError` if parameters contradict each other, although each is in its range.

    `values` contains all active values by name; a missing parameter has its default.
    """
    if values.get("window_minimum", 0) > values.get("window_maximum", 0):
        parameter = BY_NAME["window_maximum"]
        raise ParameterError(
            Status.INCONSISTENT,
            f"window_maximum = {values.get('window_maximum', 0)} is below window_minimum = "
            f"{values.get('window_minimum', 0)} (counts)",
            detail=parameter.id,
            name=parameter.name,
        )


def encode_block(values: Mapping[str, Value]) -> bytes:
    """Return the parameter block (bytes) for values by name, in any order; raise `ParameterError` for an invalid value.

    f32 values are rounded to float32: `decode_block` returns the value that the device will use.
    """
    entries = []
    for name in values.keys() - BY_NAME.keys():
        _by_name(name)
    for parameter in PARAMETERS:  # they rise by id
        if parameter.name not in values:
            continue
        value = values[parameter.name]
        _check_one(parameter, value)
        if parameter.ctype == "f32":
            value += 0.0  # converts -0.0 to 0.0, which would have other bytes
        entries.append(struct.pack(_FORMATS[parameter.ctype], parameter.id, value))
    return b"".join(entries)


def decode_block(block: bytes) -> dict[str, Value]:
    """Return the values in a parameter block by name, in order of their ids; raise `ParameterError` if not valid."""
    if len(block) % ENTRY_BYTES or len(block) > BLOCK_LIMIT:
        raise ParameterError(
            Status.BAD_LENGTH,
            f"a parameter block of {len(block)} bytes: the length must be a multiple of {ENTRY_BYTES}, at most "
            f"{BLOCK_LIMIT}",
        )
    values: dict[str, Value] = {}
    previous = -1
    for start in range(0, len(block), ENTRY_BYTES):
        (number,) = struct.unpack_from("<H", block, start)
        parameter = BY_ID.get(number)
        if parameter is None:
            text = f"unknown parameter id {number}; PROTOCOL.md lists all"
            raise ParameterError(Status.UNKNOWN_PARAMETER, text, detail=number)
        if number <= previous:
            raise ParameterError(
                Status.BAD_ORDER,
                f"parameter {parameter.name} is out of order: a block has ascending ids, each at most once",
                detail=number,
                name=parameter.name,
            )
        previous = number
        _, value = struct.unpack_from(_FORMATS[parameter.ctype], block, start)
        _check_one(parameter, value)
        values[parameter.name] = value
    return values


def block_crc(block: bytes) -> int:
    """Return the CRC-32 of a parameter block; the device reports it after a change, and ARM repeats it."""
    return crc32(block)


def _by_name(name: str) -> Parameter:
    parameter = BY_NAME.get(name)
    if parameter is None:
        raise ParameterError(
            Status.UNKNOWN_PARAMETER,
            f"unknown parameter {name!r}; PROTOCOL.md lists all parameters",
            name=name,
        )
    return parameter


def _check_one(parameter: Parameter, value: Value) -> None:
    if parameter.ctype != "f32" and not hasattr(value, "__index__"):
        raise _refusal(
            parameter, f"{parameter.name} = {value} is not a whole number; its type is {parameter.ctype}"
        )
    if not parameter.accepts(value):
        excluded = "".join(f", not {banned}" for banned in parameter.excluded)
        limits = f"{parameter.minimum} … {parameter.maximum}{excluded}"
        raise _refusal(parameter, f"{parameter.name} = {value} is outside its range {limits}")


def _refusal(parameter: Parameter, message: str) -> ParameterError:
    return ParameterError(Status.OUT_OF_RANGE, message, detail=parameter.id, name=parameter.name)
