"""Interface between the engine and a rig: it runs trials and returns their results."""

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
    """Wall that a session may present, and the settings of its experiment that a device must not change."""

    condition: str
    experiment: Experiment
    changes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedWalls:
    """Walls that the arming gate refuses for a condition and a damping.

    `stiffness` are the refused walls, `walls` the number of all walls, `text` the reason for the softest refused one.
    """

    condition: str
    damping: float
    stiffness: tuple[float, ...]
    walls: int
    text: str


@dataclass(frozen=True, slots=True)
class TrialDone:
    """Result of a trial: its hit, the error that ended it early (or None), and its duration (s)."""

    hit: HitOutcome
    error: Exception | None
    duration_s: float


class TrialRunner(Protocol):
    """Runner of trials: a rig (`DeviceRunner`), or a substitute in tests.

    `hand` is the file through which a person moves the simulated hand, or None if it plays its script. With
    `arm_anyway` the operator accepts walls that the arming gate refuses, with `lossy_anyway` the loss of samples.
    """

    hand: Path | None
    arm_anyway: bool
    lossy_anyway: bool

    @property
    def simulated(self) -> bool:
        """Return True if the device is simulated, so that no real rig can move."""
        ...

    @property
    def virtual(self) -> bool:
        """Return True if trials run in virtual time."""
        ...

    @property
    def messages(self) -> Sequence[str]:
        """Return messages about permissions that this computer or the port did not grant, without repetition."""
        ...

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return what the log stores about the device, its clock and this computer."""
        ...

    def refusals(self, walls: Sequence[SessionWall]) -> Sequence[RefusedWalls]:
        """Return the walls that the rig arms only with consent; see `DeviceRunner.refusals`."""
        ...

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        """Measure lost and late samples at an experiment's rate; return None in virtual time."""
        ...

    def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> Sequence[Check]:
        """Check whether the device and its link can run an experiment; nothing moves."""
        ...

    def pulse(self, experiment: Experiment, changes: Mapping[str, Any], directory: Path, name: str) -> Pulse:
        """Apply a torque pulse, with no hand on the handle; see `rig.experiments.motion.pulse.pulse`."""
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
        """Run one trial and return its result; see `DeviceRunner.hit`."""
        ...

    def close(self) -> None:
        """Close the device, if one was opened."""
        ...
