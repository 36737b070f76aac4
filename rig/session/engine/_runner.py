"""Interface between the engine of a session and a rig that runs the trials and returns their results.

`DeviceRunner` and the runners of tests implement it. The engine uses a rig in no other way.
"""

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
    """A wall that a session may present, as an experiment; `changes` are the sampling rates to set on a device."""

    condition: str
    experiment: Experiment
    changes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedWalls:
    """The walls of one condition and damping that run only if the operator allows it: the link's delay unsettles them.

    `stiffness` contains their stiffnesses, ascending; `walls` is the number of all walls of this condition and damping,
    and `text` the reason for the softest refused wall.
    """

    condition: str
    damping: float
    stiffness: tuple[float, ...]
    walls: int
    text: str


@dataclass(frozen=True, slots=True)
class TrialDone:
    """Result of a trial: the hit, the error that ended the hit early (or None), and the duration (s)."""

    hit: HitOutcome
    error: Exception | None
    duration_s: float


class TrialRunner(Protocol):
    """Interface of an object that runs the trials of a session on a rig: `DeviceRunner`, or a substitute in tests.

    `hand` is the file through which a person moves the simulated hand; None if it hits by itself. With `arm_anyway` the
    operator accepts walls that the link's delay makes unstable, with `lossy_anyway` the loss of samples.
    """

    hand: Path | None
    arm_anyway: bool
    lossy_anyway: bool

    @property
    def simulated(self) -> bool:
        """True if the device is simulated, so that no real rig can move."""
        ...

    @property
    def virtual(self) -> bool:
        """True if trials run in virtual time, as fast as the computer simulates."""
        ...

    @property
    def messages(self) -> Sequence[str]:
        """Messages about permissions that this computer or the port did not grant, without repetition."""
        ...

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return facts about the device, its clock and this computer, which the log stores.

        `changes` are sampling rates, by key, that replace those of the experiment and of the device.
        """
        ...

    def refusals(self, walls: Sequence[SessionWall]) -> Sequence[RefusedWalls]:
        """Return the walls that need the operator's consent, because the delay of the link makes them unstable."""
        ...

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        """Measure lost and late samples at the experiment's rate, without motion; return None in virtual time.

        `changes` (by key) override the experiment and the device's rates.
        """
        ...

    def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> Sequence[Check]:
        """Check that device and link can run an experiment with its settings `changes` unchanged; nothing moves."""
        ...

    def pulse(self, experiment: Experiment, changes: Mapping[str, Any], directory: Path, name: str) -> Pulse:
        """Apply a short torque pulse, with no hand on the handle, to check the motion against the rig's description.

        Record the pulse as `name` in `directory`. `changes` (by key) override the experiment and the device's rates.
        """
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
        """Run one trial and return its result: the hit, the error that ended it early (or None), and its duration.

        The parameters are those of `DeviceRunner.hit`: experiment, changed rates, name of the recording, and so on.
        """
        ...

    def close(self) -> None:
        """Close the device, if one was opened."""
        ...
