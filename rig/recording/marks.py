"""Marks of a recording: its events (contact, end, sync edges, …) with their times on the clocks of device and host.

========  =============================================================================================
homed     the first sample after homing
free space
          the first sample of the phase without effort before the trial, in which the person waits
trial     the first sample of the trial
contact   each first sample inside the wall after a sample outside the wall, during the trial
release   the first sample of the release
end       the last sample
sync      a rising edge of the sync input; `tick` is the tick of the first row that reports the edge
trial_out, inside_out
          a rising edge of a sync output, if the host ran the control law: the begin of the device tick that set
          the output; if samples before it are missing, the edge was earlier by up to the length of this gap
========  =============================================================================================

Device times are on the scale of the column device_time. Host times are computed by the clock fit (host time over device
time); without a clock fit they are None.

Storing a recording as Parquet, the MCAP export, `rig recording show` and studies use this module. The recording must
not be changed.
"""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Input
from rig.core.errors import RigError
from rig.core.present import plain
from rig.core.sample import Phase, RowFlag
from rig.recording._ledger import CLOCK_KEY, clock_of, period_ns_of
from rig.recording.canonical import lossless
from rig.recording.data import Recording
from rig.recording.timing import device_times

EDGES_KEY = "sync_edges"  # of the trailer
OUTPUTS = {"trial_out": Input.SYNC_TRIAL, "inside_out": Input.SYNC_INSIDE}

_log = logging.getLogger(__name__)
_Ints = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Mark:
    """An event in a recording, e.g. the first contact with the wall.

    Attributes
    ----------
    name
        Name of the event: "homed", "free space", "trial", "contact", "release", "end", "sync", "trial_out" or
        "inside_out".
    device_time
        Time on the device's clock (ns).
    host_time
        Time on the host's clock, converted by the clock fit (ns); None without a clock fit.
    tick
        Number of the control tick.
    """

    name: str
    device_time: int
    host_time: int | None
    tick: int


def marks(recording: Recording) -> list[Mark]:
    """Return the events in a recording (contact, end, sync edges, …), ordered by their time on the device's clock.

    Raise `RigError` if the clock fit in the recording's trailer is invalid.
    """
    if not len(recording):
        return []
    found = [*_of_phases(recording.rows), *_of_edges(recording), *_of_outputs(recording)]
    return _on_both_clocks(recording, sorted(found, key=lambda mark: (mark[1], mark[2])))


def sync_edges(recording: Recording) -> list[Mark]:
    """Return the rising edges of the sync input in a recording as marks, with their times (ns)."""
    return _on_both_clocks(recording, _of_edges(recording))


def with_sync_edges(recording: Recording) -> Recording:
    """Return a copy of the recording whose trailer lists the rising edges of the sync input with their times (ns).

    Return the recording unchanged if its trailer has no clock fit or an invalid one: an invalid clock fit must not
    prevent a recording from being stored.
    """
    trailer = recording.trailer or {}
    if CLOCK_KEY not in trailer:
        return recording
    try:
        edges = sync_edges(recording)
    except RigError as error:
        _log.warning("%s: the edges of the sync input cannot be dated: %s", recording.path, error)
        return recording
    listed = [{key: value for key, value in plain(edge).items() if key != "name"} for edge in edges]
    return replace(recording, trailer={**trailer, EDGES_KEY: lossless(listed)})


_Found = tuple[str, int, int]  # name, device time, tick


def _of_phases(rows: NDArray[np.void]) -> Iterator[_Found]:
    phase = rows["phase"]
    trial = phase == Phase.TRIAL
    homing = np.flatnonzero(phase == Phase.HOMING)
    behind = np.flatnonzero(phase > Phase.HOMING)
    inside = trial & ((rows["flags"] & int(RowFlag.INSIDE)) != 0)
    places = {
        "homed": behind[behind > homing[0]][:1] if len(homing) else homing,
        "free space": np.flatnonzero(phase == Phase.FREE)[:1],
        # After a free-space phase this is the time of the cue.
        "trial": np.flatnonzero(trial)[:1],
        "contact": _rising(inside),
        "release": np.flatnonzero(phase == Phase.RELEASE)[:1],
        "end": [len(rows) - 1],
    }
    for name, found in places.items():
        for place in found:
            yield name, int(rows["device_time"][place]), int(rows["tick"][place])


def _of_edges(recording: Recording) -> list[_Found]:
    """Return name, device time (ns) and tick of each rising edge of the sync input after the first row."""
    rows = recording.rows
    edge: _Ints = rows["sync_time"]
    places = 1 + np.flatnonzero((edge[1:] != edge[:-1]) & (edge[1:] != 0))
    return [("sync", int(edge[place]), int(rows["tick"][place])) for place in places]


def _of_outputs(recording: Recording) -> Iterator[_Found]:
    """Yield name, device time (ns) and tick of each rising edge of a sync output, one tick before its report."""
    loop = str((recording.header.get("extra") or {}).get("loop", "host"))
    # A law on the device sets the outputs in the tick of the sample itself: trial and contact are their marks.
    if loop != "host":
        return
    rows = recording.rows
    period_ns = round(period_ns_of(recording))
    for name, bit in OUTPUTS.items():
        for place in _rising((rows["inputs"] & int(bit)) != 0):
            yield name, int(rows["device_time"][place]) - period_ns, int(rows["tick"][place])


def _rising(active: _Mask) -> _Ints:
    """Return the row numbers at which `active` changes from False to True; row 0 counts if it is True."""
    return np.flatnonzero(active & ~np.concatenate(([False], active[:-1])))


def _on_both_clocks(recording: Recording, found: Iterable[_Found]) -> list[Mark]:
    found = list(found)
    fit = clock_of(recording)
    if fit is None or not found:
        return [Mark(name, device, None, tick) for name, device, tick in found]
    rows = recording.rows
    first: _Ints = rows["device_time"][:1]
    shift = int(device_times(first, fit, int(rows["received_at"][0]))[0]) - int(first[0])
    host = fit.host_of(np.array([device for _, device, _ in found], np.int64) + shift)
    return [
        Mark(name, device, int(time), tick) for (name, device, tick), time in zip(found, host, strict=True)
    ]
