"""Run many ticks of a compiled device in one compiled call: plant and sensors here, the device by address.

The order of a tick is that of `sim_backend.board.device`. It mirrors the wires between a board and its rig, and must
not depend on frames or states of the protocol.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.faults import Input
from rig.realtime.groups import Float, FloatRows, Floats, Int, Ints, group, type_of
from rig.realtime.kernel import kernel, rule
from rig.realtime.native import native_call
from sim_backend.board.safety import UNITS_PER_SECOND
from sim_backend.mechanics.coupled_hand import want
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import PLANT_TYPE, PlantArguments, advance
from sim_backend.mechanics.sensors import CURRENT_QUANTA_LIMIT, current_quanta

# Words of struct lockstep in firmware/host/lockstep.h.
COUNT, EDGE_AGE, MEASURED, INPUTS, CUTS, DUE, SAMPLE_INDEX, SESSION, TIME = range(9)
BYTES, BYTE_COUNT, RECEIVED_AT, RATE_CHANGED, SWITCHED_ON = range(9, 14)
INDEX_EDGES, INDEX_COUNT = range(14, 16)
TRUE_COUNT = 16  # the simulation's own: of the last sample, without what the encoder has lost
WORDS = 17

# What changes from tick to tick beside the plant's state: row of the script, unused noise, rows of truth.
ROW, NOISE_LEFT, TRUTH_ROWS = range(3)
PLACES = 3

_PEAK = int(CURRENT_QUANTA_LIMIT)
# Counters of the C code wrap at 2³²; ours are 64 bits wide.
_U32 = 0xFFFFFFFF
_SWITCH = int(Input.LIMIT_SWITCH)

_call = native_call(2)  # half a tick: (device, words), both by address


@group
class Lockstep(NamedTuple):
    """A device: its functions (of the firmware: lockstep.h, host.h), itself and its words by address, the words."""

    drive: Int
    sample: Int
    receive: Int
    take: Int
    device: Int
    address: Int
    words: Ints


@group
class Wires(NamedTuple):
    """What is between board and rig, and what disturbs there.

    Attributes
    ----------
    effort_quantum, ampere_per_effort, quantum_a
        Scales of command (N·m or N), sensor (A for one of them) and its quanta (A).
    external_effort, slip, leak
        Of `sim_backend.board.hardware.Hardware`.
    index_first, index_counts
        True count of an index, and counts to the next one; 0: no index.
    switch_count, switch_way
        True count from which on the limit switch is pressed, and in which direction of counting; 0: no limit switch.
    """

    effort_quantum: Float
    ampere_per_effort: Float
    quantum_a: Float
    external_effort: Float
    slip: Int
    leak: Int
    index_first: Int
    index_counts: Int
    switch_count: Int
    switch_way: Int


Words = NDArray[np.int64] | memoryview


@rule
def sense(words: Words, count: int, wires: Wires) -> None:
    """Let index and limit switch see that the true count is now this one.

    An index is as wide as a count, and is latched where it begins, from either side.
    """
    before, first, every = words[TRUE_COUNT], wires.index_first, wires.index_counts
    words[TRUE_COUNT] = count
    if every and count != before:
        # From above an index begins with its own count, from below after the last one.
        back = 1 if count < before else 0
        place, left = (count - back - first) // every, (before - back - first) // every
        if place != left:
            words[INDEX_EDGES] = (words[INDEX_EDGES] + abs(place - left)) & _U32
            words[INDEX_COUNT] = first + every * (place + back) + wires.slip
    # The switch is a level: it follows the position, while an index is latched.
    words[INPUTS] &= ~_SWITCH
    if wires.switch_way and wires.switch_way * (count - wires.switch_count) >= 0:
        words[INPUTS] |= _SWITCH


@group
class Supplies(NamedTuple):
    """What is used up from tick to tick.

    Attributes
    ----------
    noise
        Of the current sensor (A), used from its end; empty without any.
    places
        Where script, noise and truth are.
    indices, states
        Room for the truth of a session; empty to keep none.
    """

    noise: Floats
    places: Ints
    indices: Ints
    states: FloatRows


@kernel(types.void(PLANT_TYPE), inline=True)
def cut(plant: PlantArguments) -> None:
    """Pull the amplifier's enable low: commands that are on their way are gone too."""
    for i in range(plant.edge_age + 1, len(plant.state)):
        plant.state[i] = 0.0


@kernel(
    types.int64(
        *(type_of(Lockstep), PLANT_TYPE, type_of(OperatorScript), type_of(Wires), type_of(Supplies)),
        *(types.int64, types.int64, types.int64),
    )
)
def run_ticks(
    software: Lockstep,
    plant: PlantArguments,
    script: OperatorScript,
    wires: Wires,
    supplies: Supplies,
    until: int,
    most: int,
    enough: int,
) -> int:
    """Run until the device has `enough` bytes to say, its time is up, or something is used up; the number of ticks.

    `until` is the device time after which no sample is taken (1/16 µs), `most` the ticks at most.
    """
    words, state, edge_age = software.words, plant.state, plant.edge_age
    noise, places, indices = supplies.noise, supplies.places, supplies.indices
    ticks = 0
    noisy, kept = len(noise) > 0, len(indices) > 0
    # Supplies are checked before the tick: a tick that has begun must be able to end.
    while ticks < most and words[DUE] <= until:
        if noisy and places[NOISE_LEFT] == 0:
            break
        if kept and places[TRUTH_ROWS] == len(indices):
            break
        # The device decides with what it received up to now; the plant moves under that decision.
        quanta = _call(software.drive, software.device, software.address)
        if words[CUTS] != 0:
            cut(plant)
        places[ROW] = want(state, edge_age, script.rows, places[ROW], script.again)
        effort = quanta * wires.effort_quantum
        count = advance(plant, effort, wires.external_effort)
        words[COUNT] = count + wires.slip
        sense(words, count, wires)
        measured_a = state[plant.effort] * wires.ampere_per_effort
        if noisy:
            places[NOISE_LEFT] -= 1
            measured_a += noise[places[NOISE_LEFT]]
        measured = current_quanta(measured_a, wires.quantum_a)
        words[MEASURED] = min(max(measured + wires.leak, -_PEAK), _PEAK)
        words[EDGE_AGE] = int(np.rint(min(state[edge_age] * UNITS_PER_SECOND, float(words[DUE]))))
        waiting = _call(software.sample, software.device, software.address)
        ticks += 1
        if words[CUTS] != 0:
            cut(plant)
        if kept and words[SESSION] != 0:
            row = places[TRUTH_ROWS]
            indices[row] = words[SAMPLE_INDEX]
            for i in range(supplies.states.shape[1]):
                supplies.states[row, i] = state[i]
            places[TRUTH_ROWS] = row + 1
        if waiting >= enough:
            break
    return ticks
