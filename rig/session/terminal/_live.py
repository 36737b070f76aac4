"""Read the newest rows of a control loop in another process, to display them.

This module must not read the loop's info (`rig.realtime.ring`), which contains stiffness and damping, because the
operator may be blinded.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.core.sample import RowFlag, phase_name
from rig.realtime import running
from rig.realtime.control_words import HEAD, LATE, LOOP_DONE, LOST, PHASE, SKIPPED
from rig.realtime.ring import Ring

# Number of newest rows to read: a small part of the ring buffer, so that the loop does not overwrite them meanwhile.
ROWS = 512


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Current values of a running trial, for display.

    Attributes
    ----------
    phase
        Name of the phase (`rig.core.sample.phase_name`).
    position, velocity, penetration, effort
        Measured position, estimated velocity, measured penetration and applied effort of the newest row (units of the
        rig's motion).
    peak_effort
        Largest applied effort of the newest rows (N·m or N).
    saturated
        True if the effort was clipped to its limit in one of these rows.
    round_trip_ns
        Median time from sending a command to the reception of the first sample in which the command is active (ns).
        None if the control law runs on the device, and before the first such sample.
    late, lost, skipped
        Numbers of late ticks, lost samples and skipped samples of the run so far.
    """

    phase: str
    position: float
    velocity: float
    penetration: float
    effort: float
    peak_effort: float
    saturated: bool
    round_trip_ns: int | None
    late: int
    lost: int
    skipped: int


class LiveLoop:
    """Reader of another process's control loop, through shared memory that is open only while the loop runs."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._ring: Ring | None = None

    def look(self) -> Snapshot | None:
        """Return the current values of the running trial; None if no control loop runs or it has no sample yet."""
        if self._ring is None:
            self._ring = running.memory_of(self._pid)
        if self._ring is None:
            return None
        if self._ring.peek(LOOP_DONE):
            self.close()
            return None
        return snapshot_of(self._ring)

    def close(self) -> None:
        """Close the shared memory of the control loop."""
        if self._ring is not None:
            self._ring.close()
            self._ring = None


def snapshot_of(ring: Ring) -> Snapshot | None:
    """Return the current values of a trial from the newest rows of its ring buffer; None before the first row."""
    head = ring.peek(HEAD)
    count = min(head, ROWS, ring.capacity // 4)
    if count == 0:
        return None
    rows = ring.rows[np.arange(head - count, head) % ring.capacity]
    last, applied = rows[-1], rows["effort_applied"]
    phase = ring.peek(PHASE)
    return Snapshot(
        phase=phase_name(phase),
        position=float(last["position"]),
        velocity=float(last["velocity"]),
        penetration=float(last["penetration"]),
        effort=float(last["effort_applied"]),
        peak_effort=float(np.abs(applied).max()),
        saturated=bool((rows["flags"] & RowFlag.SATURATED).any()),
        round_trip_ns=_round_trip_ns(rows),
        late=ring.peek(LATE),
        lost=ring.peek(LOST),
        skipped=ring.peek(SKIPPED),
    )


def _round_trip_ns(rows: NDArray[np.void]) -> int | None:
    """Return the median time (ns) from sending a command to receiving the first sample in which it is active.

    Return None if no command was reported as active.
    """
    named, first = np.unique(rows["command_active"], return_index=True)
    order = np.argsort(rows["command_sequence"], kind="stable")
    place = np.searchsorted(rows["command_sequence"], named, sorter=order)
    known = place < len(rows)
    named, first, sent = named[known], first[known], order[place[known]]
    known = (rows["command_sequence"][sent] == named) & (first > sent) & (rows["sent_at"][sent] > 0)
    times = rows["received_at"][first[known]] - rows["sent_at"][sent[known]]
    return int(np.median(times)) if len(times) else None
