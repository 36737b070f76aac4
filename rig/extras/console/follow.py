"""Find the control loops that run on this computer, and read the rows (one for each tick) of one loop.

The live view uses it. It reads shared memory and must not delay the loop: it writes only a request to stop.
"""

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from firmware_protocol.faults import Fault
from rig.core.errors import RigError
from rig.core.sample import RowFlag, phase_name
from rig.extras.console.history import History
from rig.loop.layout import EndReason
from rig.realtime import control_words
from rig.realtime.control_words import LAYOUT_VERSION, STOP
from rig.realtime.ring import Ring
from rig.realtime.row_reader import RowReader
from rig.realtime.running import RunningLoop, running

_COUNTERS = {
    "dropped": control_words.DROPPED,
    "lost": control_words.LOST,
    "late": control_words.LATE,
    "skipped": control_words.SKIPPED,
    "bad_frames": control_words.BAD_FRAMES,
    "stale": control_words.STALE,
    "overruns": control_words.OVERRUNS,
}


class Followed:
    """A control loop whose samples are read from shared memory; only a request to stop is ever written there.

    `pid` is the process of the loop, `info` has the facts that the loop publishes about its run, `rate` is in rows
    (samples of all columns) a second (Hz), `history` has the rows read so far.
    """

    def __init__(self, loop: RunningLoop, history: History) -> None:
        self.rate = _rate_of(loop.info)
        self.pid, self.since = loop.pid, loop.since
        self._ring = Ring.attach(loop.path)
        self._reader = RowReader(self._ring)
        self._info_word = -1
        self.info: dict[str, Any] = {}
        self._look_at_info()
        history.clear()
        self.history = history
        self.ended = False

    def poll(self) -> None:
        """Append the loop's new samples to `history`, and check whether the loop has ended."""
        # Read this flag before the rows: if it is set, no row can follow after the ones read next.
        done = self._ring.get(control_words.LOOP_DONE) != 0
        self.history.add(self._reader.new())
        self.ended = done

    def stop(self) -> None:
        """Request a stop in the loop's shared memory: the effort becomes zero within one tick."""
        self._ring.put(STOP, -os.getpid())

    def changed(self) -> bool:
        """Return True if the facts that the loop publishes have changed since the last call."""
        return self._look_at_info()

    def state(self) -> dict[str, Any]:
        """Return phase, counters, end reason and newest values (SI) of the loop, for JSON."""
        ring, newest = self._ring, self.history.raw(self.history.rows - 1, self.history.rows)
        state = {
            "pid": self.pid,
            "phase": phase_name(ring.get(control_words.PHASE)),
            "ticks": ring.get(control_words.TICKS),
            "set": ring.get(control_words.PARAMETER_SET),
            "stopping": ring.get(STOP) != 0,
            "counters": {name: ring.get(word) for name, word in _COUNTERS.items()},
            "unseen": self._reader.lost,
            "ended": _reason(ring.get(control_words.END_REASON)) if self.ended else None,
        }
        if len(newest):
            row = newest[0]
            fault = int(row["fault"])
            state |= {
                "fault": Fault(fault).name.lower() if fault in set(Fault) else fault,
                "inside": bool(row["flags"] & RowFlag.INSIDE),
                "values": {
                    name: float(row[name]) for name in ("position", "velocity", "effort_sent", "penetration")
                },
            }
        return state

    def about(self) -> dict[str, Any]:
        """Return the facts about the loop's run (process, rate, experiment, recording), for JSON."""
        return {
            "pid": self.pid,
            "since": self.since,
            "rate": self.rate,
            **{
                name: self.info.get(name)
                for name in ("url", "recording", "experiment", "parameter_sets", "law", "gate")
            },
        }

    def close(self) -> None:
        """Release the loop's shared memory; rows that were read stay available in `history`."""
        self._ring.close()

    def _look_at_info(self) -> bool:
        word = self._ring.get(control_words.INFO)
        if word == self._info_word:
            return False
        self.info, self._info_word = self._ring.info_and_word()
        return True


def attach(loop: RunningLoop, history: History) -> Followed | None:
    """Open the shared memory of a running control loop; return a reader that adds its new samples to `history`.

    Return None if the loop has just ended, or if its shared memory has another version of the layout.
    """
    with suppress(OSError, RigError):
        return Followed(loop, history) if loop.version == LAYOUT_VERSION else None
    return None


def _rate_of(info: Mapping[str, Any]) -> float:
    try:
        rate = float(((info.get("experiment") or {}).get("controller") or {}).get("position_rate") or 1000.0)
    except (AttributeError, TypeError, ValueError):
        rate = math.nan
    if not 0.0 < rate < math.inf:
        raise RigError(
            "a running control loop reports no valid position rate (Hz)", remedy="stop it: rig stop"
        )
    return rate


def newest(pid: int | None = None) -> RunningLoop | None:
    """Return the control loop that started last, of all processes or of process `pid`; None if no loop runs."""
    found = [loop for loop in running() if pid in (None, loop.pid)]
    return found[-1] if found else None


def _reason(reason: int) -> str:
    return EndReason(reason).name.lower().replace("_", " ") if reason in set(EndReason) else str(reason)
