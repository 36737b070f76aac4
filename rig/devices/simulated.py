"""Interfaces of the simulation in addition to a link.

They are: a rig for thousands of hits on a wall in a minute, without a link; a rig with a second actuator that excites
it; and a link in virtual time with scripted faults, whose device can be inspected.

`sim_backend` implements them; `rig.devices`, hits of `rig.experiments` and `rig.testing` use them. This file must not
import `sim_backend`.
"""

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
class Rendering:
    """Wall that a hit rendered in its trial phase, and the error of the estimated velocity in that phase.

    Attributes
    ----------
    stiffness, damping
        Least-squares fit of the commanded effort without its constant part to the true penetration and its rate, over
        the ticks with a true penetration above zero (N·m/rad or N/m; N·m·s/rad or N·s/m). NaN if penetration and rate
        are proportional.
    velocity_error
        Root mean square of estimated minus true velocity at the encoder (rad/s or m/s).
    """

    stiffness: float
    damping: float
    velocity_error: float


@dataclass(frozen=True, slots=True)
class SimulatedHit:
    """Result of one simulated hit on a wall, measured from the signals that a rig records and from exact signals."""

    recorded: Measured
    true: Measured
    rendering: Rendering
    ticks: int  # of the whole run, homing included


class SimulatedRig(Protocol):
    """Simulated rig that hits a wall again and again, each time from rest. Use one object per thread."""

    def hit(self, controller: ControllerState, start: float) -> SimulatedHit:
        """Simulate one hit from rest at position `start` (rad or m) with a new controller, which cannot be used again.

        The controller may assume another effort constant or encoder resolution than the rig has, to simulate such
        errors. Raise `rig.core.errors.LawError` if estimator or law return a value that is not finite.
        """
        ...


class OpenRig(Protocol):
    """Function of the simulation that creates rigs for hits on a wall, with one tick length for all hits."""

    def __call__(
        self, model: RigModel, tick_s: float, thresholds: Thresholds, most_ticks: int
    ) -> SimulatedRig:
        """Create a simulated rig whose hits take at most `most_ticks` ticks of `tick_s` (s), judged with `thresholds`.

        Raise `ConfigError` if the simulation cannot use this `tick_s`.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ExcitedMotion:
    """Result of a simulated excitation: counts, positions and velocities, and how the safety limits changed the effort.

    Attributes
    ----------
    counts, position, velocity
        Encoder count, and true position and velocity of the handle (rad or m, rad/s or m/s), `acquisition_s` apart; the
        first values are those of the law's first sample.
    withheld
        Sent effort minus wanted effort in each tick of the law (N·m or N), by rounding to the current quantum and by
        clipping.
    saturated
        Number of ticks in which a safety limit clipped the effort or its slew rate.
    ticks
        Number of executed ticks of the law; fewer than requested if a safety limit ended the run.
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
        """Run the law for `ticks` ticks from rest at a position (rad or m), while a second actuator excites the link.

        The controller must be new, and is not used again. `excitation` is one period of the second actuator's effort on
        the link (N·m or N), one value per integration step of the plant; its amplitude rises from zero within `ramp_s`
        (s).

        Raise `rig.core.errors.LawError` if estimator or law return a value that is not finite.
        """
        ...

    @property
    def inner_rate_hz(self) -> float:
        """Return the rate of the plant's integration steps (Hz)."""
        ...


class OpenExcitedSimulation(Protocol):
    """Function of the simulation that creates rigs with a second actuator for excitation."""

    def __call__(
        self, model: RigModel, tick_s: float, acquisition_hz: float, most_ticks: int
    ) -> ExcitedSimulation:
        """Create a simulated rig whose law runs every `tick_s` (s), for runs of at most `most_ticks` ticks.

        Positions are stored at `acquisition_hz`, or at the next higher rate that the integration step allows. Raise
        `ConfigError` if the simulation cannot use this `tick_s`.
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
        """Return how many faults of the script have affected frames so far."""
        ...

    @property
    def current(self) -> int:
        """Return the active current of the simulated device after all limits (current quanta)."""
        ...

    @property
    def armed(self) -> bool:
        """Return True if the simulated device is armed: it would accept a command."""
        ...

    def elapse(self, duration_s: float) -> None:
        """Advance the simulated device's time by `duration_s` (s) without the host, also on a closed link."""
        ...


class OpenWatchedLink(Protocol):
    """Function of the simulation that opens links with a script of faults."""

    def __call__(self, url: DeviceUrl, model: RigModel | None, faults: Faults | None) -> WatchedLink:
        """Open a link to a simulated rig with scripted `faults` (None: no faults); `ConfigError` for an invalid URL."""
        ...
