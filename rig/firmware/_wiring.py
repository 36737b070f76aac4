"""Draw and list the wiring of a board's reference rig, from the netlist ``wiring.toml`` beside its ``board.toml``.

`rig firmware wiring` calls it. It must not contain a pin number: these are settings of the board.
"""

import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from firmware_protocol.dictionary import SettingValue
from rig.core.errors import ConfigError
from rig.firmware._boards import Board
from rig.recording.files import whole_file

WIRING_FILE = "wiring.toml"
# Sizes in px: distance of columns, width of a box, distance of pins, margin, net names left of a box, wire, text line.
_COLUMN, _BOX, _PITCH, _MARGIN, _NET_NAME, _WIRE, _TEXT_LINE = 440, 235, 18, 40, 70, 22, 13
_TEXT_LINE_CHARACTERS = 36


@dataclass(frozen=True, slots=True)
class Pin:
    """A pin of a part: its name, and the name of the net (wire) to which it is connected."""

    name: str
    net: str


@dataclass(frozen=True, slots=True, kw_only=True)
class WiringPart:
    """A part of the rig: name, description, source of its pin numbers, and the pins on both sides of its drawn box."""

    name: str
    what: str
    source: str
    column: int
    left: tuple[Pin, ...]
    right: tuple[Pin, ...]


@dataclass(frozen=True, slots=True)
class Wiring:
    """All parts of a rig with their connected pins, in the order of the netlist."""

    parts: tuple[WiringPart, ...]

    def nets(self) -> dict[str, list[str]]:
        """Return the pins of each net (wire) as texts ``PART.pin``, by the name of the net."""
        found: dict[str, list[str]] = {}
        for part in self.parts:
            for pin in (*part.left, *part.right):
                found.setdefault(pin.net, []).append(f"{part.name}.{pin.name}")
        return found


def wiring(board: Board, settings: Mapping[str, SettingValue]) -> Wiring:
    """Return the wiring of a board's reference rig, with the pin numbers in `settings`.

    Raise `ConfigError` if the board has no netlist, or the netlist names a setting that the board does not have.
    """
    path = board.directory / WIRING_FILE
    if not path.is_file():
        raise ConfigError(
            f"board {board.name} has no {WIRING_FILE} (netlist) to draw",
            remedy="write a netlist like that of boards/rp2040",
        )
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["part"]
    return Wiring(
        tuple(_part(row, board, settings) for row in rows if _applies(row.get("where", {}), settings))
    )


def _applies(where: Mapping[str, SettingValue], settings: Mapping[str, SettingValue]) -> bool:
    return all(settings[name] == value for name, value in where.items())


def _part(row: Mapping[str, Any], board: Board, settings: Mapping[str, SettingValue]) -> WiringPart:
    sides = {
        side: tuple(
            Pin(_pin(name, board, settings), net)
            for name, net, *where in row.get(side, ())
            if all(_applies(one, settings) for one in where)
        )
        for side in ("left", "right")
    }
    return WiringPart(name=row["name"], what=row["what"], source=row["source"], column=row["column"], **sides)


def _pin(name: str, board: Board, settings: Mapping[str, SettingValue]) -> str:
    """Return a pin's name for the drawing; the name of a setting is replaced by its pin number and meaning."""
    setting, _, offset = (text.strip() for text in name.partition("+"))
    if setting not in board.settings:
        if setting.endswith("_pin"):
            raise ConfigError(
                f"{WIRING_FILE} of board {board.name}: unknown setting {setting!r}",
                remedy=f"use one of the board's settings: {', '.join(board.settings)}",
            )
        return name
    number = int(settings[setting]) + int(offset or 0)
    return f"GPIO{number} {setting.removesuffix('_pin')}{offset and f' + {offset}'}"


def draw(netlist: Wiring, path: Path) -> Path:
    """Write the wiring as an SVG drawing and return its path; raise `RecordingError` if the file cannot be written."""
    with whole_file(path, overwrite=True) as file:
        file.write(svg(netlist).encode())
    return path


def svg(netlist: Wiring) -> str:
    """Return the wiring as SVG text: a box for each part, with its pins and the names of their nets."""
    shapes: list[str] = []
    bottom = 0
    for column, parts in groupby(
        sorted(netlist.parts, key=lambda part: part.column), lambda part: part.column
    ):
        top = _MARGIN
        for part in parts:
            shapes += _box(part, _MARGIN + _NET_NAME + column * _COLUMN, top)
            top += _height(part) + _MARGIN + _PITCH * len(_wrap(part.what))
        bottom = max(bottom, top)
    width = _MARGIN + (1 + max(part.column for part in netlist.parts)) * _COLUMN
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {bottom}" font-family="sans-serif" '
    return "\n".join(
        [f'{head}font-size="11">', '<rect width="100%" height="100%" fill="white"/>', *shapes, "</svg>\n"]
    )


def _height(part: WiringPart) -> int:
    return _PITCH * (1 + max(len(part.left), len(part.right)))


def _box(part: WiringPart, x: int, y: int) -> Iterator[str]:
    words = [part.name, *_wrap(part.what)]
    for line, text in enumerate(words):
        yield _text(x, y - 4 + _TEXT_LINE * line, text, 'font-weight="bold"' if line == 0 else 'fill="#555"')
    y += _TEXT_LINE * (len(words) - 1)
    yield f'<rect x="{x}" y="{y}" width="{_BOX}" height="{_height(part)}" fill="#f4f7fb" stroke="#333"/>'
    for side, pins in ((-1, part.left), (1, part.right)):
        edge, inner, outer = (x, "start", "end") if side < 0 else (x + _BOX, "end", "start")
        for place, pin in enumerate(pins, start=1):
            at = y + _PITCH * place
            end = edge + side * _WIRE
            yield f'<line x1="{edge}" y1="{at}" x2="{end}" y2="{at}" stroke="#333"/>'
            yield _text(edge - 4 * side, at + 4, pin.name, f'text-anchor="{inner}" font-size="9"')
            yield _text(end + 3 * side, at + 4, pin.net, f'text-anchor="{outer}" fill="#0a58a8"')


def _text(x: int, y: int, text: str, look: str) -> str:
    return f'<text x="{x}" y="{y}" {look}>{escape(text)}</text>'


def _wrap(text: str) -> list[str]:
    return textwrap.wrap(text, _TEXT_LINE_CHARACTERS, break_long_words=False)
