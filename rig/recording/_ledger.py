"""Latencies of a recording: fill its columns sampled_at and applied_at (ns, host clock), and add a summary of them.

A run that was ended by kill -9 has no clock fit: it has only the times that the host measured.
"""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.core.clock_fit import ClockFit
from rig.core.errors import RecordingError, RigError
from rig.recording._timing_summary import TimingSummary, summarise
from rig.recording.canonical import lossless
from rig.recording.data import Recording
from rig.recording.timing import LATENESS, STAGES, Ledger, ledger

__all__ = [
    "CLOCK_KEY",
    "LATENESS",
    "STAGES",
    "TIMING_KEY",
    "Ledger",
    "TimingSummary",
    "clock_of",
    "ledger_of",
    "period_ns_of",
    "summarise",
    "with_ledger",
]

CLOCK_KEY = "clock"  # of the trailer: a `rig.core.clock_fit.ClockFit`
TIMING_KEY = "timing"  # of the trailer: a `rig.recording._timing_summary.TimingSummary`

_log = logging.getLogger(__name__)


def with_ledger(recording: Recording) -> Recording:
    """Return the recording with a summary of its latencies in the trailer, the data at its end.

    Fill in place the columns sampled_at and applied_at: when the encoder was sampled and the command took effect.
    Return the recording unchanged if it has no rows, or if its trailer has no clock fit or (with a logged warning) an
    invalid one: an invalid clock fit must not prevent a recording from being stored.
    """
    trailer = recording.trailer or {}
    if CLOCK_KEY not in trailer or not len(recording):
        return recording
    try:
        found = ledger_of(recording)
    except RigError as error:
        _log.warning("%s: the latency ledger stays empty: %s", recording.path, error)
        return recording
    recording.rows["sampled_at"], recording.rows["applied_at"] = found.sampled, found.applied
    timing = lossless(summarise(found, trailer.get("counters")))
    return replace(recording, trailer={**trailer, TIMING_KEY: timing})


def ledger_of(recording: Recording) -> Ledger:
    """Return when each tick was sampled, received, computed, sent and applied (ns, on the host's clock).

    Device times are converted by the clock fit in the recording's trailer, if there is one. Raise `RecordingError`
    without rows, and `RigError` if the clock fit is invalid.
    """
    if not len(recording):
        raise RecordingError("the recording has no rows", remedy="record again: the loop received no sample")
    loop = str((recording.header.get("extra") or {}).get("loop", "host"))
    return ledger(recording.rows, clock_of(recording), period_ns_of(recording), loop)


def clock_of(recording: Recording) -> ClockFit | None:
    """Return the fit of host time over device time in a recording's trailer, or None; raise `RigError` if invalid."""
    clock = (recording.trailer or {}).get(CLOCK_KEY)
    return None if clock is None else ClockFit.from_mapping(clock)


def period_ns_of(recording: Recording) -> float:
    """Return the length of a device tick (ns): from the experiment's position rate, or else from the device times."""
    rate = (recording.experiment.get("controller") or {}).get("position_rate")
    if rate:
        return 1e9 / float(rate)
    time: NDArray[np.int64] = recording.rows["device_time"]
    index: NDArray[np.int64] = recording.rows["sample_index"]
    passed = int(index[-1]) - int(index[0])
    return (int(time[-1]) - int(time[0])) / passed if passed > 0 else 0.0
