"""Convert a loop's rows to samples and markers on the host's clock, while the loop runs.

Markers are mappings with `mark`, the kind of event, and with `device_time` (ns) and `tick`:

=======  ==================================================================================================
begin    a loop runs: rig, motion; unless blinded the position rate, the rate of the samples, and its wall
clock    the clocks were compared: `bound_s`, the error bound of time stamps; null: not compared, stamps are receipts
phase    the phase changed (`rig.core.sample.Phase`): wait, homing, settle, trial, release, done
contact  the handle enters the wall in the trial; `contact` is the number of this contact, from 1
sync     a rising edge of the device's sync input
wall     another parameter set is active: its number; unless blinded its wall, if the loop still stores it
end      the loop has ended: the reason, the rows read, and those overwritten before they were read (`lost`)
=======  ==================================================================================================

Blinded markers contain no value of a wall, a condition or a scheme, from any source (`without_secrets`). Rates are left
out, too: if conditions differ in their rates, a rate reveals the condition.
"""

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.sample import ROW, Phase, RowFlag
from rig.extras.lsl.clock import LiveClock
from rig.loop.layout import EndReason
from rig.realtime import control_words
from rig.realtime.ring import Ring
from rig.realtime.row_reader import RowReader

HOLD_S = 0.5  # how long rows wait for the first clock exchange
SECRETS = frozenset(
    (
        "stiffness",
        "damping",
        "wall",
        "condition",
        "scheme",
        "estimator",
        "encoder",
        "catch",
        "track",
        "level",
        "set",
        "K",
        "B",
        "position_rate",
        "velocity_rate",
        "rate",
    )
)
_INSIDE = int(RowFlag.INSIDE)


@dataclass(frozen=True, slots=True)
class Marker:
    """An event of a loop or session: time (ns, host clock) and a dictionary; its key "mark" is the kind of event."""

    time_ns: int
    content: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Chunk:
    """Recorded rows since the last chunk that become samples, the host time of each (ns), and the new markers."""

    rows: NDArray[np.void]
    times_ns: NDArray[np.int64]
    markers: list[Marker] = field(default_factory=list)


