"""Run one trial on an open device: configure, arm, run the loop, bring the handle to rest, and close the recording.

Hits and motions call `run_trial`. The order at the end is fixed: zero effort first, then the
recording is closed, then the reason is reported. Each of these three steps is done even if the step before failed.
"""

import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Fault, LimitFlag
from firmware_protocol.messages import MAJOR, MINOR
from firmware_protocol.parameter import Value
from rig.config import Experiment, as_mapping, rig_model
from rig.config.prepared_run import LawOnDevice, PreparedRun
from rig.control.step import ControllerState
from rig.core.board import current_sensor
from rig.core.clock_fit import ClockFit, as_exchanges, fit_if_possible
from rig.core.errors import RigError, StoppedError
from rig.core.sample import Phase
from rig.devices.device import Link
from rig.devices.framed import SUPERVISE_EVERY_S, Echo, FaultReport, FramedDevice
from rig.devices.local import host_beside
from rig.experiments.trials._endings import IN_DOUBT, error_of
from rig.experiments.trials.judgement import Judgement
from rig.loop.interface import (
    BOUNDS,
    EVERY_NS,
    NO_BOUND,
    LoopEnd,
    LoopSettings,
    LoopThread,
    Signals,
    SupervisedThread,
    stop_on_signals,
)
from rig.loop.layout import EndReason
from rig.realtime import stop_requests
from rig.realtime.ring import Ring
from rig.realtime.scheduling import Realtime, obtained
from rig.recording.canonical import lossless
from rig.recording.data import Recording
from rig.recording.header import make_header
from rig.recording.reader import open_recording
from rig.recording.recorder import Recorder
from rig.recording.seal import seal

BLACK_BOX_ROWS = 100
# A gap without data of this time (s) ends a run: the device has ramped its effort down long before.
LOST_AFTER_S = 0.05
LOST_AFTER_PERIODS = 3
# A limit switch counts as open after this time without contact (s), because contacts bounce for some milliseconds.
BOUNCE_S = 0.02
RING_SECONDS = 5.0
RING_ROWS_MINIMUM = 4096
REFERENCES = ("where the handle was put", "an index of the encoder")  # values of the parameter `reference`
# Longest busy wait as a fraction of the period: the kernel throttles a thread that never sleeps for tens of
# milliseconds.
SPIN_SHARE = 0.6

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """A request of a trial on an open device: the prepared run, its recording, and progress and judging functions."""

    run: PreparedRun
    recording: Path
    seed: int
    progress: Progress | None = None
    judge: Callable[[Recording], Judgement] | None = None
    # True if the trial may begin with a pressed limit switch, which then ends it only when pressed again.
    leaves_switch: bool = False
    sealed: bool = True  # False: do not seal the capture, for callers that run thousands of trials
    extra: dict[str, Any] = field(default_factory=dict)
    blinded: bool = False  # passed to observers of the loop, see `rig.experiments.hits.hit.HitRequest`


@dataclass(frozen=True, slots=True)
class TrialEnd:
    """How a trial ended, and its recording.

    Attributes
    ----------
    experiment
        Experiment that ran.
    recording
        Path of the recording.
    reason, counters
        Reason why the loop ended, and the number of lost, late and damaged messages by name.
    messages
        Sentences on refused real-time scheduling, and messages of the loop.
    sealed
        Recording as read from its sealed (compressed, checked) file; None if the recording was not sealed.
    judgement
        Result of the request's function `judge`; None if the recording was not judged.
    """

    experiment: Experiment
    recording: Path
    reason: EndReason
    counters: dict[str, int]
    messages: tuple[str, ...] = ()
    sealed: Recording | None = None
    judgement: Judgement | None = None


def end_of(error: BaseException) -> TrialEnd | None:
    """Return how the trial that raised `error` ended (reason, recording); None if no trial began."""
    end: TrialEnd | None = getattr(error, "end", None)
    return end


