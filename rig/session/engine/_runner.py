"""Interface of the engine to a rig: where trials are run, and what is reported about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rig.config import Experiment
from rig.core.check import Check
from rig.session.planning._trial import HitOutcome

if TYPE_CHECKING:
    from rig.doctor.pace import Pace
    from rig.experiments.motion.pulse import Pulse

Watch = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionWall:
    """A wall that a session may ask for, and what of it a device must not change."""

    condition: str
    experiment: Experiment
    changes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedWalls:
    """What the gate refuses of one condition at one damping, out of so many walls; why, for the softest of them."""

    condition: str
    damping: float
    stiffness: tuple[float, ...]
    walls: int
    text: str


@dataclass(frozen=True, slots=True)
class TrialDone:
    """A trial that was run: its hit, what ended it early, if anything did, and how long it took (s)."""

    hit: HitOutcome
    error: Exception | None
    duration_s: float


class TrialRunner(Protocol):
    """Where trials are run: a rig (`DeviceRunner`), or what a test puts in its place.

    `hand` is the file through which a person moves the simulated hand, None while it plays its script. `arm_anyway`:
    the operator consented to walls that the arming gate refuses; `lossy_anyway`: to a computer or a link that loses
    samples.
    """

    hand: Path | None
    arm_anyway: bool
    lossy_anyway: bool

    @property
    def simulated(self) -> bool:
        """Return True if no rig can move."""
        ...

    @property
    def virtual(self) -> bool:
        """Return True if time is the simulation's own."""
        ...

    @property
    def messages(self) -> Sequence[str]:
        """Return messages about permissions that this computer or the port did not grant, each once."""
        ...

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the log stores about the device, its clock and this computer."""
        ...

    def refusals(self, walls: Sequence[SessionWall]) -> Sequence[RefusedWalls]:
        """Return which of these walls the rig does not arm without consent; see `DeviceRunner.refusals`."""
        ...

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        """Measure the losses of this computer and the link at an experiment's rate; None in virtual time."""
        ...

    def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> Sequence[Check]:
        """Check whether the device and its link carry an experiment; nothing moves."""
        ...

    def pulse(self, experiment: Experiment, changes: Mapping[str, Any], directory: Path, name: str) -> Pulse:
        """Send the rig a torque pulse, without a hand on the handle; see `rig.experiments.motion.pulse.pulse`."""
        ...

    def hit(
        self,
        experiment: Experiment,
        changes: Mapping[str, Any],
        directory: Path,
        name: str,
        watch: Callable[[Experiment], Watch | None],
        heat: float,
        blinded: bool = False,
    ) -> TrialDone:
        """Run one trial, and return what the log keeps of it; see `DeviceRunner.hit`."""
        ...

    def close(self) -> None:
        """Close the device, if one was opened."""
        ...
