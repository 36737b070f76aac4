"""Detect a delayed link: it delivers a frame in every tick, but all frames arrive too late.

The command age in a STATE message counts from receipt, and so does a command's lifetime. The loop computes the transit
time of a command from the sample that the command answers. A single late command is not a fault of the link; the run
ends only if all commands are late for a whole command lifetime. The loop on the host calls it. It must use only the
device's ticks, not the clock of the host.
"""

from typing import Any

from numba import types

from firmware_protocol.faults import LimitFlag
from firmware_protocol.messages import NO_COMMAND_YET
from rig.loop._contradictions import ahead
from rig.loop._currents import answered_by
from rig.loop.layout import BUFFERS_TYPE, SETTINGS_TYPE, Buffers
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

_NONE_YET, _TOO_OLD = int(NO_COMMAND_YET), int(LimitFlag.COMMAND_TOO_OLD)


@kernel(types.int64(BUFFERS_TYPE))
def ticks_under_way(buffers: Buffers) -> int:
    """Return the active COMMAND's transit time: ticks from the sample that it answers to receipt (old: upper bound)."""
    state, active = buffers.state, buffers.state[STATE.command_sequence]
    answered = answered_by(buffers.sent, active)
    if answered >= 0:
        return ahead(state[STATE.sample_index] - state[STATE.command_age], answered)
    return int((buffers.progress[0]["sequence"] - 1 - active) % 65536 - state[STATE.command_age])


@kernel(types.boolean(SETTINGS_TYPE, BUFFERS_TYPE))
def is_delayed(settings: Any, buffers: Buffers) -> bool:
    """Return True if all commands of the last command lifetime were in transit for longer than this lifetime.

    Some devices check the age of a command and reject an old one with a limit flag; on other devices it becomes active.
    """
    s, p, state = settings[0], buffers.progress[0], buffers.state
    too_old = state[STATE.limits] & _TOO_OLD != 0
    if state[STATE.command_age] != _NONE_YET and state[STATE.command_sequence] != p["active"]:
        p["active"] = state[STATE.command_sequence]
        too_old = ticks_under_way(buffers) * s["period_ns"] > s["lifetime_us"] * 1000
        if not too_old:
            p["too_old_from"] = -1
    if not too_old:
        return False
    if p["too_old_from"] < 0:
        p["too_old_from"] = p["sample_index"]
    return bool((p["sample_index"] - p["too_old_from"]) * s["period_ns"] >= s["lifetime_us"] * 1000)
