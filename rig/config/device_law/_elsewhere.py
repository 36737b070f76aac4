"""Interface to an extra for a wall that a drive behind the board renders, not this computer or the board.

Plans (`rig.experiments.trials.plan`) and the design of the device's parameters call it. Theory, maps and verdicts only
check `Controller.wall_is_elsewhere`, because such a wall has filters that they do not model.
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
    """Functions that an extra provides for a wall in its own arithmetic.

    Attributes
    ----------
    stands_for
        Note on how a simulation with the host's law represents this wall.
    """

    stands_for: str

    def refuse_what_it_lacks(self, controller: ControllerState, c: Control) -> None:
        """Raise `NotOnDeviceError` if the controller has a feature that this wall does not support."""
        ...

    def planned(self, experiment: Experiment) -> list[Check]:
        """Return the checks of this wall for a plan."""
        ...

    def fits(self, experiment: Experiment, dictionary: Dictionary) -> list[Check]:
        """Return checks whether a device with this dictionary can render the wall of an experiment."""
        ...


def wall_elsewhere(arithmetic: str) -> WallElsewhere:
    """Return the `WallElsewhere` of an extra's arithmetic; raise `ConfigError` if the extra is missing."""
    found: WallElsewhere = extras.load("arithmetics", arithmetic)()
    return found
