"""Run the trials of a session on a device as recorded hits, and compute the values of each hit for the log.

The engine (`_conduct`) uses it as a `TrialRunner`. It must not choose the wall of a trial.
"""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig import config, devices
from rig.config import Experiment
from rig.control.verdict import CRITERIA, Kind
from rig.core.check import Check
from rig.core.errors import DeviceFaultError, LinkLostError
from rig.core.model import RigModel
from rig.core.present import plain
from rig.core.same_rig import check_rig
from rig.devices.device import Link
from rig.devices.framed import FramedDevice
from rig.devices.local import open_for_run
from rig.doctor.pace import Pace, measured_pace
from rig.experiments.hits.admission import admit, vetted
from rig.experiments.hits.hit import HitRequest, Recorded, hit, in_effect, left_by
from rig.experiments.motion.pulse import Pulse, pulse
from rig.experiments.trials.judgement import THREW_OUT, THROWN_OUT
from rig.experiments.trials.plan import device_checks, link_checks
from rig.experiments.trials.preparation import position_zero, prepared_on
from rig.recording.data import Recording
from rig.recording.files import free_name, plain_errors, sha256_of
from rig.recording.header import host_facts
from rig.session.engine._arming import refusals
from rig.session.engine._baseline import baseline
from rig.session.engine._pace import sentence
from rig.session.engine._place import software
from rig.session.engine._runner import RefusedWalls, SessionWall, TrialDone, Watch
from rig.session.planning._bands import press_of
from rig.session.planning._trial import HitOutcome

NUMBERS = (
    "felt",
    "felt_floor",
    "heard",
    "moved",
    "growth",
    "exits",
    "contact_s",
    "impact_velocity",
    "peak_penetration",
    "resting_penetration",
    "settling_s",
    "peak_effort",
    "saturated_fraction",
    "late_ticks",
    "gaps",
)


