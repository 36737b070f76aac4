"""A tick of the simulated device in its parts, over flat memory: what a microcontroller does without its host.

The order is that of `device`: `drive`, then the plant moves, then `sample`, and `report` if a STATE is due; between two
ticks `obey` takes a COMMAND. Python runs these functions in the readable device (`device`), on memory views; a kernel
runs the same ones in the compiled device (`compiled_device`). What is rare is left to Python: they only leave the
faults that they find in `FOUND`.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag
from firmware_protocol.messages import Mode, Sync
from rig.realtime.codec import STATE
from rig.realtime.groups import Floats, Ints, group
from sim_backend.lockstep import (
    COUNT,
    CUTS,
    DUE,
    EDGE_AGE,
    INPUTS,
    MEASURED,
    SAMPLE_INDEX,
    SESSION,
    TIME,
    WORDS,
)
from sim_backend.safety import (
    AT,
    UNITS_PER_SECOND,
    UNITS_PER_US,
    check,
    feed,
    idle,
    limited,
    remember,
    rule,
    wanted,
    warm,
)

UNARMED_STATES_HZ = 100  # STATE frames a second while the device is not armed: enough to home by hand

# Words behind those of `lockstep`: what the tick found (faults as bits 1 << code) and drove, limits that acted since
# the last STATE, level of the sync outputs; the active command; what Python counts, and where the protocol is; the grid
# of time; settings.
FOUND, DRIVEN, ACTED, SYNC = range(WORDS, WORDS + 4)
COMMAND_SEQUENCE, COMMAND_INDEX, COMMAND_SYNC = range(WORDS + 4, WORDS + 7)
WORST_EXECUTION_TIME, MISSED_TICKS, SYNC_TIME, PROTOCOL_STATE = range(WORDS + 7, WORDS + 11)
RATE, GRID_INDEX, GRID_TIME = range(WORDS + 11, WORDS + 14)
NEEDS_HOLD, COMMAND_LIFETIME, SUPERVISE_LIFETIME, RAMP = range(WORDS + 14, WORDS + 18)
BOARD_WORDS = WORDS + 18

_U32 = 0xFFFFFFFF
_U16 = 0xFFFF
_NO_COMMAND_YET, _OLDEST_EDGE = m.NO_COMMAND_YET, m.OLDEST_EDGE
_RAMPING, _RELEASED = int(LimitFlag.RAMPING), int(LimitFlag.HOLD_TO_RUN_RELEASED)
_EMERGENCY, _HELD = int(Input.EMERGENCY_STOP), int(Input.HOLD_TO_RUN)
_PRESSED, _LINK_LOST = 1 << Fault.EMERGENCY_STOP, 1 << Fault.LINK_LOST
_BOOT, _ARMED, _RUNNING = int(State.BOOT), int(State.ARMED), int(State.RUNNING)
_SUPERVISE, _STOP = int(Mode.SUPERVISE), int(Mode.STOP)
_SYNC_OF_COMMANDS = int(Sync.TRIAL | Sync.INSIDE)
_SHOWN = tuple(  # `Sync` bits → `Input` bits
    int(Input.SYNC_TRIAL if bits & Sync.TRIAL else 0) | int(Input.SYNC_INSIDE if bits & Sync.INSIDE else 0)
    for bits in range(8)
)


@group
class Board(NamedTuple):
    """The memory of a device.

    Attributes
    ----------
    words
        Those of `lockstep`, and behind them those of this file.
    rules, heat, counts
        Of `sim_backend.safety.Safety`.
    ring
        Of `sim_backend.safety.FaultMemory`.
    state
        Fields of the STATE that is due, by `rig.realtime.codec.STATE`.
    """

    words: Ints
    rules: Ints
    heat: Floats
    counts: Ints
    ring: Ints
    state: Ints


@rule
def drive(board: Board) -> int:
    """Begin a tick: the current that flows in it (quanta)."""
    words, rules = board.words, board.rules
    words[FOUND] = words[CUTS] = words[SYNC] = words[DRIVEN] = 0
    if words[PROTOCOL_STATE] != _ARMED and words[PROTOCOL_STATE] != _RUNNING:
        return 0
    if words[INPUTS] & _EMERGENCY:
        words[FOUND] = _PRESSED
        return 0
    current = wanted(rules, words[DUE])
    if rules[AT.ramping]:
        rules[AT.flags] |= _RAMPING
        if rules[AT.lost]:
            words[FOUND] = _LINK_LOST
            return 0
    else:
        words[SYNC] = words[COMMAND_SYNC]
    if words[NEEDS_HOLD] and not words[INPUTS] & _HELD:
        rules[AT.flags] |= _RELEASED
        rules[AT.current] = 0  # regardless of the slew limit
        words[CUTS] = 1
        return 0
    words[DRIVEN] = limited(rules, board.heat, current)
    return int(words[DRIVEN])


@rule
def sample(board: Board) -> None:
    """End a tick: its sample is in the words; the monitors look at it."""
    words, rules = board.words, board.rules
    count, current, measured = words[COUNT], words[DRIVEN], words[MEASURED]
    words[CUTS] = 0
    words[SAMPLE_INDEX] += 1
    words[TIME] = words[DUE]
    words[DUE] = time_of(words, words[SAMPLE_INDEX] + 1)
    warm(board.heat, measured)
    faults = check(rules, board.heat, board.counts, count, current, measured)
    words[FOUND] = faults if words[SESSION] else 0
    flags = rules[AT.flags]
    rules[AT.flags] = 0
    words[ACTED] |= flags
    remember(rules, board.ring, words[SAMPLE_INDEX] & _U32, count, current, measured, flags)


@rule
def time_of(words: Ints, index: int) -> int:
    """Device time of a sample, from its number: a period that is no whole number of units does not drift."""
    return int(words[GRID_TIME] + (index - words[GRID_INDEX]) * UNITS_PER_SECOND // words[RATE])


@rule
def report(board: Board) -> bool:
    """Fill the fields of a STATE, if one is due."""
    words, state = board.words, board.state
    index, time = words[SAMPLE_INDEX], words[TIME]
    if not words[SESSION]:
        every = max(1, words[RATE] // UNARMED_STATES_HZ)
        if words[PROTOCOL_STATE] == _BOOT or index % every != 0:
            return False
    age = _NO_COMMAND_YET
    if words[COMMAND_INDEX] >= 0:
        age = min(index - words[COMMAND_INDEX], _U16)
    state[STATE.command_sequence], state[STATE.command_age] = words[COMMAND_SEQUENCE], age
    state[STATE.sample_index], state[STATE.device_time] = index & _U32, time & _U32
    state[STATE.count] = words[COUNT]
    state[STATE.edge_time] = (time - min(words[EDGE_AGE], _OLDEST_EDGE)) & _U32
    state[STATE.current_measured], state[STATE.current_commanded] = words[MEASURED], words[DRIVEN]
    state[STATE.limits], state[STATE.fault] = words[ACTED], board.rules[AT.fault]
    state[STATE.execution_time] = min(words[WORST_EXECUTION_TIME], _U16)
    state[STATE.missed_ticks] = min(words[MISSED_TICKS], _U16)
    state[STATE.state], state[STATE.inputs] = words[PROTOCOL_STATE], words[INPUTS] | _SHOWN[words[SYNC]]
    state[STATE.phase] = 0  # no law of its own
    state[STATE.sync_time] = words[SYNC_TIME] & _U32
    words[ACTED] = 0  # since the last STATE
    return True


@rule
def obey(board: Board, sequence: int, mode: int, flags: int, current: int, lifetime_us: int) -> None:
    """Take a COMMAND."""
    words = board.words
    words[COMMAND_SEQUENCE], words[COMMAND_INDEX] = sequence, words[SAMPLE_INDEX]
    words[COMMAND_SYNC] = words[CUTS] = 0
    if mode == _STOP:
        idle(board.rules, words[TIME])
        board.rules[AT.current] = 0
        words[CUTS] = 1
        return
    lifetime = lifetime_us * UNITS_PER_US
    if mode == _SUPERVISE:
        feed(board.rules, words[TIME], 0, min(lifetime, words[SUPERVISE_LIFETIME]), words[RAMP])
    else:
        words[COMMAND_SYNC] = flags & _SYNC_OF_COMMANDS
        feed(board.rules, words[TIME], current, min(lifetime, words[COMMAND_LIFETIME]), words[RAMP])
