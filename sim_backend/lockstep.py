"""Many ticks of a device whose software is C code, in one compiled call: plant and sensors here, the device by address.

The order of a tick is that of `sim_backend.device`: the current, the plant, the sample. A law that runs on the device
needs nothing of the host in between, so that ticks pass until the device has something to say.

It mirrors the wires between a board and its rig, and knows neither frames nor states of the protocol.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.realtime.kernel import kernel
from rig.realtime.native import native_call
from sim_backend.held import want
from sim_backend.plant import advance
from sim_backend.safety import UNITS_PER_SECOND
from sim_backend.sensors import CURRENT_QUANTA_LIMIT, current_quanta

# Words of struct lockstep in firmware/host/lockstep.h.
COUNT, EDGE_AGE, MEASURED, INPUTS, CUTS, DUE, SAMPLE_INDEX, SESSION = range(8)
WORDS = 8

# What changes from tick to tick beside the plant's state: row of the script, unused noise, rows of truth.
ROW, NOISE_LEFT, TRUTH_ROWS = range(3)
PLACES = 3

_PEAK = int(CURRENT_QUANTA_LIMIT)

_FLOATS, _INTS, _MATRIX = types.float64[::1], types.int64[::1], types.float64[:, ::1]
_INT, _FLOAT = types.int64, types.float64
_call = native_call(2)  # half a tick: (device, words), both by address


@dataclass(frozen=True, slots=True)
class Lockstep:
    """The device's part of the arguments of `run_ticks`: its functions, itself and its words by address, the words."""

    drive: int
    sample: int
    device: int
    address: int
    words: NDArray[np.int64]


@kernel(
    _INT(
        _INT, _INT, _INT, _INT, _INTS, _INT, _INT, _INT,
        _FLOATS, _MATRIX, _MATRIX, _FLOATS, _INT, _INT, _FLOAT, _INT, _INT,
        _FLOAT, _FLOAT, _FLOAT, _MATRIX, _INT, _FLOATS, _INTS, _INTS, _MATRIX,
    ),
    borrow=True,
)  # fmt: skip
def run_ticks(
    drive: int, sample: int, device: int, address: int, words: Any, until: int, most: int, enough: int,
    state: Any, phi: Any, gamma: Any, plant: Any, edge_age: int, effort: int, external: float, slip: int, leak: int,
    effort_quantum: float, ampere_per_effort: float, quantum_a: float,
    script: Any, again: int, noise: Any, places: Any, indices: Any, states: Any,
) -> int:  # fmt: skip
    """Run until the device has `enough` bytes to say, its time is up, or something is used up; the number of ticks.

    Parameters
    ----------
    drive, sample
        `lockstep_drive` and `lockstep_sample` of the firmware's library, by address.
    device, address, words
        The device; the block of words that it shares, by address and as an array.
    until, most, enough
        Device time after which no sample is taken (1/16 µs); ticks at most; bytes that end the call.
    state, phi, gamma, plant, edge_age, effort
        The plant, and the places of two of its states.
    external, slip, leak
        As `Hardware.external_effort`, `slip` and `leak`.
    effort_quantum, ampere_per_effort, quantum_a
        Scales of command (N·m or N), sensor (A for one of them) and its quanta (A).
    script, again
        What a hand wants in each tick, and the row that follows the last.
    noise
        Of the current sensor (A), used from its end; empty without any.
    places
        Where script, noise and truth are.
    indices, states
        Room for the truth of a session; empty to keep none.
    """
    ticks = 0
    noisy, kept = len(noise) > 0, len(indices) > 0
    while ticks < most and words[DUE] <= until:
        if noisy and places[NOISE_LEFT] == 0:
            break
        if kept and places[TRUTH_ROWS] == len(indices):
            break
        quanta = _call(drive, device, address)
        if words[CUTS] != 0:
            for i in range(edge_age + 1, len(state)):
                state[i] = 0.0
        places[ROW] = want(state, edge_age, script, places[ROW], again)
        words[COUNT] = advance(state, phi, gamma, plant, quanta * effort_quantum, external) + slip
        measured_a = state[effort] * ampere_per_effort
        if noisy:
            places[NOISE_LEFT] -= 1
            measured_a += noise[places[NOISE_LEFT]]
        measured = current_quanta(measured_a, quantum_a)
        words[MEASURED] = min(max(measured + leak, -_PEAK), _PEAK)
        words[EDGE_AGE] = int(np.rint(min(state[edge_age] * UNITS_PER_SECOND, float(words[DUE]))))
        waiting = _call(sample, device, address)
        ticks += 1
        if words[CUTS] != 0:
            for i in range(edge_age + 1, len(state)):
                state[i] = 0.0
        if kept and words[SESSION] != 0:
            row = places[TRUTH_ROWS]
            indices[row] = words[SAMPLE_INDEX]
            for i in range(len(state)):
                states[row, i] = state[i]
            places[TRUTH_ROWS] = row + 1
        if waiting >= enough:
            break
    return ticks
