"""Hits of a test: on a fresh simulated rig each, with faults on command, or on the one rig that this run was given.

On a rig the same test runs unchanged. Its device is opened once, which keeps its lock and its position zero from test
to test; after each hit, and when the run ends, the host sends STOP.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, cast

import pytest

from firmware_protocol.connection import State
from rig import config, devices
from rig.config import Experiment
from rig.control.laws import Law
from rig.control.verdict import Verdict
from rig.core.errors import ConfigError, RigError, StoppedError
from rig.devices.fault_script import Faults
from rig.devices.framed import FramedDevice
from rig.devices.simulated import WatchedLink
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, Recorded, hit, left_by
from rig.experiments.trials.preparation import position_zero
from rig.recording.data import Recording
from rig.testing.experiments import Experiments, Source
from rig.testing.fault_words import FaultWords

WATCH_S = 1.0  # after a hit, for a current that does not go to zero; the longest watchdog bites before (PROTOCOL.md)
STEP_S = 0.0005
LOOK_S = 0.01  # an unarmed device sends a hundred STATE a second


@dataclass(frozen=True, slots=True)
class DeviceAfterwards:
    """Observed state of the device after the host had ended.

    Attributes
    ----------
    zero_after_s
        When its current was zero, since the host's last word (s); None: not while it was watched.
    armed
        True if it would have accepted a command at the end.
    """

    zero_after_s: float | None
    armed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Hit:
    """A hit of a test.

    Attributes
    ----------
    experiment
        The one in effect; as it was asked for where nothing moved.
    recorded
        Recording and judgement of the hit; None if nothing moved.
    counters
        Counters of the link.
    error
        Why it ended early, where it may: else the error is raised.
    rest
        State of the device afterwards; None if it sent no STATE.
    struck
        Faults of the script that have happened to frames.
    """

    experiment: Experiment = field(repr=False)
    recorded: Recorded | None = field(repr=False)
    counters: Mapping[str, int]
    error: RigError | None
    rest: DeviceAfterwards | None
    struck: int = 0

    @property
    def verdict(self) -> Verdict:
        """Return the verdict by the recorded signals."""
        return self._left.judgement.verdict

    @property
    def verdict_true(self) -> Verdict | None:
        """Return the verdict by the true signals of the simulation; None on a real rig."""
        return self._left.judgement.verdict_true

    @property
    def recording(self) -> Recording:
        """Return the recording of the hit, read into memory."""
        return self._left.recording

    @property
    def path(self) -> Path:
        """Return its file; see ``--rig-record`` for what becomes of it."""
        return self._left.path

    @property
    def _left(self) -> Recorded:
        if self.recorded is None:
            raise AssertionError(f"nothing was recorded: {self.error}")
        return self.recorded


class Rigs:
    """Where the tests of a run hit: simulated rigs without number, or one rig.

    Parameters
    ----------
    url
        Value of ``--rig-url``.
    verified
        A person has confirmed that it may move.
    ask
        Asks that person to continue; returns False to end.
    """

    def __init__(self, url: str, *, verified: bool, ask: Callable[[str], bool]) -> None:
        self.url = url
        self.verified = verified
        self.ask = ask
        self._rig: FramedDevice | None = None
        self._zero: int | None = None

    @property
    def simulated(self) -> bool:
        """Return True if each hit has a simulated rig of its own."""
        return self.url.startswith("sim:")

    @property
    def rig(self) -> FramedDevice:
        """Return the one rig, opened on first use. Errors as `rig.open_device`."""
        if self._rig is None:
            self._rig = devices.open_device(self.url)
        return self._rig

    def zero(self, experiment: Experiment) -> int | None:
        """Count at position zero of the rig, where its handle stood when the first test hit; None in simulation."""
        if not self.simulated and self._zero is None:
            self._zero = position_zero(self.rig, experiment)
        return self._zero

    @contextmanager
    def device(self, experiment: Experiment, faults: Faults | None = None) -> Iterator[FramedDevice]:
        """Yield a device for an experiment: a fresh simulated one, or the rig, which is sent STOP afterwards."""
        if self.simulated:
            url = devices.url_for(self.url, experiment.controller.loop)
            with FramedDevice(devices.open_watched(url, config.rig_model(experiment), faults)) as device:
                yield device
            return
        try:
            yield self.rig
        finally:
            self.stop()

    def hands_off(self, text: str) -> None:
        """Have the person agree to a torque pulse, or end all tests."""
        if not self.ask(text):
            end_all(StoppedError("the operator did not agree to the torque pulse; the motor did not move"))

    def stop(self) -> None:
        """Zero effort and disarmed, whatever the device was doing. Cannot raise."""
        if self._rig is not None:
            self._rig.stop()
            with suppress(RigError):
                self._rig.disarm(clear_fault=True)

    def close(self) -> None:
        """Stop the rig and release its port."""
        self.stop()
        if self._rig is not None:
            self._rig.link.close()
            self._rig = self._zero = None


class Hits:
    """Makes the hits of a test.

    Parameters
    ----------
    rigs
        Where.
    experiments
        Sources of experiments in this test: a name, a path, or none.
    faults
        The test's script.
    directory
        Directory of the recordings.

    Attributes
    ----------
    last
        The latest hit.
    """

    def __init__(self, rigs: Rigs, experiments: Experiments, faults: FaultWords, directory: Path) -> None:
        self._rigs, self._experiments = rigs, experiments
        self.faults = faults
        self.directory = directory
        self.last: Hit | None = None
        self._number = 0

    def __call__(
        self,
        source: Source = None,
        changes: Mapping[str, Any] | None = None,
        *,
        law: Law | Callable[[float], Law] | None = None,
        may_end: bool = False,
        device: FramedDevice | None = None,
    ) -> Hit:
        """Hit once.

        Parameters
        ----------
        source
            Experiment to hit: see `Experiments`.
        changes
            New values by dotted key. On a rig they win over what it is given for real time (``[realtime]``, and its own
            rate), as on a command line.
        law
            A law to run instead of the named wall.
        may_end
            The run may end early, by the guard for one: then it is the hit's `error`, as where faults are scripted.
        device
            An open device to hit on (``rig_device``), without a script of faults.

        Raises
        ------
        RigError
            A run that is refused and, unless allowed, the cause of an early end.
        """
        experiment = self._experiments(source)
        once: dict[str, Any] = {**(changes or {}), "trial.repeats": 1}
        if self._rigs.simulated:
            experiment, once = config.override(experiment, once, "the test"), {}
        self._number += 1
        request = HitRequest(
            experiment=experiment,
            changes=once,
            verified=self._rigs.verified,
            output=self.directory,
            name=f"hit-{self._number}",
            law=law,
            device=device,
            reference_count=self._rigs.zero(experiment),
            hands_off=self._rigs.hands_off,
        )
        self.last = self._hit(request, may_end=may_end or self.faults.script is not None)
        return self.last

    def _hit(self, request: HitRequest, *, may_end: bool) -> Hit:
        script = self.faults.script
        if request.device is not None:
            if script is not None:
                raise ConfigError(
                    "a script of faults is given, but the device is already open",
                    remedy="let rig_hit open the device",
                )
            return _describe_end(request, request.device, may_end=may_end)
        with self._rigs.device(request.experiment, script) as device:
            return _describe_end(replace(request, device=device), device, may_end=may_end)


def end_all(stopped: StoppedError) -> NoReturn:
    """End the run of all tests after a person's stop, since the next test would move the rig again."""
    pytest.exit(str(stopped), returncode=stopped.exit_code)


