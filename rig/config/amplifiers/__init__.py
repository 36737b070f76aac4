"""Profiles of motor amplifiers: how an amplifier receives its set-point, and how to configure it with the maker's tool.

Each TOML file in this folder is a profile. The firmware outputs a set-point to an external amplifier; it has no current
loop of its own.

Predictions of `rig.doctor`, `rig firmware`, firmware builds and `rig.experiments.new_rig` read the profiles. This file
must not configure an amplifier: a person does that with the maker's tool.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Literal

from rig.core.present import Item, Row

_IN_IN = "a bridge with two inputs is at full reverse with the direction at 1 and a duty near 0"
# Never: a set-point of −1 quantum would be the largest torque.
REFUSED = dict.fromkeys(("in-in-bridge", "l298n", "drv8871", "tb6612", "bts7960"), _IN_IN)


@dataclass(frozen=True, slots=True, kw_only=True)
class AmplifierProfile:
    """Properties of one motor amplifier from its data sheet.

    Attributes
    ----------
    name, description
        Name for the key `rig.amplifier.profile`, and description in one line.
    source
        Data sheet that gives the numbers, or a note that no data sheet was read.
    drive
        ``current``: the amplifier has a current loop; ``voltage``: it has none; None: both are possible.
    set_point_delay_s
        Delay from a set-point to the response of the amplifier (s). For PWM, half a period until the next pulse begins
        and half a period until its width is measured, at worst twice that. For an analogue voltage, the time to send
        the value to the converter, to settle, and until the amplifier samples the voltage.
    most_a
        Largest current of the amplifier (A); None: unknown.
    steps
        Number of distinct set-points from full negative to full positive current; None: not limited by the amplifier.
    pwm_frequency
        Lowest and highest PWM frequency that the amplifier accepts (Hz); None: unknown.
    settings
        Settings of the board that replace the board's defaults.
    set_up
        Instructions for settings at the amplifier.
    """

    name: str
    description: str
    source: str
    drive: Literal["current", "voltage"] | None = None
    set_point_delay_s: float = 0.0
    most_a: float | None = None
    steps: int | None = None
    pwm_frequency: tuple[float, float] | None = None
    settings: Mapping[str, float | int | str] = field(default_factory=dict)
    set_up: tuple[str, ...] = ()

    def items(self) -> list[Item]:
        """Return the profile as text and rows for printing."""
        asked = {"profile": f'"{self.name}"'}
        if self.drive is not None:
            asked["drive"] = f'"{self.drive}"'
        if self.set_point_delay_s:
            asked["set_point_delay_s"] = f"{self.set_point_delay_s:g}"
        board = ", ".join(f"{name} = {value}" for name, value in self.settings.items())
        return [
            f"{self.name}: {self.description}",
            Row("[rig.amplifier]", ", ".join(f"{key} = {value}" for key, value in asked.items())),
            Row("board", board or "its defaults"),
            *(Row("set up", text) for text in self.set_up),
            Row("source", self.source),
        ]


@cache
def names() -> tuple[str, ...]:
    """Return the sorted names of all amplifier profiles."""
    found = (entry.name for entry in files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


@cache
def load(name: str) -> AmplifierProfile:
    """Return the amplifier profile with this name, which must be one of `names`."""
    content = tomllib.loads((files(__name__) / f"{name}.toml").read_text(encoding="utf-8"))
    for key in ("set_up", "pwm_frequency"):
        if key in content:
            content[key] = tuple(content[key])
    return AmplifierProfile(name=name, **content)
