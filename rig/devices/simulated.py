"""What a backend that simulates offers beside a link.

A rig to hit without bytes, thousands of times a minute; and a link that fails on command, with its far end in sight.

The simulation offers these; `rig.devices`, hits of `rig.experiments` and `rig.testing` ask for them. This file must not
import `sim_backend`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.control.step import ControllerState
from rig.control.verdict import Measured, Thresholds
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl, Link
from rig.devices.fault_script import Direction, Faults


@dataclass(frozen=True, slots=True)
class SimulatedHit:
    """What came of one hit: measured as a rig would have recorded it, and as it really was."""

    recorded: Measured
    true: Measured
    ticks: int  # of the whole run, homing included


class SimulatedRig(Protocol):
    """A rig at rest, hit after hit. One for each thread."""

    def hit(self, controller: ControllerState, start: float) -> SimulatedHit:
        """Run one trial from rest at a position (rad or m); the controller is fresh, and used up.

        Raises `rig.core.errors.LawError` when estimator or law give something that is not finite.
        """
        ...


class OpenRig(Protocol):
    """The function behind a backend's name: makes a rig for ticks of one length and trials of one kind."""

    def __call__(
        self, model: RigModel, tick_s: float, thresholds: Thresholds, most_ticks: int
    ) -> SimulatedRig:
        """Prepare a rig; trials longer than `most_ticks` are cut off. Raises `ConfigError` for an impossible tick."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ExcitedMotion:
    """What came of the excitation a rig: positions, velocities and counts, and what the guard took off the effort.

    Attributes
    ----------
    counts, position, velocity
        Encoder count, and true position and velocity of the handle (rad or m), `acquisition_s` apart; the first
        are those of the law's first sample.
    withheld
        Effort sent less effort wanted in each tick of the law (N·m or N): rounding to the current quantum, clipping.
    saturated
        Ticks in which the guard clipped or slewed the effort.
    ticks
        Ticks of the law that ran: fewer than asked when the guard ended the run.
    acquisition_s
        Time between two positions (s).
    """

    counts: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    withheld: NDArray[np.float64]
    saturated: int
    ticks: int
    acquisition_s: float


class ExcitedSimulation(Protocol):
    """A rig that a second actuator excites about a point, run after run. One for each thread."""

    def excite(
        self,
        controller: ControllerState,
        position: float,
        excitation: NDArray[np.float64],
        ramp_s: float,
        ticks: int,
    ) -> ExcitedMotion:
        """Run the law for so many ticks, from rest at a position (rad or m).

        The controller is fresh, and used up. `excitation` is one period of the second actuator's effort on the link
        (N·m or N), a value for each inner step, active during that step; it rises in `ramp_s` from zero.

        Raises `rig.core.errors.LawError` when estimator or law give something that is not finite.
        """
        ...

    @property
    def inner_rate_hz(self) -> float:
        """Return the inner steps of the plant in a second (Hz)."""
        ...


class OpenExcitedSimulation(Protocol):
    """The function behind a backend's name: makes a rig to excite."""

    def __call__(
        self, model: RigModel, tick_s: float, acquisition_hz: float, most_ticks: int
    ) -> ExcitedSimulation:
        """Prepare a rig whose law runs every `tick_s`, for runs of at most so many ticks.

        Positions are kept `acquisition_hz` times a second, or as near above that as the inner step allows. Raises
        `ConfigError` for an impossible tick.
        """
        ...


class WatchedLink(Link, Protocol):
    """A link in virtual time whose far end can be looked at, also when no frame comes through any more."""

    @property
    def frames(self) -> Mapping[Direction, int]:
        """Return the frames sent so far in each direction; none where there is no script of faults."""
        ...

    @property
    def struck(self) -> int:
        """Return the faults of the script that have happened to frames."""
        ...

    @property
    def current(self) -> int:
        """Return the active current of the device, after all limits (quanta)."""
        ...

    @property
    def armed(self) -> bool:
        """Return True if the device would take a command."""
        ...

    def elapse(self, duration_s: float) -> None:
        """Let time pass without the host, on a closed link too (s)."""
        ...


class OpenWatchedLink(Protocol):
    """The function behind a backend's name: opens a link, with a script of what goes wrong on it."""

    def __call__(self, url: DeviceUrl, model: RigModel | None, faults: Faults | None) -> WatchedLink:
        """Open it; None is a link that never fails. Errors as `rig.devices.open_link`."""
        ...
