"""Run many recorded trials, one after another, on one device.

Measurements of maps and impedances call it. Each trial is an ordinary hit (`rig.experiments.hits.hit`) with its checks
and its recording.
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
    """Device to measure, and settings of the measurement.

    Attributes
    ----------
    url, realtime, verified, arm_anyway, hands_off
        As in `rig.experiments.hits.hit.HitRequest`. The handle of a real rig without an index must be at position zero
        when the measurement begins.
    recordings
        Directory of the recordings.
    device, reference_count
        Real device that the caller has opened already, and its encoder count at position zero; the device stays open.
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
    """Trial that the guard or the device ended early: its error, and its recording with the judgement."""

    error: GuardError | DeviceFaultError
    recorded: Recorded


@dataclass(frozen=True, slots=True)
class Trials:
    """Trials on one device that stays open; with `device` None each trial opens a new one. One stop ends all trials."""

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
        """Run one trial and return its recording; raise the errors of `rig.experiments.hits.hit.hit`.

        `changes` override the experiment's changes for real time. If the guard or the device ended the trial and a
        recording exists, return it as `Ended` and raise nothing.
        """
        request = HitRequest(
            experiment=experiment,
            url=self.where.url,
            realtime=self.where.realtime,
            device=self.device,
            reference_count=self.reference_count,
            changes={**_asked_for(experiment), **changes},
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
    """Yield the trials of a measurement; a real device stays open and keeps its position zero meanwhile."""
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
    """Yield the open device, also a simulated one, and the trials on it; the caller can check it before it moves."""
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


def _asked_for(experiment: Experiment) -> dict[str, Any]:
    """Return the experiment's rates, stiffness and damping as changes; defaults for real time do not replace them."""
    controller, wall = experiment.controller, experiment.wall
    return {
        "controller.position_rate": controller.position_rate,
        "controller.velocity_rate": controller.velocity_rate,
        "wall.stiffness": wall.stiffness,
        "wall.damping": wall.damping,
        "trial.repeats": 1,
    }
