"""The device's dictionary: a description of the device by itself, which a host must read before it arms the device.

The dictionary is canonical JSON (sorted keys, no spaces, UTF-8), compressed with zlib and read in pages with IDENTIFY.
Every IDENTITY contains its hash, so a host reads a dictionary only once for each firmware; ARM repeats the hash. A
device that is newer than the host supplies texts for its fault codes and ranges for its parameters. Unknown keys are
ignored. Host, firmware build and simulated device use this file. Its encoding must not change: hashes identify
dictionaries.
"""

import hashlib
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, NoReturn

from firmware_protocol.errors import RemoteProtocolError
from firmware_protocol.faults import PORT_FAULTS, Described, Fault, Status
from firmware_protocol.messages import MAJOR, MINOR, TIME_UNIT_NS
from firmware_protocol.parameter import Parameter, Value
from firmware_protocol.parameters import PARAMETERS

SettingValue = int | float | str
COMPRESSED_LIMIT = 0xFFFF  # IDENTITY counts its bytes in a u16
# Most bytes that a host decompresses: zlib can expand its input a thousandfold, and the device is not trusted yet.
PLAIN_LIMIT = 1 << 18


@dataclass(frozen=True, slots=True)
class ParameterInfo:
    """A parameter in a device's dictionary; its range may be narrower than in `firmware_protocol.parameters`."""

    id: int
    name: str
    ctype: str
    unit: str
    minimum: Value
    maximum: Value
    default: Value


@dataclass(frozen=True, slots=True)
class ConstantInfo:
    """A read-only constant of the firmware: a property of the rig that the device's safety monitors use."""

    name: str
    unit: str
    value: float


@dataclass(frozen=True, slots=True)
class SettingInfo:
    """A build setting of the firmware (pin, scale or option): its name in the board's configuration, and its value."""

    name: str
    value: SettingValue


@dataclass(frozen=True, slots=True)
class CodeInfo:
    """A fault or status code with the name, text and remedy that the device sends for it."""

    code: int
    name: str
    text: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Dictionary:
    """A device's description of itself: versions, name, units, tick rates, parameters, fault and status codes."""

    major: int = MAJOR
    minor: int = MINOR
    device: str
    firmware: str
    simulated: bool
    time_unit_ns: float = TIME_UNIT_NS
    current_quantum_a: float
    current_measured: bool = True
    position_rate_default: int
    position_rate_maximum: int
    constants: tuple[ConstantInfo, ...] = ()
    settings: tuple[SettingInfo, ...] = ()
    parameters: tuple[ParameterInfo, ...]
    faults: tuple[CodeInfo, ...]
    statuses: tuple[CodeInfo, ...]

    @cached_property
    def packed(self) -> bytes:
        """Return the dictionary as compressed bytes, as the device sends it."""
        return encode(self)

    @cached_property
    def hash(self) -> int:
        """Return the 64-bit hash of the dictionary's compressed bytes, which identifies the dictionary in messages."""
        return dictionary_hash(self.packed)

    def parameter(self, name: str) -> ParameterInfo | None:
        """Return the device's definition of the parameter `name`, or None if the device has no such parameter."""
        return next((info for info in self.parameters if info.name == name), None)

    def explain_fault(self, code: int) -> CodeInfo:
        """Return a fault code's name, text and remedy, from the device, else from this package, else as unknown."""
        return _explain(self.faults, Fault, code)

    def explain_status(self, code: int) -> CodeInfo:
        """Return a status code's name, text and remedy, from the device, else from this package, else as unknown."""
        return explain_status(code, self.statuses)


