"""A wall that neither this computer nor the board renders, but what is behind the board: what an extra says of it.

Plans (`rig.experiments.trials.plan`) and the design of the device's parameters call it. Theory, maps and judgements
only have to know that there is such a wall (`Controller.wall_is_elsewhere`): it has filters that they do not have.
"""

from __future__ import annotations

from typing import Protocol

from firmware_protocol.dictionary import Dictionary
from rig.config._sections import Experiment
from rig.control.on_device import Control
from rig.control.step import ControllerState
from rig.core import extras
from rig.core.check import Check


class WallElsewhere(Protocol):
    """What an extra adds for an arithmetic of its own.

    Attributes
    ----------
    stands_for
        Note on how a simulation under the host's law represents it.
    """

    stands_for: str

    def refuse_what_it_lacks(self, controller: ControllerState, c: Control) -> None:
        """Raise `NotOnDeviceError` for what such a wall cannot be."""
        ...

    def planned(self, experiment: Experiment) -> list[Check]:
        """Return what a plan says of it."""
        ...

    def fits(self, experiment: Experiment, dictionary: Dictionary) -> list[Check]:
        """Return whether a device can render the wall of an experiment."""
        ...


def wall_elsewhere(arithmetic: str) -> WallElsewhere:
    """Return what the extra of an arithmetic says; raises `ConfigError` where that extra is missing."""
    found: WallElsewhere = extras.load("arithmetics", arithmetic)()
    return found
