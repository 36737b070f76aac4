"""Interface to an optional package ("extra") for a wall that a motor drive behind the board renders.

Plans (`rig.experiments.trials.plan`) and the computation of the device's parameters call it. Theory, maps and verdicts
only check `Controller.wall_is_elsewhere`, because such a wall has filters that they do not model.
"""

from typing import Protocol

from firmware_protocol.dictionary import Dictionary
from rig.config._sections import Experiment
from rig.control.on_device import Control
from rig.control.step import ControllerState
from rig.core import extras
from rig.core.check import Check


class WallElsewhere(Protocol):
    """Functions that an optional package provides for a wall that a motor drive renders in its own arithmetic.

    Attributes
    ----------
    stands_for
        Note on how a simulation with the host's law represents this wall.
    """

    stands_for: str

    def refuse_what_it_lacks(self, controller: ControllerState, c: Control) -> None:
        """Raise `NotOnDeviceError` if the controller, with the settings `c`, has a feature that the drive lacks."""
        ...

    def planned(self, experiment: Experiment) -> list[Check]:
        """Return checks of whether the drive can render the experiment's wall, for a plan without a device."""
        ...

    def fits(self, experiment: Experiment, dictionary: Dictionary) -> list[Check]:
        """Return checks of whether a device that describes itself by `dictionary` can render the experiment's wall."""
        ...


def wall_elsewhere(arithmetic: str) -> WallElsewhere:
    """Return the functions of the optional package for walls on a motor drive; raise `ConfigError` if it is missing.

    `arithmetic` is the value of ``controller.arithmetic``, such as "drive".
    """
    found: WallElsewhere = extras.load("arithmetics", arithmetic)()
    return found
