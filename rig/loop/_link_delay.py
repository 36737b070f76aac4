"""Detect a delayed link by a command's age at receipt: it delivers one frame each tick, and all of them too late.

The age in STATE counts from receipt, and so does a command's lifetime. How long a command was in transit follows from
the sample that it answers. A single late command is not yet a fault of the link; only late ones for a whole command
lifetime are.
"""

from __future__ import annotations

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
    """Return the ticks from the sample that the active command answers to its receipt; of an old one, a lower bound."""
    state, active = buffers.state, buffers.state[STATE.command_sequence]
    answered = answered_by(buffers.sent, active)
    if answered >= 0:
        return ahead(state[STATE.sample_index] - state[STATE.command_age], answered)
    return int((buffers.progress[0]["sequence"] - 1 - active) % 65536 - state[STATE.command_age])


@kernel(types.boolean(SETTINGS_TYPE, BUFFERS_TYPE))
def is_delayed(settings: Any, buffers: Buffers) -> bool:
    """Return True if this sample ends a command's lifetime in which every command was older than that.

    A device that looks at the age of a command leaves an old one out and says so; of another one it becomes active.
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
