"""What a backend that simulates offers beside a link: a rig to hit without bytes, thousands of times a minute."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rig.model import RigModel
    from rig.step import Controller
    from rig.verdict import Limits, Measured


@dataclass(frozen=True, slots=True)
class SimulatedHit:
    """What came of one hit: measured as a rig would have recorded it, and as it really was."""

    recorded: Measured
    true: Measured
    ticks: int  # of the whole run, homing included


class SimulatedRig(Protocol):
    """A rig at rest, hit after hit. One for each thread."""

    def hit(self, controller: Controller, start: float) -> SimulatedHit:
        """Run one trial from rest at a position (rad or m); the controller is fresh, and used up.

        Raises `rig.errors.LawError` when estimator or law give something that is not finite.
        """
        ...


class OpenRig(Protocol):
    """The function behind a backend's name: makes a rig for ticks of one length and trials of one kind."""

    def __call__(self, model: RigModel, tick_s: float, limits: Limits, most_ticks: int) -> SimulatedRig:
        """Prepare a rig; trials longer than `most_ticks` are cut off. Raises `ConfigError` for an impossible tick."""
        ...
