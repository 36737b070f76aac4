"""A rig as a C constant: its data for the firmware's core, and the wiring of the board.

`board_config.h` has the board's settings as numbers for the preprocessor and declares two constants: `board_config`
(struct board of the core) and `image_record` (`rig.firmware.record`), in which the first finds its dictionary.
"""

from __future__ import annotations

import math
import struct
from dataclasses import asdict, dataclass, replace

from firmware_protocol import dictionary as dictionaries
from firmware_protocol.dictionary import SettingValue
from firmware_protocol.parameter import Parameter, Value
from firmware_protocol.parameters import PARAMETERS
from rig.core.board import current_sensor, describe, moved_mechanics, over_current
from rig.core.model import RigModel
from rig.firmware.boards import Board
from rig.firmware.record import ImageFacts, Record, pack
from rig.firmware.scales import monitor_step_a, set_point_step_a

RATE_INITIAL = 1_000  # Hz, until configured
_BYTES_A_LINE = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardConfig:
    """The generated files, and the record that is in them."""

    header: str
    source: str
    record: Record


def configure(
    board: Board, model: RigModel, settings: dict[str, SettingValue], *, package: str, sources: str
) -> BoardConfig:
    """Write the constants of one rig on one board.

    Parameters
    ----------
    board, model
        What it runs on, and what hangs there.
    settings
        All settings of the board (`rig.firmware.boards.settings_of`).
    package, sources
        Version of this package, and fingerprint of the C sources.
    """
    model = _measured(model, settings)
    facts = ImageFacts(
        package=package, sources=sources, board=board.name, rig=model.name, settings=dict(settings)
    )
    dictionary = describe(
        model,
        firmware=f"haptic-rig {package} for {board.name}, sources {sources}",
        simulated=False,
        rate_default=RATE_INITIAL,
        rate_maximum=board.rate_maximum,
        settings=settings,
        narrower={
            "law": (0, board.law_maximum),
            "excitation_period": (2, max(2, board.excitation_ticks)),
            **({} if board.excitation_ticks else {"excitation_lines": (0, 0)}),
        },
    )
    record = Record(facts, dictionary.packed)
    return BoardConfig(
        header=_header(board, model, settings), source=_source(board, model, record), record=record
    )


def _measured(model: RigModel, settings: dict[str, SettingValue]) -> RigModel:
    """Return the rig with the current sensor that the board has: none, or one as coarse as converter and output."""
    amplifier, monitor = model.amplifier, settings.get("current_monitor")
    if monitor == "none":
        amplifier = replace(amplifier, current_monitor=False)
    elif monitor == "adc":
        step_a = math.hypot(monitor_step_a(settings), set_point_step_a(model, settings) or 0.0)
        noise_a = math.hypot(amplifier.current_noise_a, step_a / math.sqrt(12.0))
        amplifier = replace(amplifier, current_noise_a=noise_a)
    return replace(model, amplifier=amplifier)


def _header(board: Board, model: RigModel, settings: dict[str, SettingValue]) -> str:
    lines = [
        f"/* {board.name} for the rig {_one_line(model.name)}. Made by `rig firmware build`: an edit is lost. */",
        "#ifndef HR_BOARD_CONFIG_H",
        "#define HR_BOARD_CONFIG_H",
        "",
        "#include <stdint.h>",
        "",
        '#include "board.h"',
        "",
        f"#define BOARD_CURRENT_QUANTUM_A {model.amplifier.current_quantum_a!r} /* A */",
        f"#define BOARD_EXCITATION_TICKS {board.excitation_ticks}u",
    ]
    lines += [_define(board, name, value) for name, value in settings.items()]
    return "\n".join(
        [
            *lines,
            "",
            "extern const struct board board_config;",
            "",
            "/* Identifies the image; the linker must keep it. */",
            "extern const uint8_t image_record[];",
            "",
            "#endif",
            "",
        ]
    )


