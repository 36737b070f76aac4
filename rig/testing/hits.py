"""Run a test's hits on a wall, each on a new simulated rig with scripted faults, or all on the rig of ``--rig-url``.

The tests are the same for a real rig. Its device is opened once, so that position zero, and the lock against other
programs, stay valid from test to test; the host sends STOP after each hit and at the end of all tests.
"""

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

# Time after a hit in which the current must become zero (s); the longest watchdog acts before (PROTOCOL.md).
WATCH_S = 1.0
STEP_S = 0.0005  # resolution of this time in simulation
LOOK_S = 0.01  # the same on a real rig: an unarmed device sends a hundred State messages per second


@dataclass(frozen=True, slots=True)
class DeviceAfterwards:
    """State of the device after the host's last frame.

    Attributes
    ----------
    zero_after_s
        Time from the host's last frame until the current was zero (s); None if it was not zero within `WATCH_S` (1 s).
    armed
        True if the device was still armed at the end.
    """

    zero_after_s: float | None
    armed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Hit:
    """Result of a hit: a run of a test, in which the handle is driven against a virtual wall.

    Attributes
    ----------
    experiment
        Experiment in effect during the hit; the requested experiment if nothing moved.
    recorded
        Recording and judgement of the hit; None if nothing moved.
    counters
        Counters of the link, by name.
    error
        Error that ended the hit early, if the test allows an early end; None if the hit ended normally.
    rest
        State of the device after the hit; None if it sent no State message.
    struck
        Number of scripted faults that were applied to frames.
    """

    experiment: Experiment = field(repr=False)
    recorded: Recorded | None = field(repr=False)
    counters: Mapping[str, int]
    error: RigError | None
    rest: DeviceAfterwards | None
    struck: int = 0

    @property
    def verdict(self) -> Verdict:
        """Return the verdict that is computed from the recorded signals (stable, unstable or invalid)."""
        return self._recorded_hit.judgement.verdict

    @property
    def verdict_true(self) -> Verdict | None:
        """Return the verdict that is computed from the simulation's exact signals; None on a real rig."""
        return self._recorded_hit.judgement.verdict_true

    @property
    def recording(self) -> Recording:
        """Return the recording of this run, read into memory."""
        return self._recorded_hit.recording

    @property
    def path(self) -> Path:
        """Return the path of this run's recording; ``--rig-record`` selects which recordings remain after a test."""
        return self._recorded_hit.path

    @property
    def _recorded_hit(self) -> Recorded:
        if self.recorded is None:
            raise AssertionError(
                f"the hit has no recording, because the run failed before it moved: {self.error}"
            )
        return self.recorded


class Rigs:
    """The rigs that the tests use: a new simulated rig for each hit on a wall, or one real rig for all hits.

    Parameters
    ----------
    url
        Value of ``--rig-url``.
    verified
        True if a person has confirmed that the rig may move.
    ask
        Function that asks that person to continue; it returns False to end the tests.
    """

    def __init__(self, url: str, *, verified: bool, ask: Callable[[str], bool]) -> None:
        self.url = url
        self.verified = verified
        self.ask = ask
        self._rig: FramedDevice | None = None
        self._zero: int | None = None

    @property
    def simulated(self) -> bool:
        """Return True if each run of a test uses a new simulated rig."""
        return self.url.startswith("sim:")

    @property
    def rig(self) -> FramedDevice:
        """Return the real rig's device, opened on first use; `ConfigError` or `DeviceNotFoundError` if this fails."""
        if self._rig is None:
            self._rig = devices.open_device(self.url)
        return self._rig

    def zero(self, experiment: Experiment) -> int | None:
        """Return the encoder count at position zero of the real rig, read before the first hit; None in simulation."""
        if not self.simulated and self._zero is None:
            self._zero = position_zero(self.rig, experiment)
        return self._zero

    @contextmanager
    def device(self, experiment: Experiment, faults: Faults | None = None) -> Iterator[FramedDevice]:
        """Yield an open device for an experiment: a new simulated one, or the real one, which is stopped at the end."""
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
        """Ask the person whether a torque pulse may follow; without consent, end the run of all tests."""
        if not self.ask(text):
            end_all(StoppedError("the operator did not agree to the torque pulse; the motor did not move"))

    def stop(self) -> None:
        """Set the effort to zero and disarm the device, whatever its state; raise no error."""
        if self._rig is not None:
            self._rig.stop()
            with suppress(RigError):
                self._rig.disarm(clear_fault=True)

    def close(self) -> None:
        """Stop the real rig and release its port; without effect in simulation."""
        self.stop()
        if self._rig is not None:
            self._rig.link.close()
            self._rig = self._zero = None


class Hits:
    """Callable that runs a test's hits: runs in which the handle is driven against a wall (the fixture ``rig_hit``).

    Parameters
    ----------
    rigs
        Rigs to use: simulated ones, or the real one.
    experiments
        Function that creates the test's experiments.
    faults
        The test's script of faults.
    directory
        Directory of the recordings.

    Attributes
    ----------
    last
        Result of the latest hit.
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
        """Drive the handle against the wall once and return the result.

        Raise `RigError` if the run is refused, or it ended early although it may not.

        Parameters
        ----------
        source
            A preset's name, a path that ends in .toml, an experiment, or None for the test's default experiment.
        changes
            New values by dotted key. On a real rig they override the settings for real time (``[realtime]``, and the
            device's rate), as on a command line.
        law
            Law to run instead of the experiment's law.
        may_end
            True if the run may end early, for example by a safety limit: the result then contains the `error`. Runs
            with scripted faults may always end early.
        device
            Open device to use (fixture ``rig_device``); it must not be combined with scripted faults.
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
                    remedy="omit device=, so that rig_hit opens a simulated device with these faults",
                )
            return _run_and_observe(request, request.device, may_end=may_end)
        with self._rigs.device(request.experiment, script) as device:
            return _run_and_observe(replace(request, device=device), device, may_end=may_end)


def end_all(stopped: StoppedError) -> NoReturn:
    """End the run of all tests after a person has stopped one of them: the next test would move the rig again."""
    pytest.exit(str(stopped), returncode=stopped.exit_code)


def _run_and_observe(request: HitRequest, device: FramedDevice, *, may_end: bool) -> Hit:
    """Run a hit on the wall; return its result with the device's state afterwards. A person's stop ends all tests."""
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
    """Let simulated time pass until the current is zero and an armed device's watchdog has acted.

    Return the time until the current was zero (s) and whether the device is armed.
    """
    steps = 0
    while link.current != 0 and steps * STEP_S < WATCH_S:
        link.elapse(STEP_S)
        steps += 1
    if link.armed:
        link.elapse(WATCH_S)
    return DeviceAfterwards(None if link.current else steps * STEP_S, link.armed)


def _read_state(device: FramedDevice) -> DeviceAfterwards | None:
    """Return current and state of a device from the State messages that it sends while unarmed; None without any."""
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
