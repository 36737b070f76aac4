"""Read the description of a board (compiler flags, memory, settings) from the ``board.toml`` of its port.

A port is a directory with board-specific C files, a linker script and ``board.toml``, in
`firmware_protocol/firmware/boards` or anywhere else. A new board needs no Python code. All of `rig firmware` uses it.
It must not know a particular board.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from os.path import normpath
from pathlib import Path
from typing import Annotated, Any, ClassVar

from annotated_types import Ge, Gt, Len

import firmware_protocol
from firmware_protocol.dictionary import SettingValue
from rig.config.checked import read_toml
from rig.core.deferred import pydantic
from rig.core.errors import ConfigError
from rig.core.present import Item, Row
from rig.core.quantity import STRICT

FIRMWARE = Path(firmware_protocol.__file__).with_name("firmware")
BOARDS = FIRMWARE / "boards"
BOARD_FILE = "board.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSetting:
    """A setting of a board (pin, scale or choice), which the C sources read as the macro ``BOARD_NAME``.

    The type of the default is the type of the value: integer, float, or a text that is one of `choices`. `pins` above
    0: the value is a pin, the first of so many consecutive ones, which no other setting may use while the settings in
    `where` have the given values.
    """

    name: str
    default: SettingValue
    meaning: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    pins: int = 0
    where: Mapping[str, SettingValue] = field(default_factory=dict)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryRegion:
    """A region of the processor's memory that an image may use: first address, and size (bytes)."""

    origin: Annotated[int, Ge(0)]
    bytes: Annotated[int, Gt(0)]

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFile:
    """Contents of ``board.toml``.

    Attributes
    ----------
    description
        Description of the board in one line.
    processors
        Name of a processor → compiler flags; the first entry is the board's default processor.
    compile, link
        Further flags for the compiler, and for the linker.
    linker_script
        File name of the linker script in the port's directory.
    applications
        Name of a program → the source files that only this program has. ``device`` is the firmware.
    rate_maximum
        Highest tick rate (Hz).
    law_maximum
        Highest value of the parameter ``law``: 0 no law on the board, 1 in integers, 2 also in float32.
    excitation_ticks
        Longest period of an excitation signal (ticks); 0 if the board cannot play one.
    flash, ram
        Memory regions for program and data.
    uf2_family
        UF2 family of the boot ROM; left out if the boot ROM accepts no UF2.
    drive
        Board-ID of the boot ROM's drive, as in its INFO_UF2.TXT.
    sealed_behind
        Number of bytes at the start of the image that its checksum (CRC-32 in the last word) leaves out; left out: the
        image has no checksum.
    settings
        Settings by name; see `BoardSetting`.
    reserved_pins
        Pin → purpose for which the port always uses it.
    """

    description: str
    processors: Annotated[Mapping[str, tuple[str, ...]], Len(min_length=1)]
    linker_script: str
    rate_maximum: Annotated[int, Gt(0)]
    law_maximum: Annotated[int, Ge(0)]
    excitation_ticks: Annotated[int, Ge(0)]
    flash: MemoryRegion
    ram: MemoryRegion
    compile: tuple[str, ...] = ("-O2",)
    link: tuple[str, ...] = ()
    applications: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"device": ()})
    uf2_family: int | None = None
    drive: str = ""
    sealed_behind: Annotated[int, Ge(0)] | None = None
    settings: Mapping[str, BoardSetting] = field(default_factory=dict)
    reserved_pins: Mapping[int, str] = field(default_factory=dict)

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, slots=True, kw_only=True)
class Board(BoardFile):
    """A board with one of its processors.

    Attributes
    ----------
    name
        Name on the command line: the directory's name, or ``directory-processor`` for one of several processors.
    directory
        Directory of the board port (the board's own code).
    processor
        Compiler flags of the processor.
    """

    name: str
    directory: Path
    processor: tuple[str, ...]

    def items(self) -> list[Item]:
        """Return the board's description and a row (name with default, meaning) for each of its settings, to print."""
        named = [
            Row(f"{name} = {one.default}", f"{one.meaning}{f' ({one.unit})' if one.unit else ''}")
            for name, one in self.settings.items()
        ]
        return [f"{self.name}: {self.description}, up to {self.rate_maximum / 1e3:g} kHz", *named]

    def sources(self, application: str) -> tuple[Path, ...]:
        """Return the C and assembler files of the program `application`: files of all programs, then its own files."""
        special = {name for names in self.applications.values() for name in names}
        found = sorted(path for path in self.directory.iterdir() if path.suffix in (".c", ".S"))
        own = (Path(normpath(self.directory / name)) for name in self.applications[application])
        return (*(path for path in found if path.name not in special), *own)