def build(
    *,
    device: str,
    firmware: str,
    simulated: bool,
    current_quantum_a: float,
    current_measured: bool = True,
    position_rate_default: int = 1_000,
    position_rate_maximum: int = 50_000,
    ranges: Mapping[str, tuple[Value, Value]] | None = None,
    constants: tuple[ConstantInfo, ...] = (),
    settings: Mapping[str, SettingValue] | None = None,
) -> Dictionary:
    """Return the dictionary (the device's description of itself) of a device with all parameters and codes.

    Parameters
    ----------
    device, firmware
        Name of the device and version of its firmware.
    simulated
        True if the device drives no real motor.
    current_quantum_a
        Size of one quantum of every current in the messages (A).
    current_measured
        True if the current is measured; otherwise the measured current repeats the set current.
    position_rate_default, position_rate_maximum
        Tick rate until the host configures one, and highest tick rate (Hz).
    ranges
        Minimum and maximum of each parameter whose range is narrower than in `PARAMETERS`, by parameter name.
    constants
        Constants of the rig that the device's safety monitors use.
    settings
        Build settings of the firmware, by their names in the board's configuration.
    """
    narrower = {"position_rate": (PARAMETERS[1].minimum, position_rate_maximum), **(ranges or {})}
    defaults = {"position_rate": position_rate_default}
    return Dictionary(
        device=device,
        firmware=firmware,
        simulated=simulated,
        current_quantum_a=current_quantum_a,
        current_measured=current_measured,
        position_rate_default=position_rate_default,
        position_rate_maximum=position_rate_maximum,
        constants=constants,
        settings=tuple(SettingInfo(name, value) for name, value in (settings or {}).items()),
        parameters=tuple(_info(parameter, narrower, defaults) for parameter in PARAMETERS),
        faults=tuple(_code_info(fault) for fault in Fault),
        statuses=tuple(_code_info(status) for status in Status),
    )


def encode(dictionary: Dictionary) -> bytes:
    """Return the compressed bytes of a dictionary; with one version of zlib, equal dictionaries give equal bytes."""
    plain = json.dumps(
        asdict(dictionary), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    packed = zlib.compress(plain.encode(), 9)
    if len(packed) > COMPRESSED_LIMIT:
        raise ValueError(
            f"the compressed dictionary has {len(packed)} bytes; the message IDENTITY allows at most {COMPRESSED_LIMIT}"
        )
    return packed


def dictionary_hash(packed: bytes) -> int:
    """Return the hash of a compressed dictionary: the first 8 bytes of its SHA-256 as a little-endian number."""
    return int.from_bytes(hashlib.sha256(packed).digest()[:8], "little")


def decode(packed: bytes) -> Dictionary:
    """Read a device's description of itself from its compressed bytes; raise `RemoteProtocolError` if invalid."""
    try:
        # Python's parser would accept NaN and Infinity, which JSON does not have.
        content = json.loads(_inflate(packed), parse_constant=_reject_constant)
        if not isinstance(content, dict):
            raise TypeError(f"the device's dictionary must be a JSON object, not {content!r}")
        return _dictionary(content)
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, zlib.error) as error:
        raise RemoteProtocolError(
            f"the device's dictionary (its description of itself) cannot be read: {error!r}"
        ) from error


def _inflate(packed: bytes) -> bytes:
    inflater = zlib.decompressobj()
    plain = inflater.decompress(packed, PLAIN_LIMIT)
    if not inflater.eof or inflater.unused_data:
        raise ValueError(
            f"the compressed dictionary is truncated, followed by other bytes, or above {PLAIN_LIMIT} bytes of text"
        )
    return plain


def _reject_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not allowed as a number; numbers must be finite")


def _dictionary(content: dict[str, Any]) -> Dictionary:
    return Dictionary(
        major=_integer_in_range(content, "major", 0, 255),
        minor=_integer_in_range(content, "minor", 0, 255),
        device=_text(content, "device"),
        firmware=_text(content, "firmware"),
        simulated=_typed(content, "simulated", bool),
        time_unit_ns=_positive(content, "time_unit_ns"),
        current_quantum_a=_positive(content, "current_quantum_a"),
        current_measured=_typed({"current_measured": False} | content, "current_measured", bool),
        position_rate_default=_integer_in_range(content, "position_rate_default", 1, 10**6),
        position_rate_maximum=_integer_in_range(content, "position_rate_maximum", 1, 10**6),
        constants=tuple(_constant(item) for item in _typed({"constants": []} | content, "constants", list)),
        settings=tuple(_setting(item) for item in _typed({"settings": []} | content, "settings", list)),
        parameters=tuple(_parameter(item) for item in _typed(content, "parameters", list)),
        faults=tuple(_code(item) for item in _typed(content, "faults", list)),
        statuses=tuple(_code(item) for item in _typed(content, "statuses", list)),
    )


