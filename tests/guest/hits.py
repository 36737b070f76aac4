"""A short hit on a device in the guest with a fault in the middle, and the claims that must hold at its end.

An emulated machine keeps no time: a hit may also end by a lost link, a fault of the device or the guard, since replies
are late. The same is asserted then.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_protocol.connection import State
from rig import config
from rig.config import Experiment, presets
from rig.core.errors import DeviceFaultError, GuardError, LinkLostError, RigError
from rig.devices import open_device
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.recording.reader import open_recording
from tests.conformance.tolerance import too_busy
from tests.conformance.trials import trial_on
from tests.guest.far_end import RATE, FarEnd

RIG = "koul-compliant"
EXPERIMENT = config.with_realtime(presets.load(RIG))
MODEL = config.rig_model(EXPERIMENT)
CHANGES: dict[str, Any] = {
    "trial.duration_s": 0.3,
    "trial.release_s": 0.02,
    "homing.settle_s": 0.02,
    "controller.parameters": {"cutoff_hz": 100.0},  # below half the device's rate, as the next one
    "verdict.lowpass_hz": 200.0,
    "verdict.tail_s": 0.1,
    "host.realtime": "off",  # what it would lock into memory comes over 9p
    "host.heartbeat_s": 30.0,
}
ITS_TURN_S = 0.5
ATTEMPTS = 3
BOUND_S = 120.0  # "it comes back", not how soon
COUNTED = ("frames", "bad_frames", "lost", "commands", "unsent", "late", "rows_dropped")
TOO_SLOW = (LinkLostError, DeviceFaultError, GuardError)  # errors of a run without a fault


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of a hit: its error or None, its recording, and its duration (s)."""

    error: RigError | None
    path: Path | None
    wall_s: float


def whole_hit(
    url: str,
    output: Path,
    experiment: Experiment = EXPERIMENT,
    changes: Mapping[str, Any] = CHANGES,
    *,
    verified: bool = False,
) -> Ended:
    """Run ``rig hit --url …`` with its gate, its verdict and its sealed recording."""

    def run() -> Path:
        more = {"output": output, "verified": verified, "arm_anyway": True}
        request = HitRequest(experiment=experiment, url=url, changes=changes, **more)
        (result,) = hit(request, admit)
        return result.path

    return _run_until_begun(run)


def struck_trial(url: str, output: Path, strike: Callable[[], None], at_tick: int = 20) -> Ended:
    """Run one trial; call `strike` when `at_tick` ticks have run."""
    struck = False

    def progress(ticks: int, phase: int) -> None:
        nonlocal struck
        if not struck and ticks >= at_tick:
            struck = True
            strike()

    def run() -> Path:
        rates = dict.fromkeys(("controller.position_rate", "controller.velocity_rate"), RATE)
        experiment = config.override(EXPERIMENT, {**CHANGES, **rates})
        recording = output / f"struck-{len(list(output.iterdir()))}.rigcap"
        with open_device(url) as device:
            return trial_on(device, experiment, recording, progress=progress, sealed=False).recording

    return _run_until_begun(run)


def _run_until_begun(run: Callable[[], Path]) -> Ended:
    """Run a hit; repeat it if it did not begin, because a busy emulator can exceed the request timeout of 0.1 s."""
    for _ in range(ATTEMPTS):
        started = time.monotonic()
        try:
            error, path = None, run()
        except RigError as caught:
            error, path = caught, caught.recording
        ended = Ended(error, path, time.monotonic() - started)
        if path is not None or not isinstance(error, LinkLostError):
            return ended
    too_busy(f"no answer to {ATTEMPTS} requests: {error}")


def check_ended_safely(ended: Ended, far_end: FarEnd, *kinds: type[RigError]) -> None:
    """Check completion or a typed error in bounded time, zero effort at the device, and a readable recording.

    `kinds` are the errors of the fault; those of a machine that is too slow may come first.
    """
    if isinstance(ended.error, LinkLostError):
        time.sleep(ITS_TURN_S)  # `left` stops the device at once, and its own watchdog needs time
    print(f"{ended.wall_s:.1f} s: {type(ended.error).__name__}: {ended.error}; {far_end.left()}")
    assert far_end.left().current == 0
    assert far_end.left().state not in (State.ARMED, State.RUNNING)
    check_recorded(ended, *kinds)


def check_recorded(ended: Ended, *kinds: type[RigError]) -> None:
    """Check the host's part of `check_ended_safely`."""
    assert ended.wall_s < BOUND_S
    assert ended.error is None or type(ended.error) in (*kinds, *TOO_SLOW), repr(ended.error)
    assert ended.error is None or ended.error.remedy
    assert ended.path is not None
    recording = open_recording(ended.path)
    assert recording.complete
    assert not recording.lost
    counters = recording.trailer["counters"]
    assert all(counters[name] >= 0 for name in COUNTED)
    assert counters["ticks"] == len(recording.rows) + counters["rows_dropped"]
