"""Generate the firmware's `protocol.h` and `protocol.c` (C99) from the tables in Python.

The C files contain type ids, the offset of each field in a raw frame, states and their transitions, parameters and
codes, so that no number of the protocol is written twice. Names are those of PROTOCOL.md with the prefix ``HR_``.
`firmware_protocol.codegen` writes the files. Do not edit these, and do not write a number here that a table already
has.
"""

import re
import struct
from collections.abc import Callable, Iterable
from enum import IntEnum, IntFlag
from pathlib import Path

from firmware_protocol import framing
from firmware_protocol import messages as m
from firmware_protocol.connection import TRANSITIONS, State
from firmware_protocol.faults import Fault, Input, LimitFlag, Status
from firmware_protocol.packing import FAULT_ENTRY_BYTES, LAYOUTS, Header, Layout
from firmware_protocol.parameter import Parameter
from firmware_protocol.parameters import BLOCK_LIMIT, PARAMETERS
from firmware_protocol.replies import REMEMBERED
from firmware_protocol.wire import FORMATS, wire_fields

CORE = Path(__file__).with_name("firmware") / "core"
# A byte that is not the number of a state.
NO_TRANSITION = 0xFF

_GENERATED_NOTE = "/* Made by `python -m firmware_protocol.codegen` from the tables that run: do not edit. */"
_PARAMETER_ENTRY = struct.Struct("<HI")  # an entry of a parameter block: id, four bytes of value
# CRC-32 of IEEE 802.3 with its bits reversed, as `zlib.crc32` computes it.
_CRC_POLYNOMIAL = 0xEDB88320
_STRUCT_CODES = {"u": "I", "i": "i", "f": "f"}
_KINDS = {"u": "HR_UNSIGNED", "i": "HR_SIGNED", "f": "HR_FLOAT"}


def title(cls: type) -> str:
    """Return the name of a message class in PROTOCOL.md, for example "SET_BEGIN" for the class `SetBegin`."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).upper()


def _define(name: str, value: int, comment: str = "") -> str:
    text = f"#define HR_{name} {value}u"
    return f"{text} /* {comment} */" if comment else text


def _enum(prefix: str, codes: type[IntEnum] | type[IntFlag]) -> list[str]:
    rows = [f"    HR_{prefix}_{code.name} = {int(code)}," for code in codes]
    return [f"enum hr_{prefix.lower()} {{", *rows, "};", ""]


def _offsets(name: str, cls: type, start: int) -> list[str]:
    lines, at = [], start
    for field, wire in wire_fields(cls).items():
        unit = f", {wire.unit}" if wire.unit else ""
        lines.append(_define(f"AT_{name}_{field.upper()}", at, f"{wire.ctype}{unit}"))
        if wire.ctype in FORMATS:
            at += struct.calcsize("<" + FORMATS[wire.ctype])
    return lines


def _constants() -> list[str]:
    return [
        _define("MAJOR", m.MAJOR),
        _define("MINOR", m.MINOR),
        _define("TIME_UNITS_PER_US", round(1000 / m.TIME_UNIT_NS), "of device time"),
        _define("HEADER_BYTES", framing.HEADER_BYTES),
        _define("CRC_BYTES", framing.CRC_BYTES),
        _define("SHORT_RAW_LIMIT", framing.SHORT_RAW_LIMIT, "raw frame with its CRC, but for BATCH"),
        _define("RAW_LIMIT", framing.RAW_LIMIT, "BATCH"),
        _define("RAW_MINIMUM", framing.RAW_MINIMUM),
        _define("ENCODED_LIMIT", framing.ENCODED_LIMIT, "stuffed, without the delimiter"),
        _define("NO_COMMAND_YET", m.NO_COMMAND_YET, "STATE.command_age"),
        _define("OLDEST_EDGE", m.OLDEST_EDGE, "age at which STATE.edge_time saturates"),
        _define("TRANSACTION_END", 0x40, "type ids below are answered"),
        _define("DEVICE_BIT", 1, "of a type id: sent by the device"),
        _define("USB_VENDOR", m.USB_VENDOR),
        _define("USB_PRODUCT", m.USB_PRODUCT),
        _define("BLOCK_LIMIT", BLOCK_LIMIT, "bytes of a parameter block"),
        _define("PARAMETER_BYTES", _PARAMETER_ENTRY.size, "an entry of a block: id, value"),
        _define("FAULT_ENTRY_BYTES", FAULT_ENTRY_BYTES),
        "",
    ]


def _message_lines() -> list[str]:
    lines = ["enum hr_type {"]
    lines += [f"    HR_TYPE_{title(cls)} = 0x{type_id:02X}," for type_id, cls in m.MESSAGES.items()]
    lines += ["};", "", "/* Where a message lies in hr_messages. */", "enum hr_index {"]
    lines += [f"    HR_INDEX_{title(cls)}," for cls in m.MESSAGES.values()]
    lines += ["    HR_MESSAGES", "};", ""]
    lines += ["/* HR_AT_…: offset in the raw frame. HR_BYTES_…: header and fixed fields. */"]
    lines += _offsets("HEADER", Header, 0)
    for layout in LAYOUTS.values():
        name = title(m.MESSAGES[layout.type_id])
        lines += ["", *_offsets(name, m.MESSAGES[layout.type_id], framing.HEADER_BYTES)]
        lines.append(_define(f"BYTES_{name}", framing.HEADER_BYTES + layout.size))
        if layout.tail:
            lines.append(_define(f"DATA_LIMIT_{name}", layout.data_limit, "bytes of data"))
    return [*lines, "", "/* In an entry of FAULT_LOG. */", *_offsets("FAULT_ENTRY", m.FaultEntry, 0), ""]


def _parameter_lines() -> list[str]:
    lines = ["/* Where a parameter lies in hr_parameters. */", "enum hr_parameter_index {"]
    lines += [f"    HR_PARAMETER_{p.name.upper()}," for p in PARAMETERS]
    return [*lines, "    HR_PARAMETERS", "};", ""]


_STRUCTS = """\
struct hr_message {
    uint8_t type;
    uint8_t bytes;      /* header and fixed fields */
    uint8_t limit;      /* longest raw frame without its CRC */
    uint8_t remembered; /* a repeat gets the same answer and is not executed again */
};