def run_trial(device: FramedDevice, request: TrialRequest) -> TrialEnd:
    """Run one trial, seal (compress and check) its recording, and return how the trial ended.

    Raises
    ------
    DeviceRefusedError
        The device does not accept the configuration or does not arm; nothing moved and nothing was recorded.
    LinkLostError, DeviceFaultError, GuardError, LawError, StoppedError
        The run ended early. The effort is zero and the recording is closed. The error has two attributes: `recording`,
        the path, and `end`, a `TrialEnd`.
    Exception
        The request's `progress` function failed. The run ends as after the errors above, and the exception has the same
        two attributes.
    """
    run = request.run
    controller, parameters = run.controller.copy(), run.parameters
    # Compile before signals are redirected, so that Ctrl-C can interrupt the compilation.
    thread = _loop_of(run, device.link)
    echo = device.configure(parameters)
    virtual = device.link.clock.virtual
    with (
        obtained(host_beside(run.experiment.host, device.link), virtual=virtual) as realtime,
        _ring(device, request) as ring,
        stop_on_signals() as signals,
    ):
        exchanges = [device.exchange_clock()]
        header = _header(device, request, controller, echo, realtime, fit_if_possible(exchanges[0]))
        with Recorder(request.recording, header, ring, virtual=virtual) as recorder:
            try:
                # The progress function may raise a stop that was requested while the link was measured.
                if request.progress is not None:
                    request.progress(0, Phase.WAIT)
                signals.series.check()
                loop = _arm(device, request, thread, controller, ring, realtime, signals)
            except BaseException:
                request.recording.unlink(missing_ok=True)  # nothing moved: no empty recording stays behind
                raise
            watch = _Watch(loop, request.progress)
            try:
                loop.start()
                loop.wait(watch if request.progress is not None else None)
            finally:
                _bring_to_rest(device, loop)
            end = loop.end()
            end, error = _conclude(device, loop, end, recorder, realtime, exchanges, watch.stopped)
            if end.reason.name.lower() in IN_DOUBT:
                device.moved_as_described = False
        sealed, judgement = _seal(request, device.link.truth(), error)
    if error is None and watch.stopped is not None and not isinstance(watch.stopped, StoppedError):
        error = watch.stopped
    elif error is None and (signals.is_stopped or watch.stopped):
        by = f" by {stop_requests.requester()}" if signals.is_stopped else ""
        error = StoppedError(f"stopped{by} after the trial had finished; the effort is zero")
    elif isinstance(error, RigError) and signals.is_stopped and not isinstance(error, StoppedError):
        # After other errors a caller may continue with the next wall; after a stop request it must not.
        by = stop_requests.requester()
        error = StoppedError(
            f"stopped by {by} after the trial had ended: {error.message}", remedy=error.remedy
        )
    if isinstance(error, StoppedError) and signals.is_stopped:
        error.signal = signals.number
    if isinstance(error, RigError):
        error.messages = (*device.link.messages, *realtime.messages, *loop.messages())
    path = request.recording if sealed is None or sealed.path is None else sealed.path
    messages = (*realtime.messages, *loop.messages())
    done = TrialEnd(run.experiment, path, end.reason, end.counters, messages, sealed, judgement)
    if (raised := signals.raised or error) is not None:
        # Also an exception of the caller's progress function gets these attributes.
        vars(raised).update(recording=path, end=done)
        raise raised from end.error
    return done


class _Watch:
    """A wrapper of the caller's progress function: if it raises, stop the loop and store the error in `stopped`."""

    def __init__(self, loop: LoopThread, progress: Progress | None) -> None:
        self._loop, self._progress = loop, progress
        self.stopped: Exception | None = None

    def __call__(self, ticks: int, phase: int) -> None:
        if self._progress is None or self.stopped is not None:
            return
        try:
            self._progress(ticks, phase)
        except Exception as error:  # the handle has moved: any error must stop the loop
            self._loop.stop()
            self.stopped = error


def _ring(device: FramedDevice, request: TrialRequest) -> Ring:
    """Allocate the ring buffer of samples that loop and recorder share; in real time other processes can read it."""
    run, gate = request.run, request.extra.get("gate")
    info = {
        "url": device.link.url.text,
        "recording": str(request.recording.resolve()),
        "pid": os.getpid(),
        "experiment": as_mapping(run.experiment),
        "current_quantum_a": run.current_quantum_a,
        "reference_count": run.reference_count,
        "law": run.own_law,  # True for the caller's own law, whose parameters other programs cannot compute
        "gate": {name: gate[name] for name in ("delay_ticks", "simulated", "forced")} if gate else None,
        "blinded": request.blinded,
    }
    rows = max(RING_ROWS_MINIMUM, round(RING_SECONDS * run.experiment.controller.position_rate))
    return Ring.allocate(rows, info=info, shared=not device.link.clock.virtual)


