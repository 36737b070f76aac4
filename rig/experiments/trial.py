"""One trial on an open device: configure, arm, run the loop, come to rest, and leave a recording whatever happens.

The order at the end is fixed: zero effort first, then the recorder, then the reason. Nothing on that way
depends on what went wrong before it.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import MAJOR, MINOR
from rig import controller as controllers
from rig.config import Experiment, as_mapping
from rig.devices.framed import Echo, FaultReport, FramedDevice
from rig.errors import RigError, StoppedError
from rig.experiments.endings import error_of
from rig.laws import Law
from rig.loop.host import EndReason
from rig.loop.run import LoopEnd, LoopSettings, LoopThread
from rig.recording.data import Recording
from rig.recording.header import make_header
from rig.recording.reader import open_recording
from rig.recording.recorder import Recorder
from rig.recording.seal import seal, with_truth
from rig.ring import STOP, Ring
from rig.step import Controller

BLACK_BOX_ROWS = 100
LOST_AFTER_S = 0.05  # silence that ends a run: the device has ramped down long before
LOST_AFTER_PERIODS = 3
RING_SECONDS = 5.0
RING_ROWS_MINIMUM = 4096

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class TrialRequest:
    """What a trial needs to know besides the device: where its recording goes, and who may interfere."""

    experiment: Experiment
    recording: Path
    verified: bool
    seed: int
    reference_count: int = 0  # count at position zero
    law: Law | None = None
    progress: Progress | None = None
    judge: Callable[[Recording], dict[str, Any]] | None = None  # what to add to the recording's trailer
    sealed: bool = True  # False leaves the capture as it is, for callers that run thousands of trials
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TrialEnd:
    """How a trial ended: the sealed recording, the reason, and the counters of the link."""

    recording: Path
    reason: EndReason
    counters: dict[str, int]


def run_trial(device: FramedDevice, request: TrialRequest) -> TrialEnd:
    """Run one trial and seal its recording.

    Raises
    ------
    DeviceRefusedError, PlanError
        The device does not take the configuration or does not arm; nothing moved and nothing was recorded.
    LinkLostError, DeviceFaultError, GuardError, LawError, StoppedError
        The run ended early. The effort is zero, the recording is closed, and its path stands in the error's
        `recording`.
    """
    experiment = request.experiment
    quantum = device.dictionary.current_quantum_a
    controller = controllers.for_experiment(
        experiment, current_quantum_a=quantum, reference_count=request.reference_count, law=request.law
    )
    parameters = controllers.device_parameters(
        experiment,
        current_quantum_a=quantum,
        reference_count=request.reference_count,
        verified=request.verified,
    )
    echo = device.configure(parameters)
    header = _header(device, request, controller, echo)
    ring = Ring.allocate(max(RING_ROWS_MINIMUM, round(RING_SECONDS * experiment.controller.position_rate)))
    virtual = device.link.clock.virtual
    with _signals_stop(ring) as signals:
        with Recorder(request.recording, header, ring, virtual=virtual) as recorder:
            try:
                loop = _arm(device, experiment, controller, ring)
            except BaseException:
                request.recording.unlink(missing_ok=True)  # nothing moved: no empty recording stays behind
                raise
            try:
                loop.start()
                loop.wait(request.progress)
            finally:
                _bring_to_rest(device, loop)
            end = loop.end()
            error = _conclude(device, end, ring, recorder)
        path = _seal(request, device.link.truth(), error)
    if error is None and signals:
        error = StoppedError("stopped after the trial had finished; the effort is zero")
    if error is not None:
        error.recording = path
        raise error from end.error
    return TrialEnd(path, end.reason, end.counters)


def _arm(device: FramedDevice, experiment: Experiment, controller: Controller, ring: Ring) -> LoopThread:
    period_s = 1.0 / experiment.controller.position_rate
    settings = LoopSettings(
        period_ns=round(period_s * 1e9),
        session=device.arm(),
        lifetime_us=round(controllers.command_lifetime_s(experiment) * 1e6),
        lost_after_ns=round(max(LOST_AFTER_S, LOST_AFTER_PERIODS * period_s) * 1e9),
        device_tick_ps=round(device.dictionary.time_unit_ns * 1000),
        current_quantum_a=device.dictionary.current_quantum_a,
        wait_for_room=device.link.clock.virtual,
    )
    return LoopThread(device.link, controller, settings, ring)


def _bring_to_rest(device: FramedDevice, loop: LoopThread) -> None:
    """Zero effort before anything else is looked at. Cannot raise."""
    loop.finish()
    streams = loop.handover()
    if streams is not None:
        device.take_back(**streams)
    device.stop()


def _seal(request: TrialRequest, truth: NDArray[np.void] | None, error: RigError | None) -> Path:
    """Seal the capture, with what the caller's judge says of it. A failure here never hides the `error` of the run."""
    if not request.sealed:
        return request.recording
    try:
        more = None
        if request.judge is not None:
            recording = open_recording(request.recording)
            more = request.judge(recording if truth is None else with_truth(recording, truth))
        return seal(request.recording, truth, extra_trailer=more)
    except RigError as own:
        if error is None:
            own.recording = request.recording
            raise
        error.add_note(f"the recording was not sealed: {own}")
        return request.recording


