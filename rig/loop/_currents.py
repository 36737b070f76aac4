"""Check in every tick that commanded, active and measured current agree.

A STATE message contains the active current and the number of the COMMAND that set it; the two must agree unless a limit
acted. `rig.control.current` compares the measured current with the active one. The results are flags of the recorded
row (`rig.core.sample.RowFlag`). With the law on the device, `rig.loop._device_host_agreement` replaces the first check.
Both loops call it. It must not end a run: it only sets flags.
"""

from typing import Any

from numba import types

from firmware_protocol.connection import State
from firmware_protocol.faults import LimitFlag
from firmware_protocol.messages import NO_COMMAND_YET
from rig.control.current import AGREES, CURRENT, DISAGREES, compare, resume
from rig.control.step import MEMORY_TYPE
from rig.core.sample import RowFlag
from rig.loop.layout import BUFFERS_TYPE, COMMANDS_KEPT, INTS, Buffers
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

_FOLLOWS, _DIFFERS, _OTHER = (
    int(flag) for flag in (RowFlag.CURRENT_FOLLOWS, RowFlag.CURRENT_DIFFERS, RowFlag.OTHER_CURRENT)
)
_ACTING = int(~(LimitFlag.SPEED | LimitFlag.POSITION))  # nearing a limit changes no current
_NONE_YET = NO_COMMAND_YET
_RUNNING = int(State.RUNNING)
OLDER = 8  # earlier COMMANDs that a late host may have sent in the same tick


@kernel(types.void(INTS, types.int64, types.int64, types.int64), inline=True)
def keep_command(sent: Any, sequence: int, current: int, answers: int) -> None:
    """Store a COMMAND message's current (quanta) and the index (`answers`) of the sample to which it replies."""
    place = 3 * (sequence % COMMANDS_KEPT)
    sent[place], sent[place + 1], sent[place + 2] = sequence, current, answers


@kernel(types.int64(INTS, types.int64), inline=True)
def answered_by(sent: Any, sequence: int) -> int:
    """Return the index of the sample that the COMMAND number `sequence` answers; -1 if that is no longer stored."""
    place = 3 * (sequence % COMMANDS_KEPT)
    return int(sent[place + 2]) if sent[place] == sequence else -1


@kernel(types.boolean(INTS, types.int64, types.int64), inline=True)
def _was_sent(sent: Any, sequence: int, current: int) -> bool:
    """Return True if the COMMAND number `sequence` had this current (quanta), or is no longer stored."""
    place = 3 * (sequence % 65536 % COMMANDS_KEPT)
    return bool(sent[place] != sequence % 65536 or sent[place + 1] == current)


@kernel(types.void(BUFFERS_TYPE, MEMORY_TYPE))
def compare_command(buffers: Buffers, memory: Any) -> None:
    """Mark the recorded row (OTHER_CURRENT) if the active current was not commanded although no limit acted."""
    state, sent = buffers.state, buffers.sent
    if state[STATE.state] != _RUNNING or state[STATE.command_age] == _NONE_YET or state[STATE.fault] != 0:
        return
    if state[STATE.limits] & _ACTING != 0:
        return
    active, current = state[STATE.command_sequence], state[STATE.current_commanded]
    # If this COMMAND arrived in the same tick, an earlier one was active in it: a late host sends several in one tick.
    older = OLDER if state[STATE.command_age] <= 1 else 0
    for back in range(older + 1):
        if _was_sent(sent, active - back, current):
            return
    memory[0]["flags"] |= _OTHER


@kernel(types.void(BUFFERS_TYPE, MEMORY_TYPE, types.int64))
def compare_measured(buffers: Buffers, memory: Any, elapsed: int) -> None:
    """Compare measured and active current, and mark the row (CURRENT_FOLLOWS, CURRENT_DIFFERS) after each comparison.

    A comparison takes several ticks. `elapsed` is the number of ticks since the last sample; above 1, it starts again.
    """
    words, state = buffers.currents, buffers.state
    # A rig without a current sensor, or without an expected current: nothing was configured.
    if words[CURRENT.ticks] == 0:
        return
    if elapsed != 1:
        resume(words, state[STATE.current_measured])
        return
    found = compare(words, state[STATE.count], state[STATE.current_commanded], state[STATE.current_measured])
    if found == AGREES:
        memory[0]["flags"] |= _FOLLOWS
    elif found == DISAGREES:
        memory[0]["flags"] |= _DIFFERS