def names() -> list[str]:
    """Return the names of all boards of this package; a board with several processors has also ``board-processor``."""
    found = []
    for path in sorted(BOARDS.glob("*/board.toml")):
        found.append(path.parent.name)
        processors = _read(path).processors
        if len(processors) > 1:
            found += [f"{path.parent.name}-{processor}" for processor in processors]
    return found


def load(name: str) -> Board:
    """Return a board of this package by its name, or the board whose ``board.toml`` is in the directory `name`.

    Raise `ConfigError` if the name is unknown, or its ``board.toml`` is not valid; the message lists each wrong key.
    """
    own, processor = Path(name), ""
    if not (own / BOARD_FILE).is_file():
        if name not in names():
            known = ", ".join(names())
            raise ConfigError(
                f"unknown board {name!r}",
                remedy=f"choose one of: {known}, or give a directory with a {BOARD_FILE}",
            )
        directory, _, processor = name.partition("-")
        own = BOARDS / directory
    read = _read(own / BOARD_FILE)
    return Board(
        name=name if own.parent == BOARDS else own.resolve().name,
        directory=own.resolve(),
        processor=read.processors[processor or next(iter(read.processors))],
        **{each.name: getattr(read, each.name) for each in fields(BoardFile)},
    )


@cache
def _read(path: Path) -> BoardFile:
    content = read_toml(path, "a board's")
    if isinstance(content.get("settings"), dict):
        named = {key: {"name": key, **entry} for key, entry in content["settings"].items()}
        content = {**content, "settings": named}
    try:
        return pydantic.TypeAdapter(BoardFile).validate_json(json.dumps(content))  # type: ignore[no-any-return]
    except pydantic.ValidationError as error:
        wrong = (f"{path}: {'.'.join(map(str, one['loc']))}: {one['msg']}" for one in error.errors())
        raise ConfigError(
            "\n".join(wrong),
            remedy=f"correct these keys in {BOARD_FILE}; PORTING.md lists all keys of a board",
        ) from None


def settings_of(board: Board, chosen: Mapping[str, Any]) -> dict[str, SettingValue]:
    """Return the value of each setting of a board by name: from `chosen`, else the board's default.

    Raise `ConfigError` if the board does not have a chosen setting, a value is out of range, or two settings use the
    same pin.
    """
    for name in chosen:
        if name not in board.settings:
            known = ", ".join(board.settings) or "none"
            raise ConfigError(
                f"board {board.name} has no setting {name!r}", remedy=f"choose one of its settings: {known}"
            )
    values = {
        name: _check_setting(board, setting, chosen.get(name, setting.default))
        for name, setting in board.settings.items()
    }
    _check_pins(board, values)
    return values


def _check_pins(board: Board, values: Mapping[str, SettingValue]) -> None:
    used = dict(board.reserved_pins)
    for name, setting in board.settings.items():
        if not setting.pins or any(values[other] != value for other, value in setting.where.items()):
            continue
        for pin in range(int(values[name]), int(values[name]) + setting.pins):
            if pin in used:
                raise ConfigError(
                    f"{used[pin]} and {name} of board {board.name} both use pin {pin}",
                    remedy=f"choose another pin for one of them; {name} occupies {setting.pins} consecutive pins",
                )
            used[pin] = name


def _check_setting(board: Board, setting: BoardSetting, value: Any) -> SettingValue:
    wanted = type(setting.default)
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    low, high = setting.minimum, setting.maximum
    good = type(value) is wanted
    if good and isinstance(value, str):
        good = value in setting.choices
    elif good:
        good = (low is None or value >= low) and (high is None or value <= high)
    if not good:
        raise ConfigError(
            f"{setting.name} = {value!r} is not allowed for board {board.name} ({setting.meaning})",
            remedy=f"give {_describe_range(setting)}",
        )
    return value  # type: ignore[no-any-return]


def _describe_range(setting: BoardSetting) -> str:
    if setting.choices:
        return " or ".join(setting.choices)
    kind = "a whole number" if isinstance(setting.default, int) else "a number"
    bounds = "" if setting.minimum is None else f" from {setting.minimum:g}"
    bounds += "" if setting.maximum is None else f" to {setting.maximum:g}"
    return f"{kind}{bounds}{' ' if setting.unit else ''}{setting.unit}"