def _parameter(item: Any) -> ParameterInfo:
    minimum, maximum, default = (_number(item, key) for key in ("minimum", "maximum", "default"))
    if not minimum <= default <= maximum:
        raise ValueError(
            f"default {default} of parameter {item['name']!r} is outside its range {minimum} … {maximum}"
        )
    return ParameterInfo(
        _integer_in_range(item, "id", 0, 0xFFFF),
        _text(item, "name"),
        _text(item, "ctype"),
        _text(item, "unit"),
        minimum,
        maximum,
        default,
    )


def _setting(item: Any) -> SettingInfo:
    value = item["value"]
    return SettingInfo(_text(item, "name"), value if isinstance(value, str) else _number(item, "value"))


def _constant(item: Any) -> ConstantInfo:
    return ConstantInfo(_text(item, "name"), _text(item, "unit"), float(_number(item, "value")))


def _code(item: Any) -> CodeInfo:
    return CodeInfo(
        _integer_in_range(item, "code", 0, 0xFFFF),
        _text(item, "name"),
        _text(item, "text"),
        _text(item, "remedy"),
    )


def _typed(item: Any, key: str, kind: type) -> Any:
    value = item[key]
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        raise TypeError(f"the dictionary's key {key} must be of type {kind.__name__}, not {value!r}")
    return value


def _text(item: Any, key: str) -> str:
    return str(_typed(item, key, str))


def _number(item: Any, key: str) -> Value:
    value: Value = item[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(f"the dictionary's key {key} must be a finite number, not {value!r}")
    return value


def _positive(item: Any, key: str) -> float:
    value = float(_number(item, key))
    if value <= 0.0:
        raise ValueError(f"the dictionary's key {key} must be above 0, not {value}")
    return value


def _integer_in_range(item: Any, key: str, minimum: int, maximum: int) -> int:
    value = int(_typed(item, key, int))
    if not minimum <= value <= maximum:
        raise ValueError(f"the dictionary's key {key} must be {minimum} … {maximum}, not {value}")
    return value


def _info(
    parameter: Parameter, narrower: Mapping[str, tuple[Value, Value]], defaults: Mapping[str, Value]
) -> ParameterInfo:
    minimum, maximum = narrower.get(parameter.name, (parameter.minimum, parameter.maximum))
    # The narrower range of a device may not contain the table's default: the nearest value in it replaces the default.
    default = defaults.get(parameter.name, parameter.default)
    return ParameterInfo(
        parameter.id,
        parameter.name,
        parameter.ctype,
        parameter.unit,
        minimum,
        maximum,
        min(max(default, minimum), maximum),
    )


def _code_info(code: Described) -> CodeInfo:
    return CodeInfo(int(code), code.name, code.text, code.remedy)


def explain_status(code: int, known: tuple[CodeInfo, ...]) -> CodeInfo:
    """Return name, text and remedy of a status code: from `known` (the device's codes), else from this package."""
    return _explain(known, Status, code)


def _explain(known: tuple[CodeInfo, ...], ours: type[Described], code: int) -> CodeInfo:
    theirs = next((info for info in known if info.code == code), None)
    if code in set(ours):
        return theirs or _code_info(ours(code))
    if ours is Fault and code in PORT_FAULTS and theirs is not None:
        return theirs
    unknown = f"{ours.__name__.lower()} {code} (unknown to this version)"
    if theirs is None:
        return CodeInfo(code, f"code {code}", unknown, "update this package and the firmware")
    return replace(theirs, text=f"{unknown}: {theirs.text}")
