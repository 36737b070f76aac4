"""A board as the compiler and its wiring see it, read from the ``board.toml`` beside its port.

A port is a directory, of `firmware_protocol/firmware/boards` or anywhere else: C files, a linker script and this file.
A new board needs no line of Python.
"""

from __future__ import annotations

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
    """A pin, a scale or a choice of a board, which the C sources see as ``BOARD_NAME``.

    A whole default asks for a whole number, a default with a point for any number, a text for one of `choices`. With
    `pins` it is the first of so many pins, which nothing else may use, if the settings of `where` have these values.
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
    """A stretch of memory that an image may fill."""

    origin: Annotated[int, Ge(0)]
    bytes: Annotated[int, Gt(0)]

    __pydantic_config__: ClassVar[dict[str, Any]] = STRICT


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFile:
    """What ``board.toml`` says.

    Attributes
    ----------
    description
        In one line.
    processors
        Name → flags for the compiler; the first is the board's own.
    compile, link
        More flags for the compiler; for the linker.
    linker_script
        Beside the sources.
    applications
        Name of a program → the source files that only it has. ``device`` is the firmware.
    rate_maximum
        Most ticks a second (Hz).
    law_maximum
        Laws that it can run itself (parameter ``law``): 0 none, 1 integers, 2 float32 as well.
    excitation_ticks
        Room for one period of an excitation; 0: none.
    flash, ram
        Memory regions for program and data.
    uf2_family
        Of its boot ROM; left out when it takes no UF2.
    drive
        Board-ID of the boot ROM's drive, as in its INFO_UF2.TXT.
    sealed_behind
        The image's last word is the CRC-32 of all that lies between so many bytes and it; left out: it has none.
    settings
        By name; see `BoardSetting`.
    reserved_pins
        Pin → what the port uses it for, whatever the settings are.
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
    """One board, with one of its processors.

    Attributes
    ----------
    name
        As on the command line, or of its directory; one with several processors is ``directory-processor``.
    directory
        Of its port.
    processor
        Flags for the compiler.
    """

    name: str
    directory: Path
    processor: tuple[str, ...]

    def items(self) -> list[Item]:
        """Return the board and its settings as rows to print."""
        named = [
            Row(f"{name} = {one.default}", f"{one.meaning}{f' ({one.unit})' if one.unit else ''}")
            for name, one in self.settings.items()
        ]
        return [f"{self.name}: {self.description}, up to {self.rate_maximum / 1e3:g} kHz", *named]

    def sources(self, application: str) -> tuple[Path, ...]:
        """Return C and assembler files of one of its programs: those of the port by name, then the program's own."""
        special = {name for names in self.applications.values() for name in names}
        found = sorted(path for path in self.directory.iterdir() if path.suffix in (".c", ".S"))
        own = (Path(normpath(self.directory / name)) for name in self.applications[application])
        return (*(path for path in found if path.name not in special), *own)


def names() -> list[str]:
    """Return every board of this package; of one with several processors the plain name, then each."""
    found = []
    for path in sorted(BOARDS.glob("*/board.toml")):
        found.append(path.parent.name)
        processors = _read(path).processors
        if len(processors) > 1:
            found += [f"{path.parent.name}-{processor}" for processor in processors]
    return found


def load(name: str) -> Board:
    """Return a board of `names`, or the one whose ``board.toml`` is in the directory of this name.

    Raises
    ------
    ConfigError
        It is neither, or its file is not right: with every key that is not.
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
        raise ConfigError("\n".join(wrong), remedy="see the keys of a board in PORTING.md") from None


def settings_of(board: Board, chosen: Mapping[str, Any]) -> dict[str, SettingValue]:
    """Return all settings of a board, defaults where nothing was chosen.

    Raises
    ------
    ConfigError
        A setting that the board does not have, or a value that it cannot have.
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
    """Refuse two uses of one pin."""
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
            f"{setting.name} = {value!r} of board {board.name}: {setting.meaning}",
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