def without_secrets(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a marker's content without the keys in `SECRETS`, at any depth; a blinded person must not know them."""
    return {
        key: without_secrets(value) if isinstance(value, Mapping) else value
        for key, value in content.items()
        if key not in SECRETS
    }


def decimation(position_rate: float, rate: float | None) -> int:
    """Return the smallest n with which every n-th row gives at most `rate` samples a second; 1 if `rate` is None."""
    return 1 if rate is None else max(1, math.ceil(position_rate / rate))


class Follower:
    """Reader of one control loop, from the oldest row in its ring buffer to the loop's end.

    Parameters
    ----------
    ring
        Ring buffer of the loop in shared memory; it is only read.
    rate
        Largest number of samples a second; None: every row. The actual rate is the position rate over a whole number.
    blind
        Remove everything about the wall from the markers.

    Attributes
    ----------
    ring, info
        Ring buffer of the loop, and the facts about the run that it contained at the beginning.
    position_rate, every, rate
        Rows a second; one row in `every` becomes a sample; samples a second (Hz).
    ended
        True if the loop has ended and its last row was read.
    """

    def __init__(self, ring: Ring, *, rate: float | None = None, blind: bool = False) -> None:
        self.ring = ring
        self.info = ring.info
        experiment = self.info.get("experiment") or {}
        self.position_rate = float((experiment.get("controller") or {}).get("position_rate") or 0)
        self.every = decimation(self.position_rate, rate)
        self.rate = self.position_rate / self.every
        self.ended = False
        self._blind = blind
        self._reader = RowReader(ring)
        self._clock = LiveClock()
        self._sent_clock = self._begun = False
        self._since = time.monotonic()
        self._before: NDArray[np.void] = np.zeros(0, ROW)
        self._last_ns = 0
        self._contacts = 0

    @property
    def lost(self) -> int:
        """Number of rows that were overwritten before they were read."""
        return self._reader.lost

    @property
    def rows(self) -> int:
        """Number of rows read so far."""
        return self._reader.rows

    def poll(self) -> Chunk:
        """Return rows and markers since the last call; after the last rows of the loop `ended` is True."""
        # Read this flag before the rows: if it is set, no row can follow after the ones read next.
        done = self.ring.get(control_words.LOOP_DONE) != 0
        self._clock.look(self.ring)
        if not self._clock.fitted and not done and time.monotonic() - self._since < HOLD_S:
            return Chunk(np.zeros(0, ROW), np.zeros(0, np.int64))
        rows = self._reader.new()
        times = self._times(rows) if len(rows) else np.zeros(0, np.int64)
        markers = list(self._markers(rows, times)) if len(rows) else []
        self._before = rows[-1:].copy() if len(rows) else self._before
        if done:
            self.ended = True
            last = int(times[-1]) if len(times) else time.monotonic_ns()
            markers.append(self._end(last))
        if self._blind:
            markers = [Marker(marker.time_ns, without_secrets(marker.content)) for marker in markers]
        wanted = rows["sample_index"] % self.every == 0
        return Chunk(rows[wanted], times[wanted], sorted(markers, key=lambda marker: marker.time_ns))

    def _times(self, rows: NDArray[np.void]) -> NDArray[np.int64]:
        # A better fit of the clocks can give an earlier time than one that was already sent.
        times: NDArray[np.int64] = np.maximum(self._clock.host_of(rows, rows["device_time"]), self._last_ns)
        self._last_ns = int(times[-1])
        return times

    def _markers(self, rows: NDArray[np.void], times: NDArray[np.int64]) -> Iterator[Marker]:
        first = {"tick": int(rows["tick"][0]), "device_time": int(rows["device_time"][0])}
        if not self._begun:
            self._begun = True
            yield Marker(int(times[0]), {"mark": "begin", **first, **self._about()})
        if not self._sent_clock:
            self._sent_clock = True
            bound = self._clock.bound_ns
            bound_s = None if bound is None else bound * 1e-9
            yield Marker(int(times[0]), {"mark": "clock", **first, "bound_s": bound_s})
        both = np.concatenate((self._before, rows))
        new = len(both) - len(rows)  # place of the first new row: 1, or 0 in the first chunk
        for name, places in _changes(both, new).items():
            for place in places:
                row = both[place]
                yield Marker(int(times[place - new]), self._content(name, row))
        reported = both["sync_time"]
        edges = 1 + np.flatnonzero((reported[1:] != reported[:-1]) & (reported[1:] != 0))
        for place in edges:
            when = self._clock.host_of(rows, reported[place : place + 1])
            row = both[place]
            content = {"mark": "sync", "tick": int(row["tick"]), "device_time": int(reported[place])}
            yield Marker(int(when[0]), content)

    def _content(self, name: str, row: Any) -> dict[str, Any]:
        content = {"mark": name, "tick": int(row["tick"]), "device_time": int(row["device_time"])}
        if name == "phase":
            phase = int(row["phase"])
            content["phase"] = Phase(phase).name.lower() if phase in set(Phase) else phase
        elif name == "contact":
            self._contacts += 1
            content["contact"] = self._contacts
        elif name == "wall":
            content["set"] = int(row["parameter_set"])
            content["wall"] = _wall(self.ring.info)
        return content

    def _about(self) -> dict[str, Any]:
        experiment = self.info.get("experiment") or {}
        rig = experiment.get("rig") or {}
        return {
            "rig": rig.get("name"),
            "motion": rig.get("motion"),
            "position_rate": self.position_rate,
            "rate": self.rate,
            "wall": _wall(self.info),
        }

    def _end(self, time_ns: int) -> Marker:
        reason = self.ring.get(control_words.END_REASON)
        named = EndReason(reason).name.lower() if reason in set(EndReason) else str(reason)
        place = {name: int(self._before[name][0]) for name in ("tick", "device_time")} if self.rows else {}
        return Marker(
            time_ns, {"mark": "end", **place, "reason": named, "rows": self.rows, "lost": self.lost}
        )


def _wall(info: Mapping[str, Any]) -> dict[str, Any]:
    wall = (info.get("experiment") or {}).get("wall") or {}
    return {name: wall.get(name) for name in ("stiffness", "damping")}


def _changes(both: NDArray[np.void], new: int) -> dict[str, NDArray[np.int64]]:
    """Return the indices (from `new` on) of rows at which phase, contact or wall changed, by name of the marker."""
    phase, numbers = both["phase"], both["parameter_set"]
    touching = (phase == Phase.TRIAL) & ((both["flags"] & _INSIDE) != 0)
    beginning = np.arange(len(both)) == 0
    changed = {
        "phase": beginning | (phase != np.roll(phase, 1)),
        "contact": touching & (beginning | ~np.roll(touching, 1)),
        "wall": ~beginning & (numbers != np.roll(numbers, 1)),
    }
    return {name: new + np.flatnonzero(found[new:]) for name, found in changed.items()}