def _conclude(device: FramedDevice, end: LoopEnd, ring: Ring, recorder: Recorder) -> RigError | None:
    """Hear the device's side, disarm it, close the recording; return the error that the ending means, if any."""
    rows = ring.last_rows(BLACK_BOX_ROWS)
    fault: FaultReport | None = None
    with suppress(
        Exception
    ):  # the far end may be gone, or the simulation broken: what ended the run is known
        if end.reason == EndReason.DEVICE_FAULT:
            fault = device.explain_fault(
                int(rows["fault"][-1])
            )  # what STATE says, in case nobody answers now
            fault = device.fault_report()
        device.disarm(clear_fault=True)
    error = error_of(end, device.link.url.text, fault, rows)
    recorder.finish(_trailer(end, fault, error))
    return error


@contextmanager
def _signals_stop(ring: Ring) -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM stop the loop instead of raising here, as often as they come; yields those that came.

    An exception in between, from the first or from a second signal, could cut short what brings the rig to rest.
    Only the main thread gets signals; ignored ones stay ignored.
    """
    seen: list[int] = []

    def stop(number: int, frame: object) -> None:
        seen.append(number)
        ring.put(STOP, 1)

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    taken = [number for number, handler in before.items() if handler not in (None, signal.SIG_IGN)]
    try:
        for number in taken:
            signal.signal(number, stop)
        yield seen
    finally:
        for number in taken:
            signal.signal(number, before[number])


def _header(
    device: FramedDevice, request: TrialRequest, controller: Controller, echo: Echo
) -> dict[str, Any]:
    experiment, dictionary = request.experiment, device.dictionary
    offset = device.clock_offset()
    return make_header(
        rig=experiment.rig.name,
        motion=experiment.rig.motion,
        experiment=as_mapping(experiment),
        identity={
            "url": device.link.url.text,
            "device": dictionary.device,
            "firmware": dictionary.firmware,
            "simulated": dictionary.simulated,
            "current_quantum_a": dictionary.current_quantum_a,
            "parameters": echo.values,
            "parameters_crc": echo.crc,
            "parameters_since": echo.sample_index,
        },
        clocks={"kind": "virtual" if device.link.clock.virtual else "monotonic", **asdict(offset)},
        seed=request.seed,
        protocol=f"{MAJOR}.{MINOR}",
        initial_state=controller.as_mapping(),
        extra={"loop": "host", **request.extra},
    )


def _trailer(end: LoopEnd, fault: FaultReport | None, error: RigError | None) -> dict[str, Any]:
    return {
        "reason": end.reason.name.lower(),
        "error": None if error is None else str(error),
        "fault": None if fault is None else asdict(fault),
        "counters": end.counters,
    }
