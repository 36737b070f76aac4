"""A whole trial in one compiled call: plant, sensors and the law, without bytes, frames or clocks.

The same `rig.step.step`, the same `advance`, the same quantisers as the simulated device behind its link; what is
missing is everything that can go wrong in between. Both ways therefore give the same trajectory, to the last bit, and a
map of thousands of trials may be computed this way.

Device time appears only as the age of the last encoder edge, which the wire carries in units of 1/16 µs; it is rounded
here as it is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.kernel import kernel
from firmware_protocol.messages import OLDEST_EDGE, TIME_UNIT_NS
from rig.plugs import ESTIMATOR, LAW
from rig.step import CONTROL_TYPE, DONE, MEMORY_TYPE, Controller, step
from sim_backend.plant import DiscretePlant, Vector, advance
from sim_backend.safety import UNITS_PER_SECOND

UNIT_PS = round(1000 * TIME_UNIT_NS)

_FLOATS, _INTS = types.float64[::1], types.int64[::1]
_STATES, _MATRIX = types.float64[:, ::1], types.float64[:, ::1]


@dataclass(frozen=True, slots=True)
class Trace:
    """What happened in each tick: plant state at the sample, count, phase, current commanded in answer, row flags."""

    states: NDArray[np.float64]
    counts: NDArray[np.int64]
    phases: NDArray[np.int64]
    currents: NDArray[np.int64]
    flags: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.counts)


@kernel(
    types.int64(
        ESTIMATOR, LAW, CONTROL_TYPE, MEMORY_TYPE, _FLOATS, _INTS, _FLOATS, _FLOATS, _FLOATS,
        _FLOATS, _MATRIX, _MATRIX, _FLOATS, types.int64, types.int64, types.int64,
        _STATES, _INTS, _INTS, _INTS, _INTS,
    )
)  # fmt: skip
def run_ticks(
    estimator: Any, law: Any, control: Any, memory: Any, estimator_f: Any, estimator_i: Any,
    estimator_parameters: Any, law_state: Any, law_parameters: Any,
    state: Any, phi: Any, gamma: Any, plant: Any, edge_age: int, start_units: int, tick_units: int,
    states: Any, counts: Any, phases: Any, currents: Any, flags: Any,
) -> int:  # fmt: skip
    """Run until the law is done or the arrays are full; returns the number of ticks.

    `edge_age` is the index of that state; `start_units` and `tick_units` are device time of the first sample and
    length of a tick (1/16 µs).
    """
    c, m = control[0], memory[0]
    count = advance(state, phi, gamma, plant, 0.0, 0.0)
    for k in range(len(counts)):
        units = min(
            state[edge_age] * UNITS_PER_SECOND, float(start_units + k * tick_units), float(OLDEST_EDGE)
        )
        edge_age_ns = int(np.rint(units)) * UNIT_PS // 1000
        current = step(
            estimator, law, count, edge_age_ns * 1e-9, 1, control, memory,
            estimator_f, estimator_i, estimator_parameters, law_state, law_parameters,
        )  # fmt: skip
        ends = m["phase"] == DONE
        states[k] = state
        counts[k] = count
        phases[k] = m["phase"]
        currents[k] = 0 if ends else current
        flags[k] = m["flags"]
        if ends:
            return k + 1
        count = advance(state, phi, gamma, plant, current * c["effort_quantum"], 0.0)
    return len(counts)


def run_trial(
    controller: Controller,
    plant: DiscretePlant,
    initial_position: float,
    *,
    most_ticks: int,
    start_units: int = OLDEST_EDGE,
) -> Trace:
    """Run one trial from rest.

    Parameters
    ----------
    controller
        Fresh controller; its memory is used up.
    plant
        Discretised at the controller's tick.
    initial_position
        Of the handle at rest, one tick before the first sample (rad or m).
    most_ticks
        Where to stop when the law never ends.
    start_units
        Device time of the first sample (1/16 µs): how old an edge that never happened may look.
    """
    state: Vector = plant.at_rest(initial_position)
    states = np.zeros((most_ticks, len(state)))
    counts, phases, currents, flags = (np.zeros(most_ticks, np.int64) for _ in range(4))
    arguments: tuple[Any, ...] = (
        controller.estimator.estimator.update,
        controller.law.law.function,
        *controller.arguments(),
        state,
        *plant.arrays,
        plant.edge_age,
        start_units,
        round(plant.tick_s * UNITS_PER_SECOND),
        states,
        counts,
        phases,
        currents,
        flags,
    )
    ticks = run_ticks(*arguments)
    return Trace(states[:ticks], counts[:ticks], phases[:ticks], currents[:ticks], flags[:ticks])
