"""Compute the parts of a tick of the simulated device on flat memory, like a microcontroller's timer interrupt.

`device` calls `drive`, moves the plant, then calls `sample` and `report`. Between two ticks it calls `obey` for each
COMMAND. No function here raises or calls back: detected faults are stored in the word `OWN.found`.
"""

from collections import namedtuple
from typing import Any, NamedTuple

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input, LimitFlag
from firmware_protocol.messages import Mode, Sync
from rig.realtime.codec import STATE
from rig.realtime.groups import Floats, Ints
from sim_backend.board.lockstep import (
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
from sim_backend.board.safety import (
    AT,
    UNITS_PER_SECOND,
    UNITS_PER_US,
    check,
    compute_wanted,
    feed,
    idle,
    limit_current,
    remember,
    remove_zero,
    warm,
)

UNARMED_STATES_HZ = 100  # STATE frames a second while the device is not armed: enough to home by hand

_Own = namedtuple(
    "_Own",
    # found faults (bits 1 << code), motor current, limits that acted since the last STATE, sync outputs
    "found driven acted sync "
    # the active command
    "command_sequence command_index command_sync "
    # values that Python counts, and the state of the protocol
    "worst_execution_time missed_ticks sync_time protocol_state "
    # time grid and settings
    "rate grid_index grid_time needs_hold command_lifetime supervise_lifetime ramp",
)
BOARD_WORDS = WORDS + len(_Own._fields)
OWN: Any = _Own(*range(WORDS, BOARD_WORDS))  # indices of the device's own words, after those of `lockstep`

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


# Memory views: Python reads and writes their numbers twice as fast as those of an array.
class DeviceMemory(NamedTuple):
    """Memory of a simulated device: flat arrays that its tick functions read and write.

    Attributes
    ----------
    words
        Sample, times, switches and settings (integers), at the indices in `lockstep` and in the named tuple `OWN`.
    rules, heat, counts, currents
        Memory of limits and monitors: integers, thermal model, counts in the speed window, comparison of currents.
    ring
        Last ticks before a fault, a ring buffer of integers.
    state
        Fields of the next STATE, at the indices of `rig.realtime.codec.STATE`.
    """

    words: Ints
    rules: Ints
    heat: Floats
    counts: Ints
    currents: Ints
    ring: Ints
    state: Ints


def drive(board: DeviceMemory) -> int:
    """Begin a tick of the device; return the motor current during this tick (quanta)."""
    words, rules = board.words, board.rules
    words[OWN.found] = words[CUTS] = words[OWN.sync] = words[OWN.driven] = 0
    if words[OWN.protocol_state] != _ARMED and words[OWN.protocol_state] != _RUNNING:
        return 0
    if words[INPUTS] & _EMERGENCY:
        words[OWN.found] = _PRESSED
        return 0
    current = compute_wanted(rules, words[DUE])
    if rules[AT.ramping]:
        rules[AT.flags] |= _RAMPING
        if rules[AT.lost]:
            words[OWN.found] = _LINK_LOST
            return 0
    else:
        words[OWN.sync] = words[OWN.command_sync]
    if words[OWN.needs_hold] and not words[INPUTS] & _HELD:
        rules[AT.flags] |= _RELEASED
        rules[AT.current] = 0  # regardless of the slew limit
        words[CUTS] = 1
        return 0
    words[OWN.driven] = limit_current(rules, board.heat, current)
    return int(words[OWN.driven])


def sample(board: DeviceMemory) -> None:
    """End a tick of the device: run the safety monitors on its sample, which the caller has stored in `board.words`."""
    words, rules = board.words, board.rules
    count, current = words[COUNT], words[OWN.driven]
    armed = words[OWN.protocol_state] == _ARMED or words[OWN.protocol_state] == _RUNNING
    measured = words[MEASURED] = remove_zero(rules, words[MEASURED], not armed)
    words[CUTS] = 0
    words[SAMPLE_INDEX] += 1
    words[TIME] = words[DUE]
    words[DUE] = time_of(words, words[SAMPLE_INDEX] + 1)
    warm(board.heat, measured)
    faults = check(rules, board.heat, board.counts, board.currents, count, current, measured)
    # Without a session the motor is off: motion by hand, however fast, is no fault.
    words[OWN.found] = faults if words[SESSION] else 0
    flags = rules[AT.flags]
    rules[AT.flags] = 0
    words[OWN.acted] |= flags
    remember(rules, board.ring, words[SAMPLE_INDEX] & _U32, count, current, measured, flags)


def time_of(words: Ints, index: int) -> int:
    """Return the device time of sample number `index` (1/16 µs), without accumulated rounding."""
    return int(words[OWN.grid_time] + (index - words[OWN.grid_index]) * UNITS_PER_SECOND // words[OWN.rate])


def report(board: DeviceMemory) -> bool:
    """Fill in the fields of a STATE message in `board.state` and return True if a STATE is due, else return False."""
    words, state = board.words, board.state
    index, time = words[SAMPLE_INDEX], words[TIME]
    if not words[SESSION]:
        every = max(1, words[OWN.rate] // UNARMED_STATES_HZ)
        if words[OWN.protocol_state] == _BOOT or index % every != 0:
            return False
    age = _NO_COMMAND_YET
    if words[OWN.command_index] >= 0:
        age = min(index - words[OWN.command_index], _U16)
    state[STATE.command_sequence], state[STATE.command_age] = words[OWN.command_sequence], age
    state[STATE.sample_index], state[STATE.device_time] = index & _U32, time & _U32
    state[STATE.count] = words[COUNT]
    state[STATE.edge_time] = (time - min(words[EDGE_AGE], _OLDEST_EDGE)) & _U32
    state[STATE.current_measured], state[STATE.current_commanded] = words[MEASURED], words[OWN.driven]
    state[STATE.limits], state[STATE.fault] = words[OWN.acted], board.rules[AT.fault]
    state[STATE.execution_time] = min(words[OWN.worst_execution_time], _U16)
    state[STATE.missed_ticks] = min(words[OWN.missed_ticks], _U16)
    state[STATE.state], state[STATE.inputs] = (
        words[OWN.protocol_state],
        words[INPUTS] | _SHOWN[words[OWN.sync]],
    )
    state[STATE.phase] = 0  # this device runs no law
    state[STATE.sync_time] = words[OWN.sync_time] & _U32
    words[OWN.acted] = 0  # since the last STATE
    return True


def lifetime_of(words: Ints, mode: int, lifetime_us: int) -> int:
    """Return a COMMAND's lifetime (1/16 µs): `lifetime_us` (µs), but at most the device's parameter for its mode."""
    cap = words[OWN.supervise_lifetime] if mode == _SUPERVISE else words[OWN.command_lifetime]
    return int(min(lifetime_us * UNITS_PER_US, cap))


def is_too_old(board: DeviceMemory, mode: int, lifetime_us: int, to_come: int, answered: int) -> bool:
    """Return True if a COMMAND message came later than its lifetime after the STATE it answers; STOP is never too old.

    `to_come` is the sequence number of the next STATE, `answered` that of the STATE which the COMMAND answers, or of
    the first one if the host has received none.
    """
    words = board.words
    # Sequences have 16 bits and wrap after 65 s at 1 kHz, far beyond any lifetime.
    ticks = ((to_come - answered) & _U16) - 1
    return bool(
        # A STOP is obeyed however old: an unwanted stop is safe, a lost one is not.
        mode != _STOP
        and ticks * (UNITS_PER_SECOND // words[OWN.rate]) > lifetime_of(words, mode, lifetime_us)
    )


def obey(board: DeviceMemory, sequence: int, mode: int, flags: int, current: int, lifetime_us: int) -> None:
    """Activate a COMMAND message: STOP sets the current to zero at once, SUPERVISE only feeds the watchdog.

    `current` is the commanded current (quanta), `flags` the sync outputs (`Sync`), `lifetime_us` the lifetime (µs).
    """
    words = board.words
    words[OWN.command_sequence], words[OWN.command_index] = sequence, words[SAMPLE_INDEX]
    words[OWN.command_sync] = words[CUTS] = 0
    if mode == _STOP:
        idle(board.rules, words[TIME])
        board.rules[AT.current] = 0
        words[CUTS] = 1
        return
    if mode == _SUPERVISE:
        current = 0
    else:
        words[OWN.command_sync] = flags & _SYNC_OF_COMMANDS
    feed(board.rules, words[TIME], current, lifetime_of(words, mode, lifetime_us), words[OWN.ramp])
