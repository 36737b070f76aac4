"""A short hit on a device in the guest, struck by something in the middle, and what must hold whatever happens.

An emulated machine keeps no time: a hit may end by itself, by the loss of the link or a fault of the device that its
slowness causes, or by the guard, when answers come so late that they throw the handle out. What is asserted is the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from firmware_protocol.connection import State
from rig import config, presets
from rig.errors import GuardError, LinkLostError, RigError
from rig.experiments.hit import HitRequest, HitResult, hit
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from tests.guest.far_end import FarEnd

RIG = "koul-compliant"
MODEL = config.rig_model(config.with_realtime(presets.load(RIG)))
CHANGES = {
    "trial.duration_s": 0.5,
    "trial.release_s": 0.05,
    "homing.settle_s": 0.05,
    "controller.parameters": {"cutoff_hz": 100.0},  # below half the device's rate, as the next one
    "verdict.lowpass_hz": 200.0,
    "verdict.tail_s": 0.1,
}
BOUND_S = 60.0
COUNTED = ("frames", "bad_frames", "lost", "commands", "unsent", "late", "rows_dropped")


@dataclass(frozen=True, slots=True)
class Ended:
    """How a hit ended: its result or its error, and its recording when one was begun."""

    result: HitResult | None
    error: RigError | None
    recording: Recording | None
    wall_s: float


def short_hit(
    url: str, output: Path, *, strike: Callable[[], None] | None = None, at_tick: int = 20
) -> Ended:
    """Hit once; `strike` is called when `at_tick` ticks have run."""
    struck = False

    def progress(ticks: int, phase: int) -> None:
        nonlocal struck
        if strike is not None and not struck and ticks >= at_tick:
            struck = True
            strike()

    experiment = config.with_realtime(presets.load(RIG))
    request = HitRequest(experiment=experiment, url=url, changes=CHANGES, output=output)
    result, error, path = None, None, None
    started = time.monotonic()
    try:
        (result,) = hit(request, lambda repeat, in_effect: progress)
        path = result.recording
    except RigError as caught:
        error, path = caught, caught.recording
    wall_s = time.monotonic() - started
    return Ended(result, error, None if path is None else open_recording(path), wall_s)


def check_ended_safely(ended: Ended, far_end: FarEnd) -> None:
    """Completion or a typed error in bounded time; zero effort at the device; losses counted; a recording that reads."""
    assert ended.wall_s < BOUND_S
    assert ended.error is None or isinstance(ended.error, LinkLostError | GuardError), ended.error
    assert ended.error is None or ended.error.remedy
    left = far_end.left()
    assert left.current == 0
    assert left.state not in (State.ARMED, State.RUNNING)
    assert ended.recording is not None
    assert ended.recording.complete
    counters = ended.recording.trailer["counters"]
    assert all(counters[name] >= 0 for name in COUNTED)
    assert counters["ticks"] == len(ended.recording.rows)
