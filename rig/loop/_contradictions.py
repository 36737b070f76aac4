"""Check a device's reports against its earlier reports and the commands sent: a contradiction ends the run.

The device's clock must advance with its sample index, an encoder edge must not be later than its sample, a missed tick
must have no sample, and the active command must have been sent shortly before. If the sample index jumps back further
than frames can be reordered, the device has restarted.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from numba import types

from firmware_protocol.messages import NO_COMMAND_YET, OLDEST_EDGE
from rig.loop.layout import INTS, PROGRESS_TYPE, SETTINGS_TYPE
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

WRAP = 1 << 32


class Contradiction(IntEnum):
    """Kind of impossible data from a device; `text` describes it."""

    NONE = 0, ""
    RESTARTED = 1, "its sample index started again"
    CLOCK = 2, "its clock and its sample index disagree"
    EDGE = 3, "the time of an encoder edge is after the sample that contains it"
    MISSED = 4, "its count of missed ticks is larger than the number of missing samples"
    COMMAND = 5, "its active command was never sent, or was sent long before"

    text: str

    def __new__(cls, code: int, text: str = "") -> Contradiction:
        """Create the member of the enumeration with the value `code` and a text."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member


_NONE, _RESTARTED, _CLOCK, _EDGE, _MISSED, _COMMAND = (int(member) for member in Contradiction)
# A timer that cannot keep the exact rate may leave the index by this share; a late tick comes before the next one.
_DRIFT_PER_CENT, _PERIODS = 1, 2
_NO_COMMAND_YET, _OLDEST_EDGE = int(NO_COMMAND_YET), int(OLDEST_EDGE)


@kernel(types.int64(types.int64, types.int64), inline=True)
def ahead(new: int, old: int) -> int:
    """Return new − old modulo 2³², from −2³¹ to 2³¹ − 1: by how much a 32-bit counter has advanced."""
    return (new - old + WRAP // 2) % WRAP - WRAP // 2


@kernel(types.int64(SETTINGS_TYPE, types.int64), inline=True)
def time_of(settings: Any, samples: int) -> int:
    """Return the nominal duration of `samples` control ticks, in units of the device's clock (rounded down)."""
    return int(samples * settings[0]["period_ns"] * 1000 // settings[0]["device_tick_ps"])


@kernel(types.int64(SETTINGS_TYPE, types.int64, types.int64, types.int64))
def clock_error(settings: Any, error: int, samples: int, time: int) -> int:
    """Return how far the device's clock is ahead of its sample index (units of the device's clock).

    `error` is the result at an earlier sample; since then, `samples` samples and the device time `time` have passed.
    """
    # A share of the elapsed time is forgotten: a timer that cannot have the exact rate drifts and is no contradiction.
    expected = time_of(settings, samples)
    error += ahead(time, expected)
    forgotten = 1 + abs(expected) * _DRIFT_PER_CENT // 100
    return int(max(error - forgotten, min(error + forgotten, 0)))


@kernel(types.int64(SETTINGS_TYPE, types.int64, types.int64))
def find_clock_contradiction(settings: Any, samples: int, error: int) -> int:
    """Return a `Contradiction` if the device has restarted, or its clock disagrees with its sample index; else 0.

    `samples` counts from the last STATE to this one, negative if the index jumped back; `error` is the `clock_error`.
    """
    if samples < -settings[0]["lost_after_ns"] // settings[0]["period_ns"]:
        return _RESTARTED
    return _CLOCK if abs(error) > time_of(settings, _PERIODS) else _NONE


@kernel(types.int64(SETTINGS_TYPE, PROGRESS_TYPE, INTS))
def _find_own_contradiction(settings: Any, progress: Any, state: Any) -> int:
    """Return a `Contradiction` if a STATE's last edge is too old, or its active command not sent recently; else 0."""
    s, age = settings[0], state[STATE.command_age]
    if (state[STATE.device_time] - state[STATE.edge_time]) % WRAP > _OLDEST_EDGE:
        return _EDGE
    # Each command answers a sample of its own: since the active one came there were `age`, and some on the way.
    latest = age + 2 * s["lost_after_ns"] // s["period_ns"]
    since = (progress[0]["sequence"] - 1 - state[STATE.command_sequence]) % 65536
    return _COMMAND if age != _NO_COMMAND_YET and since > latest else _NONE


@kernel(types.UniTuple(types.int64, 2)(SETTINGS_TYPE, PROGRESS_TYPE, INTS, INTS, types.boolean))
def take_news(settings: Any, progress: Any, state: Any, before: Any, first: bool) -> tuple[int, int]:
    """Return by how many samples a STATE message is newer than the last one, `before`; and 1 if accepted, else 0.

    A STATE with a contradiction is rejected, and the contradiction is stored in `progress`. A STATE that reports a
    fault is always accepted, because it ends the run anyway.
    """
    p = progress[0]
    newer, error, found = 1, 0, _NONE
    if not first:
        newer = ahead(state[STATE.sample_index], before[STATE.sample_index])
        time = state[STATE.device_time] - before[STATE.device_time]
        error = clock_error(settings, p["clock_error"], newer, time)
        found = find_clock_contradiction(settings, newer, error)
    if found == _NONE and newer > 0:
        found = _find_own_contradiction(settings, progress, state)
        missed = state[STATE.missed_ticks] - before[STATE.missed_ticks]
        if found == _NONE and not first and not 0 <= missed < newer:
            found = _MISSED
    if found != _NONE and state[STATE.fault] == 0:
        p["contradiction"] = found
        return newer, 0
    if newer > 0:
        p["clock_error"] = error
    return newer, 1