def _define(board: Board, name: str, value: SettingValue) -> str:
    setting = board.settings[name]
    unit = f"{setting.unit}: " if setting.unit else ""
    comment = f"/* {unit}{setting.meaning} */"
    if isinstance(value, str):  # a choice: a name of its own for each, so that #if can ask
        return f"#define BOARD_{name.upper()}_{value.upper()} 1 {comment}"
    number = f"({value!r})" if value < 0 else repr(value)
    return f"#define BOARD_{name.upper()} {number} {comment}"


def _source(board: Board, model: RigModel, record: Record) -> str:
    content = pack(record)
    at = len(content) - len(record.packed)
    narrowed = narrower(record.dictionary)
    mechanics, sensor = (
        ",\n".join(f"        .{name} = {value!r}" for name, value in asdict(part).items())
        for part in (moved_mechanics(model), current_sensor(model))
    )
    lines = [
        f"/* {board.name} for the rig {_one_line(model.name)}. Made by `rig firmware build`: an edit is lost. */",
        '#include "board_config.h"',
        "",
        '#include "protocol.h"',
        "",
        "const uint8_t image_record[] = {",
        *_byte_lines(content),
        "};",
        "",
        *_excitation(board),
        "static const struct narrower narrower[] = {",
        *(
            f"    {{HR_PARAMETER_{parameter.name.upper()}, {low:#x}u, {high:#x}u}},"
            for parameter, low, high in narrowed
        ),
        "};",
        "",
        "const struct board board_config = {",
        f"    .dictionary = image_record + {at},",
        f"    .dictionary_bytes = {len(record.packed)},",
        f"    .dictionary_hash = UINT64_C({record.dictionary_hash:#018x}),",
        f"    .rate_initial = {RATE_INITIAL},",
        "    .narrower = narrower,",
        f"    .narrower_count = {len(narrowed)},",
        f"    .encoder_sign = {model.encoder.sign},",
        f"    .over_current = {over_current(model)},",
        "    .mechanics = {",
        f"{mechanics},",
        "    },",
        "    .current_sensor = {",
        f"{sensor},",
        "    },",
        *_where_excitation(board),
        "};",
        "",
    ]
    return "\n".join(lines)


def _excitation(board: Board) -> list[str]:
    return ["static int16_t excitation[BOARD_EXCITATION_TICKS];", ""] if board.excitation_ticks else []


def _where_excitation(board: Board) -> list[str]:
    if not board.excitation_ticks:
        return []
    return ["    .excitation = excitation,", "    .excitation_length = BOARD_EXCITATION_TICKS,"]


def _byte_lines(content: bytes) -> list[str]:
    return [
        "    " + " ".join(f"{byte:#04x}," for byte in content[at : at + _BYTES_A_LINE])
        for at in range(0, len(content), _BYTES_A_LINE)
    ]


def narrower(dictionary: dictionaries.Dictionary) -> list[tuple[Parameter, int, int]]:
    """Parameters whose range is not the table's, with both bounds as on the wire, rising by parameter."""
    found: list[tuple[Parameter, int, int]] = []
    for parameter in PARAMETERS:
        info = dictionary.parameter(parameter.name)
        assert info is not None
        if (info.minimum, info.maximum) != (parameter.minimum, parameter.maximum):
            low, high = (_bits(parameter.ctype, bound) for bound in (info.minimum, info.maximum))
            found.append((parameter, low, high))
    return found


def _bits(ctype: str, value: Value) -> int:
    """Return a value as its four bytes on the wire, read as a number."""
    if ctype == "f32":
        (bits,) = struct.unpack("<I", struct.pack("<f", value))
        return int(bits)
    assert math.trunc(value) == value
    return int(value) & 0xFFFFFFFF


def _one_line(text: str) -> str:
    """Return a text that cannot end a comment."""
    return "".join(character if character.isprintable() else " " for character in text).replace("*/", "* /")
