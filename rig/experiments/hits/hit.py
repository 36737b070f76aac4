"""Run hits: a constant effort or a person drives the handle into the wall; each hit is recorded and judged.

`rig hit`, `rig.experiments.lab`, maps on a device, sessions, the console and `rig.testing` call this module. The caller
passes the function that decides if a device may be armed: `rig.experiments.hits.admission.admit`. This module must not
import `admission`, which imports this module, nor start a run that `admit` did not permit.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from rig import config, devices
from rig.config import Experiment
from rig.config.prepared_run import PreparedRun
from rig.control.laws import Law
from rig.control.verdict import Verdict
from rig.core.keyword import Keyword
from rig.core.model import RigModel
from rig.core.present import Item, Row, plain
from rig.core.shown import Drawn, Shown
from rig.devices.framed import FramedDevice
from rig.devices.local import open_for_run
from rig.doctor.gate_result import Gate
from rig.experiments.trials._trial import TrialEnd, TrialRequest, end_of, run_trial
from rig.experiments.trials.judgement import Judgement, judge
from rig.experiments.trials.settings import RigRequest
from rig.realtime import stop_requests
from rig.recording.data import Recording
from rig.recording.files import plain_errors, reserved_name
from rig.recording.reader import open_recording

RATES = ("controller.position_rate", "controller.velocity_rate")


@dataclass(frozen=True, slots=True, kw_only=True)
class HitRequest(RigRequest):
    """A request of hits: experiment, device and options; a real device always runs in real time.

    Attributes
    ----------
    name
        Name of the recording's file without suffix; None: the rig's name, the time, and the number of the repeat.
    law
        Control law to run instead of the law that the experiment names, or a function that returns the law for the
        device's current quantum (A).
    device
        Device that the caller has opened already, used instead of `url`; the hits do not close it.
    reference_count
        Encoder count at position zero of a real rig. None: determine the count with
        `rig.experiments.trials.preparation.position_zero`.
    arm_anyway
        Arm although the measured link makes the wall dangerous (`rig.doctor.gate`). This is reported and recorded.
    measuring
        Called while the link is measured before arming, with the finished fraction of the measurement (0 to 1).
    judged_link
        Called before arming with the checks of the measured link.
    hands_off
        Called with an instruction to the operator (take the hands off the handle) before the torque pulse that checks a
        real rig before a person holds the handle.
    blinded
        True if the person must not know the wall: programs that display the running loop must then hide the wall.
    """

    realtime: Annotated[
        bool,
        Keyword("In real time; a simulated rig then runs as a process of its own.", group="Device"),
    ] = False
    arm_anyway: Annotated[
        bool,
        Keyword(
            "Arm a real rig although the measured link makes this wall dangerous; `rig doctor` explains why.",
            group="Device",
        ),
    ] = False
    name: str | None = None
    law: Law | Callable[[float], Law] | None = None
    device: FramedDevice | None = None
    reference_count: int | None = None
    measuring: Callable[[float], None] | None = None
    judged_link: Callable[[Gate], None] | None = None
    hands_off: Callable[[str], None] | None = None
    blinded: bool = False


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recorded hit: experiment as it ran, recording as read from its file, and verdict with its measurements."""

    experiment: Experiment
    recording: Recording
    judgement: Judgement

    @property
    def path(self) -> Path:
        """Return the path of the hit's recording."""
        assert self.recording.path is not None
        return self.recording.path


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HitResult(Shown, Drawn):
    """A result of one hit: experiment, recording, verdict, the device's error counters, and warnings."""

    recorded: Recorded
    counters: dict[str, int]
    cleared_fault: str | None  # fault of an earlier run that the device still reported before this hit
    gate: Gate | None = None  # assessment of arming on this link; None in virtual time
    # Exceeded limits that protect people, and refused real-time scheduling, each with its remedy.
    messages: tuple[str, ...] = ()

    @property
    def recording(self) -> Recording:
        """Return the recording of the hit, as read from its file."""
        return self.recorded.recording

    @property
    def path(self) -> Path:
        """Return the path of the hit's recording."""
        return self.recorded.path

    @property
    def experiment(self) -> Experiment:
        """Return the experiment as it ran: the user's experiment with all changes applied."""
        return self.recorded.experiment

    @property
    def verdict(self) -> Verdict:
        """Return the verdict on the hit's stability by the recorded signals."""
        return self.recorded.judgement.verdict

    @property
    def verdict_true(self) -> Verdict | None:
        """Return the verdict on the hit's stability by the simulation's true signals; None on a real rig."""
        return self.recorded.judgement.verdict_true

    def brief(self) -> list[Item]:
        """Return the lines of a short report: wall, verdict, reasons, ripples of velocity, effort and position."""
        rows = self.recorded.judgement.rows(self.experiment)
        summary = [row for row in rows if row.label in {"verdict", ""}]
        numbers = [row for row in rows if row.label.startswith(("peak", "felt", "heard", "moved"))]
        return [self.experiment.headline(), *summary[:3], *numbers, Row("recording", str(self.path))]

    def detailed(self) -> list[Item]:
        """Return the lines of a full report: wall, verdict and every number behind it, and the recording's path."""
        rows = self.recorded.judgement.rows(self.experiment)
        return [self.experiment.headline(), *rows, Row("recording", str(self.path))]

    def as_mapping(self) -> dict[str, Any]:
        """Return wall, sampling rates, estimator, verdict and thresholds by name, as values for JSON."""
        return {
            "recording": self.path,
            "rig": self.experiment.rig.name,
            "motion": self.experiment.rig.motion,
            "stiffness": self.experiment.wall.stiffness,
            "damping": self.experiment.wall.damping,
            "position_rate": self.experiment.controller.position_rate,
            "velocity_rate": self.experiment.controller.velocity_rate,
            "estimator": self.experiment.controller.estimator,
            "loop": self.experiment.controller.loop,
            "arithmetic": self.recording.header["extra"].get("arithmetic"),  # of a law on the device
            "resolution": self.experiment.rig.encoder.resolution,
            "kind": self.experiment.trial.kind,
            "grip": self.experiment.operator.grip if self.experiment.trial.kind == "human" else None,
            "effort": config.motor_push(self.experiment),
            "start": self.experiment.trial.start,
            "seed": self.experiment.trial.seed,
            **plain(self.recorded.judgement),
            "thresholds": config.verdict_thresholds(self.experiment),
            "counters": self.counters,
            "cleared_fault": self.cleared_fault,
            "gate": self.gate,
            "messages": self.messages,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Admitted:
    """A permitted run, ready to start on an open device.

    Attributes
    ----------
    run
        Run prepared for the device.
    gate
        Checks of the device's link before arming; None in virtual time, where a link has no delay.
    warnings
        One sentence for each exceeded limit that protects people, with the remedy.
    """

    run: PreparedRun
    gate: Gate | None
    warnings: tuple[str, ...]


Admit = Callable[[HitRequest, FramedDevice, Experiment], Admitted]
Watch = Callable[[int, Experiment], Callable[[int, int], None] | None]


def in_effect(experiment: Experiment, device: FramedDevice, changes: Mapping[str, Any]) -> Experiment:
    """Return the experiment as it runs on `device`, which in real time differs from the description.

    In real time `rig.config.realtime_changes` apply. If the host runs the law and the user set no rate, both sampling
    rates become the device's default rate. `changes` (values by key that the user set) override all of these.
    """
    if device.link.clock.virtual:
        return config.override(experiment, changes)
    wanted = config.realtime_changes(experiment, changes)
    on_the_host = wanted.get("controller.loop", experiment.controller.loop) == "host"
    if on_the_host and not any(key in changes for key in RATES):
        # The host answers every sample of the device: at its own rate, unless the user set another one.
        wanted |= dict.fromkeys(RATES, device.dictionary.position_rate_default)
    return config.override(experiment, wanted, "real time and command line")


def hit(request: HitRequest, admit: Admit, watch: Watch | None = None) -> Iterator[HitResult]:
    """Run the hits of a request, one after another, and yield each result as soon as the hit has ended.

    Parameters
    ----------
    request
        Experiment, device and options.
    admit
        Called with the request, the open device and the experiment as it runs there; returns the prepared run, or
        raises an error if the run is not permitted. Pass `rig.experiments.hits.admission.admit`.
    watch
        Called before each repeat with the repeat's number (from 0) and the experiment. `watch` may return a progress
        function, which is called with (ticks, phase) while the trial runs.

    Raises
    ------
    PlanError
        The run is not permitted; nothing has moved.
    RigError
        A trial ended early, by the link, the device, the safety guard, the law or the operator; the effort is zero.
    """
    with stop_requests.listening() as series, _open_device(request) as (device, effective):
        with series:
            admitted = admit(request, device, effective)
        gate, warnings, experiment = admitted.gate, admitted.warnings, admitted.run.experiment
        output = Path(request.output)
        with plain_errors("make", output):
            output.mkdir(parents=True, exist_ok=True)
        stem = f"{experiment.rig.name}-{datetime.now():%Y%m%d-%H%M%S}"
        for repeat in range(experiment.trial.repeats):
            # Reserved before anything moves: two programs of the same second must not share a file.
            with reserved_name(output, request.name or f"{stem}-{repeat + 1}") as recording:
                trial = TrialRequest(
                    run=admitted.run,
                    recording=recording,
                    seed=experiment.trial.seed,
                    progress=watch(repeat, experiment) if watch else None,
                    blinded=request.blinded,
                    judge=partial(judge, experiment=experiment),
                    extra={
                        "repeat": repeat + 1,
                        **({} if gate is None else {"gate": plain(gate)}),
                        **({"warnings": list(warnings)} if warnings else {}),
                    },
                )
                # Only while the trial runs: a stop request must not interrupt the caller, which has the result.
                with series:
                    result = _run_hit(device, trial, admitted)
            yield result


def left_by(error: Exception) -> Recorded | None:
    """Return recording and verdict of the hit that ended with `error`; None if no trial had begun."""
    end = end_of(error)
    return None if end is None else _make_recorded(end)


def _make_recorded(end: TrialEnd) -> Recorded:
    if end.sealed is not None and end.judgement is not None:
        return Recorded(end.experiment, end.sealed, end.judgement)
    # The run failed, and then its recording could not be sealed: read the unsealed capture.
    recording = open_recording(end.recording)
    return Recorded(end.experiment, recording, judge(recording, end.experiment))


def _run_hit(device: FramedDevice, trial: TrialRequest, admitted: Admitted) -> HitResult:
    end = run_trial(device, trial)
    fault, device.cleared_fault = device.cleared_fault, None
    return HitResult(
        recorded=_make_recorded(end),
        counters=end.counters,
        cleared_fault=None if fault is None else fault.text,
        gate=admitted.gate,
        messages=(*admitted.warnings, *device.link.messages, *end.messages),
    )


@contextmanager
def _open_device(request: HitRequest) -> Iterator[tuple[FramedDevice, Experiment]]:
    """Open the device of a request; yield the device and the experiment as it runs on this device."""
    experiment = request.experiment
    if request.device is not None:
        yield request.device, in_effect(experiment, request.device, request.changes)
        return
    url = devices.url_for(
        request.url or "sim://", request.changes.get(config.LOOP, experiment.controller.loop)
    )
    simulated = url.startswith("sim:")
    if simulated:  # the simulation is built from the changed experiment
        experiment = (config.with_realtime if request.realtime else config.override)(
            experiment, request.changes
        )
    # A simulated device in real time runs as a separate process.
    with open_for_run(
        url,
        config.rig_model(experiment) if simulated else _rig_behind(url, request),
        in_real_time=request.realtime,
        seed=request.experiment.trial.seed,
        realtime=experiment.host.realtime if simulated else "try",
    ) as device:
        as_simulated = simulated and device.link.clock.virtual
        yield (
            device,
            experiment if as_simulated else in_effect(experiment, device, request.changes),
        )


def _rig_behind(url: str, request: HitRequest) -> RigModel | None:
    """Return the rig's model for a device that needs it (bridge to a motor drive); None for a board, which has it."""
    if not devices.is_made_for_a_rig(url):
        return None
    return config.rig_model(config.with_realtime(request.experiment, request.changes))
