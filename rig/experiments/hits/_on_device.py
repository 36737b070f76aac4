"""Run many recorded trials, one after another, on one device.

Measurements of maps and impedances call this module. Each trial is an ordinary hit (`rig.experiments.hits.hit`) with
the same checks and a recording.
"""

from __future__ import annotations

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
    url, realtime, verified, arm_anyway, hands_off
        Address of the device; run in real time; polarity of motor and encoder is verified; arm despite a bad link;
        called before the first torque pulse. Details: `rig.experiments.hits.hit.HitRequest`. The handle of a real rig
        without an index pulse must be at position zero when the measurement begins.
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
        """Return True if the device is simulated; each trial then creates a new one."""
        return self.url.startswith("sim:")


@dataclass(frozen=True, slots=True)
class Ended:
    """A trial that the guard or the device ended early: the error, the recording and the judgement."""

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
        """Run one trial and return its recording and judgement; raise the errors of `rig.experiments.hits.hit.hit`.

        `changes` have priority over the defaults for real time. If the guard or the device ended the trial and a
        recording exists, return an `Ended` and raise nothing.
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
    """Yield the trials of a measurement; a real device stays open and keeps its position zero until the block ends."""
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
    """Open the device; yield the device, real or simulated, and the series of trials on it.

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
    """Return the experiment's rates, stiffness and damping as changes, which override the defaults for real time."""
    controller, wall = experiment.controller, experiment.wall
    return {
        "controller.position_rate": controller.position_rate,
        "controller.velocity_rate": controller.velocity_rate,
        "wall.stiffness": wall.stiffness,
        "wall.damping": wall.damping,
        "trial.repeats": 1,
    }