def _arm(
    device: FramedDevice,
    request: TrialRequest,
    thread: Callable[..., LoopThread],
    controller: ControllerState,
    ring: Ring,
    realtime: Realtime,
    signals: Signals,
) -> LoopThread:
    """Arm the device, and return the control loop's thread, which is not started yet."""
    run, virtual = request.run, device.link.clock.virtual
    experiment, model = run.experiment, rig_model(run.experiment)
    period_s = 1.0 / experiment.controller.position_rate
    realtime.prefault(ring.buffer)  # before arming: an armed device waits for half a second only
    settings = LoopSettings(
        period_ns=round(period_s * 1e9),
        session=device.arm(),
        lifetime_us=int(run.parameters["command_lifetime_us"]),
        lost_after_ns=round(max(LOST_AFTER_S, LOST_AFTER_PERIODS * period_s) * 1e9),
        device_tick_ps=round(device.dictionary.time_unit_ns * 1000),
        current_quantum_a=device.dictionary.current_quantum_a,
        wait_for_room=virtual,
        host_paced=experiment.host.pacing == "host",
        stop_when_late=experiment.host.overrun == "stop",
        spin_ns=0 if virtual else round(min(experiment.host.spin_s, SPIN_SHARE * period_s) * 1e9),
        stop_requests=stop_requests.address(),
        stop_requests_before=signals.series.since,
        exchange_every_ns=EVERY_NS,
        limit_switch=_switch_rule(experiment, leaves=request.leaves_switch),
    )
    if run.on_device is not None:
        settings = _supervise(settings, run.on_device, run.parameters)
    return thread(
        device.link,
        controller,
        settings,
        ring,
        realtime=realtime,
        heartbeat_s=experiment.host.heartbeat_s,
        nonce=device.nonce,
        sensor=current_sensor(model) if _compares_currents(device, run.on_device) else None,
        encoder_sign=model.encoder.sign,
    )


def _compares_currents(device: FramedDevice, law: LawOnDevice | None) -> bool:
    return device.dictionary.current_measured and (law is None or law.currents_compared)


def _switch_rule(experiment: Experiment, *, leaves: bool) -> int:
    """Return when a limit switch ends the run: 0 never, 1 at once, n > 1 when it was open for n − 1 ticks before."""
    if experiment.rig.reference.limit_switch == "none":
        return 0
    return 1 + math.ceil(BOUNCE_S * experiment.controller.position_rate) if leaves else 1


def _loop_of(run: PreparedRun, link: Link) -> Callable[..., LoopThread]:
    """Compile the loop; return its thread class: computing the law, or supervising a law on the device."""
    if run.on_device is None:
        LoopThread.prepare(link, run.controller)
        return LoopThread
    SupervisedThread.prepare(link, run.controller)
    return partial(SupervisedThread, live=run.on_device.live)


def _supervise(settings: LoopSettings, law: LawOnDevice, parameters: Mapping[str, Value]) -> LoopSettings:
    """Return the settings of a loop that supervises the law on the device and computes the same law in parallel."""
    return replace(
        settings,
        lifetime_us=int(parameters["supervise_lifetime_us"]),
        supervise_every_ns=round(SUPERVISE_EVERY_S * 1e9),
        batch_samples=int(parameters["batch_samples"]),
        agreement_quanta=BOUNDS.get(law.arithmetic, NO_BOUND),
    )


def _bring_to_rest(device: FramedDevice, loop: LoopThread) -> None:
    """Stop the loop and the device, so that the effort is zero. Never raise."""
    loop.finish()
    streams = loop.handover()
    if streams is not None:
        device.take_back(**streams)
    device.stop()


def _seal(
    request: TrialRequest, truth: NDArray[np.void] | None, error: Exception | None
) -> tuple[Recording | None, Judgement | None]:
    """Judge the recording of a trial, and seal (compress and check) its file; return both results.

    If sealing fails after a run that ended with `error`, add a note to `error`; after any other run raise.
    """
    if not request.sealed:
        return None, None
    judgements: list[Judgement] = []

    def judged(recording: Recording) -> dict[str, Any]:
        if request.judge is None:
            return {}
        judgements.append(request.judge(recording))
        return dict(lossless(judgements[0]))

    try:
        sealed = seal(open_recording(request.recording), truth, judge=judged)
        return sealed, judgements[0] if judgements else None
    except RigError as own:
        if error is None:
            own.recording = request.recording
            raise
        error.add_note(f"the recording was not sealed: {own}")
        return None, None