@dataclass(slots=True, kw_only=True)
class DeviceRunner:
    """Object that runs the trials of a session on a device, real or simulated.

    In virtual time each trial uses a new device; in real time all trials use the same device.

    Attributes
    ----------
    url
        URL of the device; None to simulate.
    realtime
        True if a simulated device runs in real time.
    verified
        True if the operator confirms that the polarity of the rig is verified.
    arm_anyway
        True if the operator consents, for the whole session, to walls that are unstable with the measured delay.
    lossy_anyway
        True to begin although nearly every trial would be invalid because of lost samples.
    hand
        File through which a person moves the simulated hand (`rig.realtime.hand`); None if it hits by itself.
    messages
        Messages about permissions that this computer or the port did not grant, without repetition.
    """

    url: str | None = None
    realtime: bool = False
    verified: bool = False
    arm_anyway: bool = False
    lossy_anyway: bool = False
    hand: Path | None = None
    messages: list[str] = field(default_factory=list)
    # A real device stays open from the first trial to the last, so that its zero is read once; so does a simulated one
    # in real time, as long as conditions do not change the machine itself.
    _open: FramedDevice | None = None
    # Model of the rig, and file of the simulated hand, with which the open device was made.
    _served: tuple[RigModel, Path | None] | None = None
    _zero: int = 0
    _refused: tuple[RefusedWalls, ...] = ()
    _pace: Pace | None = None
    _stack: ExitStack = field(default_factory=ExitStack)

    @property
    def virtual(self) -> bool:
        """True if trials run in virtual time, as fast as the computer simulates."""
        return not self.realtime and (self.url or "sim://").startswith("sim:")

    @property
    def simulated(self) -> bool:
        """True if the device is simulated, so that no real rig can move."""
        return (self.url or "sim://").startswith("sim:")

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return facts about the device, its clock and this computer, which the log stores.

        `changes` are sampling rates, by key, that replace those of the experiment and of the device.
        """
        url = devices.url_for(self.url or "sim://", experiment.controller.loop)
        facts: dict[str, Any] = {
            "url": url,
            "place": {"url": self.url, "realtime": self.realtime},
            "clock": "virtual" if self.virtual else "monotonic",
            "host": host_facts(),
            "versions": software(),
        }
        device = self._device(experiment, changes)
        if device is None:
            return {**facts, "device": experiment.rig.name, "firmware": "simulated", "simulated": True}
        dictionary = device.dictionary
        clock = device.exchange_clock()
        if self._refused:
            facts["armed_anyway"] = plain(self._refused)
        if self._pace is not None:
            summary = sentence(self._pace, simulated=self.simulated)
            facts["pace"] = {**plain(self._pace), "said": summary}
        return {
            **facts,
            "device": dictionary.device,
            "firmware": dictionary.firmware,
            "simulated": dictionary.simulated,
            "serial_number": _serial_number(device.link),
            "dictionary": f"{device.dictionary_hash:016x}",
            "exchanges": [list(stamps) for stamps in clock.tolist()],
        }

    def refusals(self, walls: Sequence[SessionWall]) -> tuple[RefusedWalls, ...]:
        """Measure the delay of the link, and return the walls that it makes unstable; a real rig needs consent.

        Nothing moves. Raise `PlanError` or `ConfigError` if a wall is not allowed even with consent, or the rig's
        polarity is not verified.
        """
        if self.simulated or not walls:
            return ()
        device = self._device(walls[0].experiment, walls[0].changes)
        assert device is not None  # a real one
        by_search: dict[tuple[str, float], list[Experiment]] = {}
        for wall in walls:
            request = HitRequest(
                experiment=wall.experiment,
                url=self.url,
                changes=wall.changes,
                verified=self.verified,
                reference_count=self._zero,
            )
            effective = vetted(request, device, in_effect(wall.experiment, device, wall.changes)).experiment
            by_search.setdefault((wall.condition, effective.wall.damping), []).append(effective)
        self._refused = refusals(device, by_search)
        return self._refused

    def pace(self, experiment: Experiment, changes: Mapping[str, Any]) -> Pace | None:
        """Measure how many samples are lost or late at the experiment's rate on the open device; nothing moves.

        Return None in virtual time. `changes` are sampling rates, by key, that replace those of experiment and device.
        Raise `RigError` if the device does not reply, or the required scheduling is not granted.
        """
        device = self._device(experiment, changes)
        if device is None:
            return None
        effective = in_effect(experiment, device, changes)
        run = prepared_on(device, effective, verified=self.verified, reference_count=self._zero)
        # The device samples at this rate only after it was configured.
        device.configure(run.parameters)
        self._pace = measured_pace(
            device, effective.host, effective.controller.position_rate, effective.verdict
        )
        return self._pace

    def fits(self, experiment: Experiment, changes: Mapping[str, Any]) -> list[Check]:
        """Check that device and link can run an experiment with the rates in `changes`; the handle does not move.

        Return the results of the checks. Raise `RigError` if the device cannot be opened.
        """
        device = self._device(experiment, changes)
        if device is not None:
            return _fits(in_effect(experiment, device, changes), device)
        effective = config.override(experiment, changes)
        with devices.open_device(
            devices.url_for(self.url or "sim://", effective.controller.loop), config.rig_model(effective)
        ) as device:
            return _fits(effective, device)

    def pulse(self, experiment: Experiment, changes: Mapping[str, Any], directory: Path, name: str) -> Pulse:
        """Apply a short torque pulse, with no hand on the handle, to check the motion against the rig's description.

        Record the pulse as `name` in `directory`. `changes` are sampling rates, by key, that replace those of
        experiment and device.
        """
        device = self._device(experiment, changes)
        assert device is not None  # a real one
        with plain_errors("make", directory):
            directory.mkdir(parents=True, exist_ok=True)
        return pulse(
            device,
            in_effect(experiment, device, changes),
            recording=free_name(directory, name),
            verified=self.verified,
            reference_count=self._zero,
        )

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
        """Run one trial and return its result.

        Parameters
        ----------
        experiment, changes
            Experiment with the wall, and values by key that override the experiment and the device's rates.
        directory, name
            Directory and name of the recording.
        watch
            Function that receives the experiment in effect, and returns a function to call during the hit.
        heat
            Heat of the winding before the hit; 1 is the heat after hours at the nominal effort.
        blinded
            True if the person must not know the wall: programs that display the running loop must hide it.

        Returns
        -------
        TrialDone
            Result of the hit, its duration (s), and the error that ended a recorded hit early, which is not raised.

        Raises
        ------
        RigError
            The trial is not allowed or not possible, so nothing moved and nothing was recorded; or writing to the disk
            failed.
        """
        device = self._device(experiment, changes)
        request = HitRequest(
            experiment=experiment,
            url=self.url,
            changes=changes,
            realtime=self.realtime,
            verified=self.verified,
            output=directory,
            name=name,
            device=device,
            reference_count=self._zero,
            arm_anyway=self.arm_anyway or self.simulated,
            blinded=blinded,
        )
        error: Exception | None = None
        try:
            (result,) = hit(request, admit, lambda _, effective: watch(effective))
            left = result.recorded
            self.messages += [text for text in result.messages if text not in self.messages]
        except Exception as survived:
            # A run that ended early left a recording: it is logged as a trial all the same.
            recorded = left_by(survived)
            if recorded is None:
                raise
            error, left = survived, recorded
            if isinstance(error, LinkLostError) and not isinstance(error, DeviceFaultError):
                # After a lost link the next trial opens the device again.
                self.close()
        done = _hit_of(left, left.path.relative_to(directory.parent), heat)
        return TrialDone(done, error, _duration_s(left.recording))

    def close(self) -> None:
        """Close the device, if one was opened."""
        stack, self._stack = self._stack, ExitStack()
        self._open = self._served = None
        stack.close()

    def _device(self, experiment: Experiment, changes: Mapping[str, Any]) -> FramedDevice | None:
        if self.virtual:
            return None
        if not self.simulated:
            if self._open is None:
                model = config.rig_model(config.with_realtime(experiment, changes))
                self._open = self._stack.enter_context(devices.open_device(self.url or "", model))
                self._zero = position_zero(self._open, experiment)
            return self._open
        effective = config.with_realtime(experiment, changes)
        model = config.rig_model(effective)
        if self._open is None or self._served != (model, self.hand):
            self.close()
            url = devices.url_for(self.url or "sim://", experiment.controller.loop)
            if self.hand is not None:
                url += ("&" if "?" in url else "?") + f"hand={self.hand}"
            seed, realtime = experiment.trial.seed, effective.host.realtime
            self._open = self._stack.enter_context(
                open_for_run(url, model, in_real_time=True, seed=seed, realtime=realtime)
            )
            self._served = model, self.hand
        return self._open


def _serial_number(link: Link) -> str | None:
    return getattr(getattr(link, "facts", link), "serial_number", None) or None


def _fits(effective: Experiment, device: FramedDevice) -> list[Check]:
    dictionary = device.dictionary
    return [
        check_rig(config.rig_model(effective), dictionary),
        *link_checks(effective, dictionary.position_rate_maximum, device.link.bytes_per_second),
        *device_checks(prepared_on(device, effective), dictionary),
    ]


def heat_after(before: float, load: np.ndarray, tick_s: float, time_constant_s: float) -> float:
    """Return the heat of a winding after a series of efforts; 1 is the heat after hours at the nominal effort.

    `before` is the heat at the beginning, `load` the effort divided by the nominal effort in each tick of length
    `tick_s`, and `time_constant_s` the thermal time constant of the winding (s).
    """
    decay = math.exp(-tick_s / time_constant_s)
    ages = np.arange(len(load) - 1, -1, -1, dtype=np.float64)
    added = (1.0 - decay) * float(np.dot(np.square(load), decay**ages))
    return before * decay ** len(load) + added


def _hit_of(left: Recorded, path: Path, heat: float) -> HitOutcome:
    experiment, recording = left.experiment, left.recording
    verdict, measured = left.judgement.verdict, left.judgement.measured
    trailer, free = recording.trailer or {}, baseline(recording, experiment)
    ended = str(trailer.get("reason", "the recording is incomplete"))
    fault = (trailer.get("fault") or {}).get("name", "")
    limits, tick_s = experiment.rig.limits, 1.0 / experiment.controller.position_rate
    load = recording.rows["effort_sent"] / limits.nominal_effort
    invalid = verdict.kind is Kind.INVALID
    return HitOutcome(
        recording=str(path),
        sha256=sha256_of(left.path),
        rows_sha256=hashlib.sha256(recording.rows.tobytes()).hexdigest(),
        ended=ended,
        aborted=ended if ended in THREW_OUT else fault.lower() if fault in THROWN_OUT else "",
        automatic=str(verdict.kind),
        reasons=verdict.reasons,
        outside=(),
        by_machine=left.judgement.early is None and invalid and measured.by_machine,
        passes={criterion: None if invalid else measured.passes(criterion) for criterion in CRITERIA},
        numbers=plain(
            {**{name: getattr(verdict, name) for name in NUMBERS}, "press": press_of(recording, experiment)}
        ),
        baseline=None if free is None else plain(free),
        heat=heat_after(heat, load, tick_s, limits.thermal_time_constant_s),
    )


def _duration_s(recording: Recording) -> float:
    times = recording.time_s
    return float(times[-1]) if len(times) else 0.0
