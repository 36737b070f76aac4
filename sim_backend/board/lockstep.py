"""Run many ticks of a compiled device in one compiled call, with plant and sensors.

The functions of the device are called by address. The order within a tick is that of `sim_backend.board.device`. The
file simulates the wires between a board and its rig; it must not depend on frames or states of the protocol.
"""

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
TRUE_COUNT = 16  # only for the simulation: count of the last sample without lost or extra edges
WORDS = 17

# Indices into `Supplies.places`.
ROW, NOISE_LEFT, TRUTH_ROWS = range(3)
PLACES = 3

_PEAK = int(CURRENT_QUANTA_LIMIT)
# Counters of the C code wrap at 2³²; these words have 64 bits.
_U32 = 0xFFFFFFFF
_SWITCH = int(Input.LIMIT_SWITCH)

_call = native_call(2)  # a device function with two addresses as arguments: device and words


@group
class Lockstep(NamedTuple):
    """A compiled device: addresses of its functions and of its memory.

    `drive`, `sample`, `receive` and `take` are the addresses of its functions (lockstep.h and host.h of the firmware),
    `device` that of the device. It exchanges inputs and outputs with the rig in the array `words`, at `address`.
    """

    drive: Int
    sample: Int
    receive: Int
    take: Int
    device: Int
    address: Int
    words: Ints


@group
class Wires(NamedTuple):
    """Scales and disturbances of the signals between board and rig.

    Attributes
    ----------
    effort_quantum
        Effort of one quantum of commanded current (N·m or N).
    ampere_per_effort, quantum_a
        Current for one unit of effort (A per N·m or N), and size of one quantum of measured current (A).
    external_effort
        External effort on the link (N·m or N).
    slip, leak
        Encoder count minus true count, and offset of the measured current (quanta).
    index_first, index_counts
        True count of an index of the encoder, and counts between two indices; 0: no index.
    switch_count, switch_way
        The limit switch is pressed from this true count on, in this direction of counting (±1); 0: no limit switch.
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
    """Update encoder index and limit switch in `words` for the true count `count`.

    The index pulse of an encoder is one count wide. The device stores the count at the first edge of a pulse, in either
    direction of motion.
    """
    before, first, every = words[TRUE_COUNT], wires.index_first, wires.index_counts
    words[TRUE_COUNT] = count
    if every and count != before:
        # The pulse is the cell of the index count: in both directions it begins when the count reaches this value.
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
    """Buffers that ticks use up: noise values, and space for the recorded true states.

    Attributes
    ----------
    noise
        Noise of the current sensor (A), used from its end; empty for a sensor without noise.
    places
        Next row of the hand's scripted motion, number of unused noise values, number of recorded true states.
    indices, states
        Buffers for sample indices and true states of a session; empty to record none.
    """

    noise: Floats
    places: Ints
    indices: Ints
    states: FloatRows


@kernel(types.void(PLANT_TYPE), inline=True)
def cut(plant: PlantArguments) -> None:
    """Disable the amplifier: commands that do not act yet because of the plant's delay are lost too."""
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
    """Run ticks until the device has `enough` bytes to send or a buffer is used up; return the number of ticks.

    No sample is taken that is due after the device time `until` (1/16 µs), and at most `most` ticks are run.
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
        # The device computes the current from what it has received so far; the plant moves under this current.
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
