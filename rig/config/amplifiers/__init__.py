"""Profiles of amplifiers: how a set-point reaches them, and the settings for their makers' tools.

A TOML file here is a profile. The firmware gives the set-point of an external amplifier and closes no current loop.

Predictions of `rig.doctor`, `rig firmware`, builds of images and `rig.experiments.new_rig` read it. It must not set up
an amplifier: a person does that with the maker's tool.
"""

from __future__ import annotations

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
    """One amplifier.

    Attributes
    ----------
    name, description
        As `rig.amplifier.profile` names it; in one line.
    source
        The data sheet that was opened for it, or that none was.
    drive
        ``current``: it closes a current loop; ``voltage``: it does not; None: either.
    set_point_delay_s
        From a set-point to the amplifier's answer (s). Of a pulse width half a period until the next one begins, and
        half of one until it has been seen, twice that at worst; of a voltage its transfer, its settling, and until the
        amplifier has looked.
    most_a
        Largest current it gives (A); None: not known.
    steps
        Distinct set-points from full negative to full positive current; None: as many as are sent.
    pwm_frequency
        Least and greatest pulse width rate that it takes (Hz); None: not known.
    settings
        Settings of the board: defaults instead of the board's own.
    set_up
        Settings to make at the amplifier.
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
        """Return the profile's values, for people."""
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
    """Return the names of all profiles, sorted."""
    found = (entry.name for entry in files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


@cache
def load(name: str) -> AmplifierProfile:
    """Return the profile of one of `names`."""
    content = tomllib.loads((files(__name__) / f"{name}.toml").read_text(encoding="utf-8"))
    for key in ("set_up", "pwm_frequency"):
        if key in content:
            content[key] = tuple(content[key])
    return AmplifierProfile(name=name, **content)