def _conclude(
    device: FramedDevice,
    loop: LoopThread,
    end: LoopEnd,
    recorder: Recorder,
    realtime: Realtime,
    exchanges: list[NDArray[np.void]],
    stopped: Exception | None,
) -> tuple[LoopEnd, Exception | None]:
    """Read the device's fault report, disarm the device and close the recording.

    Return how the loop ended, and the error of the run (None without problems). `stopped` is the exception that the
    caller's progress function raised, or None.
    """
    rows = loop.ring.last_rows(BLACK_BOX_ROWS)
    exchanges.append(as_exchanges(loop.exchanges()))
    fault: FaultReport | None = None
    # The device may be disconnected or the simulation may fail here: the reason for the end is known already.
    with suppress(Exception):
        if end.reason == EndReason.DEVICE_FAULT:
            fault = device.explain_fault(loop.fault)  # from STATE, in case the device does not reply now
            report = device.fault_report()
            fault = report if report.code != Fault.NONE else fault
        if end.reason == EndReason.LINK_SILENT and device.has_restarted():
            end = replace(end, reason=EndReason.DEVICE_RESTARTED)
        device.disarm(clear_fault=True)
        # At rest no other traffic delays a reply: the exchanges before and after the run fix the line of the clock fit,
        # about which the exchanges during the run scatter.
        exchanges.append(device.exchange_clock())
    if end.reason == EndReason.DEVICE_FAULT and loop.fault == Fault.LINK_LOST and _too_old_since(rows):
        end = replace(end, reason=EndReason.LINK_DELAYED)  # the host was not silent
    error: Exception | None = error_of(end, device.link.url.text, fault, rows)
    if stopped is not None and end.reason == EndReason.STOPPED:
        error = stopped
    trailer = _trailer(loop, end, fault, error, realtime, np.concatenate(exchanges))
    if (facts := getattr(device.link, "bus_facts", None)) is not None:
        trailer["drive"] = facts()
    recorder.finish(trailer)
    return end, error


def _too_old_since(rows: NDArray[np.void]) -> bool:
    """Return True if the last commands arrived at the device after their lifetime, so that the device ignored them."""
    since = rows[rows["command_active"] == rows["command_active"][-1:]]
    return bool((since["limits"] & int(LimitFlag.COMMAND_TOO_OLD)).any())


def _header(
    device: FramedDevice,
    request: TrialRequest,
    controller: ControllerState,
    echo: Echo,
    realtime: Realtime,
    clock: ClockFit | None,
) -> dict[str, Any]:
    experiment, dictionary = request.run.experiment, device.dictionary
    return make_header(
        rig=experiment.rig.name,
        motion=experiment.rig.motion,
        experiment=as_mapping(experiment),
        identity={
            "url": device.link.url.text,
            "device": dictionary.device,
            "firmware": dictionary.firmware,
            "simulated": dictionary.simulated,
            "reference": REFERENCES[int(echo.values.get("reference", 0))],
            "current_quantum_a": dictionary.current_quantum_a,
            "settings": {info.name: info.value for info in dictionary.settings},
            "parameters": echo.values,
            "parameters_crc": echo.crc,
            "parameters_since": echo.sample_index,
        },
        clocks={
            "kind": "virtual" if device.link.clock.virtual else "monotonic",
            **({} if clock is None else lossless(clock)),
        },
        seed=request.seed,
        protocol=f"{MAJOR}.{MINOR}",
        initial_state=controller.as_mapping(),
        extra={**_where_the_law_runs(request.run.on_device, echo), **request.extra},
        host={"scheduling": realtime.report},
    )


def _where_the_law_runs(law: LawOnDevice | None, echo: Echo) -> dict[str, Any]:
    """Return header entries on the control law: host or device, arithmetic, and the wall as the device computes it."""
    if law is None:
        return {"loop": "host"}
    return {"loop": "device", "arithmetic": law.arithmetic, "wall": law.rendered(echo.values)}


def _trailer(
    loop: LoopThread,
    end: LoopEnd,
    fault: FaultReport | None,
    error: Exception | None,
    realtime: Realtime,
    exchanges: NDArray[np.void],
) -> dict[str, Any]:
    clock = fit_if_possible(exchanges)
    return {
        "reason": end.reason.name.lower(),
        "error": None if error is None else str(error) if isinstance(error, RigError) else repr(error),
        "fault": None if fault is None else asdict(fault),
        "counters": end.counters,
        "watched": end.watched,
        "parameter_sets": loop.parameter_sets(),
        "exchanges": [list(stamps) for stamps in exchanges.tolist()],
        "clock": clock,
        "scheduling": realtime.report,
        **loop.findings(),
    }