def _describe_end(request: HitRequest, device: FramedDevice, *, may_end: bool) -> Hit:
    """Run a hit and watch how its device comes to rest. A person's stop ends the whole run of tests."""
    recorded, counters, error = None, {}, None
    try:
        (result,) = hit(request, admit)
        recorded, counters = result.recorded, result.counters
    except StoppedError as stopped:
        end_all(stopped)
    except ConfigError:
        raise
    except RigError as failure:
        if not may_end:
            raise
        error, recorded = failure, left_by(failure)
        counters = {} if recorded is None else (recorded.recording.trailer or {}).get("counters", {})
    link = device.link
    return Hit(
        experiment=request.experiment if recorded is None else recorded.experiment,
        recorded=recorded,
        counters=counters,
        error=error,
        rest=_watch(cast("WatchedLink", link)) if link.clock.virtual else _read_state(device),
        struck=getattr(link, "struck", 0),
    )


def _watch(link: WatchedLink) -> DeviceAfterwards:
    """Let time pass until the current is zero, and after that long enough for the watchdog of an armed device."""
    steps = 0
    while link.current != 0 and steps * STEP_S < WATCH_S:
        link.elapse(STEP_S)
        steps += 1
    if link.armed:
        link.elapse(WATCH_S)
    return DeviceAfterwards(None if link.current else steps * STEP_S, link.armed)


def _read_state(device: FramedDevice) -> DeviceAfterwards | None:
    """Read the STATE that an unarmed device sends on its own; return None if none arrives."""
    began_ns = device.link.clock.now_ns()
    rest: DeviceAfterwards | None = None
    while (waited_s := (device.link.clock.now_ns() - began_ns) * 1e-9) < WATCH_S:
        try:
            states = device.states(LOOK_S)
        except RigError:
            return None
        if states:
            zero = states[-1].current_commanded == 0
            rest = DeviceAfterwards(
                waited_s if zero else None, states[-1].state in (State.ARMED, State.RUNNING)
            )
            if zero:
                break
    return rest
