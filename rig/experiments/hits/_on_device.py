"""Run many recorded trials, one after another, on one device.

Maps of stable walls and measurements of impedance call this module. Each trial is an ordinary hit
(`rig.experiments.hits.hit`) with the same checks and a recording.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig import config, devices
from rig.config import Experiment
from rig.control.laws import Law
from rig.core.errors import DeviceFaultError, GuardError
from rig.devices.framed import FramedDevice
from rig.devices.local import open_for_run
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, Recorded, hit, left_by
from rig.experiments.trials.preparation import position_zero
from rig.realtime import stop_requests
from rig.realtime.stop_requests import RunSeries


@dataclass(frozen=True, slots=True, kw_only=True)
class OnDevice:
    """A device to measure, and the settings of the measurement.

    Attributes
    ----------
    url, realtime
        Address of the device; True to run in real time. A real handle without an index must be at position zero at
        first.
    verified, arm_anyway
        True if the operator checked the signs of motor and encoder; True to arm although the link is bad.
    hands_off
        Called with the instruction to take all hands off the handle, before the torque pulse that checks a real rig.
    recordings
        Directory of the recordings.
    device, reference_count
        Real device that the caller has opened already, and its encoder count at position zero; the measurement does not
        close the device.
    """

    url: str
    recordings: str | Path = "recordings"
    realtime: bool = False
    verified: bool = False
    arm_anyway: bool = False
    hands_off: Callable[[str], None] | None = None
    device: FramedDevice | None = None
    reference_count: int = 0

    @property
    def simulated(self) -> bool:
        """Return True if the device is simulated; then each trial creates a new simulation."""
        return self.url.startswith("sim:")


@dataclass(frozen=True, slots=True)
class Ended:
    """A trial that ended early: the error (of the safety guard or the device), its recording and its judgement."""

    error: GuardError | DeviceFaultError
    recorded: Recorded


@dataclass(frozen=True, slots=True)
class Trials:
    """A series of trials on one device that stays open; if `device` is None, each trial opens a new device.

    A request to stop ends the whole series.
    """

    where: OnDevice
    device: FramedDevice | None
    reference_count: int | None
    series: RunSeries = field(default_factory=RunSeries)

    def run(
        self,
        experiment: Experiment,
        changes: Mapping[str, Any],
        law: Law | Callable[[float], Law] | None = None,
    ) -> Recorded | Ended:
        """Run one trial with `changes` (values by dotted key) of the experiment; return its recording and judgement.

        If the safety guard or the device ended the trial and a recording exists, return it as an `Ended`. Raise
        `PlanError` if the trial is not permitted, and `RigError` after any other early end; the effort is zero.
        """
        request = HitRequest(
            experiment=experiment,
            url=self.where.url,
            realtime=self.where.realtime,
            device=self.device,
            reference_count=self.reference_count,
            changes={**_fixed_changes(experiment), **changes},
            verified=self.where.verified,
            output=self.where.recordings,
            arm_anyway=self.where.arm_anyway,
            hands_off=self.where.hands_off,
            law=law,
        )
        try:
            with self.series:
                (result,) = hit(request, admit)
        except (GuardError, DeviceFaultError) as error:
            # Without a recording nothing moved, and the caller cannot judge it.
            left = left_by(error)
            if left is None:
                raise
            return Ended(error, left)
        return result.recorded


@contextmanager
def kept_open(where: OnDevice, experiment: Experiment) -> Iterator[Trials]:
    """Open the device for several trials; a real device stays open and keeps its position zero until the block ends."""
    with stop_requests.listening() as series:
        if where.simulated:
            yield Trials(where, None, None, series)
            return
        if where.device is not None:
            yield Trials(where, where.device, where.reference_count, series)
            return
        # A real device stays open all along, so that position zero stays where it was when the measurement began.
        with devices.open_device(where.url, config.rig_model(experiment)) as device:
            zero = position_zero(device, experiment) if where.verified else 0
            yield Trials(where, device, zero, series)


@contextmanager
def examined(where: OnDevice, experiment: Experiment) -> Iterator[tuple[FramedDevice, Trials]]:
    """Open the device; yield the device, real or simulated, and an object that runs trials on it.

    The caller can check the device before the first trial moves the handle.
    """
    if where.device is not None:
        with stop_requests.listening() as series:
            yield where.device, Trials(where, where.device, where.reference_count, series)
        return
    with (
        stop_requests.listening() as series,
        open_for_run(
            devices.url_for(where.url, experiment.controller.loop),
            config.rig_model(experiment),
            in_real_time=where.realtime,
            seed=experiment.trial.seed,
            realtime=experiment.host.realtime,
        ) as device,
    ):
        zero = position_zero(device, experiment) if where.verified and not where.simulated else 0
        yield device, Trials(where, None if where.simulated else device, zero, series)


def _fixed_changes(experiment: Experiment) -> dict[str, Any]:
    """Return the experiment's rates, stiffness and damping by key, so that real time does not change them."""
    controller, wall = experiment.controller, experiment.wall
    return {
        "controller.position_rate": controller.position_rate,
        "controller.velocity_rate": controller.velocity_rate,
        "wall.stiffness": wall.stiffness,
        "wall.damping": wall.damping,
        "trial.repeats": 1,
    }