/* How the four bytes of a value are read. */
enum hr_kind {
    HR_UNSIGNED,
    HR_SIGNED,
    HR_FLOAT,
};

struct hr_parameter {
    uint16_t id;
    uint8_t kind;        /* enum hr_kind */
    uint8_t excludes;    /* whether there is a value inside the range that is not allowed */
    uint8_t live;        /* whether it may change while the device is armed */
    uint32_t minimum;    /* these four as on the wire */
    uint32_t maximum;
    uint32_t initial;
    uint32_t excluded;
};

extern const struct hr_message hr_messages[HR_MESSAGES];
extern const struct hr_parameter hr_parameters[HR_PARAMETERS]; /* rising by id */

/* State × message → state after it, or HR_NO_TRANSITION: refused. */
extern const uint8_t hr_transitions[HR_STATES][HR_MESSAGES];

/* One byte of CRC-32/ISO-HDLC. */
extern const uint32_t hr_crc_table[256];
"""


def header() -> str:
    """Return the C text of the firmware's protocol.h."""
    lines = [_GENERATED_NOTE, "#ifndef HR_PROTOCOL_H", "#define HR_PROTOCOL_H", "", "#include <stdint.h>", ""]
    lines += _constants()
    lines += _message_lines()
    for prefix, codes in _CODES.items():
        lines += _enum(prefix, codes)
    lines += [_define("STATES", len(State)), _define("NO_TRANSITION", NO_TRANSITION), ""]
    lines += _parameter_lines()
    return "\n".join([*lines, _STRUCTS, "#endif", ""])


def source() -> str:
    """Return the C text of the firmware's protocol.c."""
    parts = [
        _table("struct hr_message hr_messages[HR_MESSAGES]", map(_message_row, LAYOUTS.values())),
        _table("struct hr_parameter hr_parameters[HR_PARAMETERS]", map(_parameter_row, PARAMETERS)),
        _table("uint8_t hr_transitions[HR_STATES][HR_MESSAGES]", map(_transition_row, State)),
        _table("uint32_t hr_crc_table[256]", _crc_rows()),
    ]
    return "\n".join([_GENERATED_NOTE, '#include "protocol.h"', "", *parts])


def _table(declaration: str, rows: Iterable[str]) -> str:
    return "\n".join([f"const {declaration} = {{", *(f"    {row}" for row in rows), "};", ""])


def _message_row(layout: Layout) -> str:
    bytes_, limit = (framing.HEADER_BYTES + size for size in (layout.size, layout.limit))
    remembered = int(layout.type_id in REMEMBERED)
    name = title(m.MESSAGES[layout.type_id])
    return f"{{HR_TYPE_{name}, {bytes_}, {limit}, {remembered}}},"


def _wire_bits(parameter: Parameter, value: float) -> str:
    packed = struct.pack("<" + _STRUCT_CODES[parameter.ctype[0]], value)
    return f"0x{int.from_bytes(packed, 'little'):08X}u"


def _parameter_row(parameter: Parameter) -> str:
    excluded = (*parameter.excluded, 0)[0]
    if len(parameter.excluded) > 1:
        raise ValueError(
            f"parameter {parameter.name} excludes {len(parameter.excluded)} values; the firmware's table allows one"
        )
    values = (parameter.minimum, parameter.maximum, parameter.default, excluded)
    bits = ", ".join(_wire_bits(parameter, value) for value in values)
    kind = _KINDS[parameter.ctype[0]]
    flags = f"{len(parameter.excluded)}, {int(parameter.live)}"
    return f"{{{parameter.id}, {kind}, {flags}, {bits}}}, /* {parameter.name} */"


def _transition_row(state: State) -> str:
    cells = (TRANSITIONS[state].get(cls, NO_TRANSITION) for cls in m.MESSAGES.values())
    return f"{{{', '.join(str(int(cell)) for cell in cells)}}}, /* {state.name} */"


def _crc_rows() -> list[str]:
    values = []
    for byte in range(256):
        remainder = byte
        for _ in range(8):
            remainder = remainder >> 1 ^ (_CRC_POLYNOMIAL if remainder & 1 else 0)
        values.append(f"0x{remainder:08X}u,")
    return [" ".join(values[row : row + 8]) for row in range(0, 256, 8)]


_CODES: dict[str, type[IntEnum] | type[IntFlag]] = {
    "STATE": State,
    "FAULT": Fault,
    "LIMIT": LimitFlag,
    "STATUS": Status,
    "INPUT": Input,
    "MODE": m.Mode,
    "SYNC": m.Sync,
    "DISARM": m.DisarmFlag,
}

FILES: dict[Path, Callable[[], str]] = {CORE / "protocol.h": header, CORE / "protocol.c": source}
