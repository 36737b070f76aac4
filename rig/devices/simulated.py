"""Interfaces that the simulation offers in addition to a link.

They are: a rig for thousands of hits a minute without a link, a rig with a second actuator that excites it, and a link
in virtual time with scripted faults, whose device can be inspected.

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
    """Result of one simulated hit: as a rig would have recorded it, and from the true signals."""

    recorded: Measured
    true: Measured
    ticks: int  # of the whole run, homing included


class SimulatedRig(Protocol):
    """Simulated rig that runs hits one after another, each from rest. Use one object per thread."""

    def hit(self, controller: ControllerState, start: float) -> SimulatedHit:
        """Run one trial from rest at position `start` (rad or m), with a new controller that is not used again.

        Raise `rig.core.errors.LawError` when estimator or law return a value that is not finite.
        """
        ...


class OpenRig(Protocol):
    """Factory function of the simulation for rigs with one tick length and one kind of trial."""

    def __call__(
        self, model: RigModel, tick_s: float, thresholds: Thresholds, most_ticks: int
    ) -> SimulatedRig:
        """Return a rig; trials end after `most_ticks` at the latest. Raise `ConfigError` for an impossible `tick_s`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ExcitedMotion:
    """Result of an excitation: positions, velocities and counts, and changes of the effort by the guard.

    Attributes
    ----------
    counts, position, velocity
        Encoder count, and true position and velocity of the handle (rad or m), `acquisition_s` apart; the first
        are those of the law's first sample.
    withheld
        Sent effort minus wanted effort in each tick of the law (N·m or N), by rounding to the current quantum and by
        clipping.
    saturated
        Number of ticks in which the guard clipped the effort or limited its slew rate.
    ticks
        Number of executed ticks of the law; fewer than requested if the guard ended the run.
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
    """Simulated rig that a second actuator excites about a position. Use one object per thread."""

    def excite(
        self,
        controller: ControllerState,
        position: float,
        excitation: NDArray[np.float64],
        ramp_s: float,
        ticks: int,
    ) -> ExcitedMotion:
        """Run the law for `ticks` ticks, from rest at a position (rad or m).

        The controller must be new, and is not used again. `excitation` is one period of the second actuator's effort on
        the link (N·m or N), one value per inner step; its amplitude rises from zero within `ramp_s` (s).

        Raise `rig.core.errors.LawError` when estimator or law return a value that is not finite.
        """
        ...

    @property
    def inner_rate_hz(self) -> float:
        """Return the rate of the inner steps of the plant (Hz)."""
        ...


class OpenExcitedSimulation(Protocol):
    """Factory function of the simulation for rigs to excite."""

    def __call__(
        self, model: RigModel, tick_s: float, acquisition_hz: float, most_ticks: int
    ) -> ExcitedSimulation:
        """Return a rig whose law runs every `tick_s` (s), for runs of at most `most_ticks`.

        Positions are stored at `acquisition_hz`, or at the next higher rate that the inner step allows. Raise
        `ConfigError` for an impossible `tick_s`.
        """
        ...


class WatchedLink(Link, Protocol):
    """Link in virtual time whose simulated device can be inspected directly, even if the link is broken."""

    @property
    def frames(self) -> Mapping[Direction, int]:
        """Return the number of frames sent so far in each direction; empty without a script of faults."""
        ...

    @property
    def struck(self) -> int:
        """Return the number of faults of the script that have affected frames so far."""
        ...

    @property
    def current(self) -> int:
        """Return the active current of the device after all limits (current quanta)."""
        ...

    @property
    def armed(self) -> bool:
        """Return True if the device would accept a command."""
        ...

    def elapse(self, duration_s: float) -> None:
        """Advance the device's time by `duration_s` (s) without the host, also on a closed link."""
        ...


class OpenWatchedLink(Protocol):
    """Factory function of the simulation for links with a script of faults."""

    def __call__(self, url: DeviceUrl, model: RigModel | None, faults: Faults | None) -> WatchedLink:
        """Open a link; with `faults` None it never fails. Errors as `rig.devices.open_link`."""
        ...
