"""A whole trial in one compiled call: plant, sensors and the law, without bytes, frames or clocks.

The same `rig.control.step.step`, the same `advance`, the same quantisers as the simulated device behind its link; what
is missing is everything that can go wrong in between. Both ways therefore give the same trajectory, to the last bit,
and a map of thousands of trials may be computed this way.

Device time appears only as the age of the last encoder edge, which the wire carries in units of 1/16 µs; it is rounded
here as it is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.messages import OLDEST_EDGE, TIME_UNIT_NS
from rig.control.step import CONTROLLER_TYPE, DONE, Controller, ControllerArguments, step
from rig.realtime.kernel import kernel
from sim_backend.held import want
from sim_backend.inner import Vector
from sim_backend.operator import Script
from sim_backend.plant import DiscretePlant, advance
from sim_backend.safety import UNITS_PER_SECOND

NS_NUMERATOR, NS_DENOMINATOR = TIME_UNIT_NS.as_integer_ratio()

_FLOATS, _INTS = types.float64[::1], types.int64[::1]
_MATRIX = types.float64[:, ::1]


@dataclass(frozen=True, slots=True)
class Trace:
    """What happened in each tick: plant state at the sample, count, phase, current commanded in answer, row flags."""

    states: NDArray[np.float64]
    counts: NDArray[np.int64]
    phases: NDArray[np.int64]
    currents: NDArray[np.int64]
    flags: NDArray[np.int64]

    @classmethod
    def empty(cls, ticks: int, plant: DiscretePlant) -> Trace:
        """Room for as many ticks of a plant."""
        counts, phases, currents, flags = (np.zeros(ticks, np.int64) for _ in range(4))
        return cls(np.zeros((ticks, len(plant.at_rest(0.0)))), counts, phases, currents, flags)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The trace's part of the arguments of `run_ticks`."""
        return self.states, self.counts, self.phases, self.currents, self.flags

    def first(self, ticks: int) -> Trace:
        """Return its first ticks."""
        return Trace(*(array[:ticks] for array in self.arrays))

    def __len__(self) -> int:
        return len(self.counts)


TRACE_TYPES = (_MATRIX, _INTS, _INTS, _INTS, _INTS)  # states, counts, phases, currents, flags
RUN_TYPES = (
    CONTROLLER_TYPE, _FLOATS, _MATRIX, _MATRIX, _FLOATS, types.float64, types.int64, types.int64, types.int64,
    _MATRIX, types.int64, *TRACE_TYPES,
)  # fmt: skip


@kernel(types.int64(*RUN_TYPES))
def run_ticks(
    controller: ControllerArguments, state: Any, phi: Any, gamma: Any, plant: Any, external_effort: float,
    edge_age: int, start_units: int, tick_units: int, script: Any, again: int,
    states: Any, counts: Any, phases: Any, currents: Any, flags: Any,
) -> int:  # fmt: skip
    """Run until the law is done or the arrays are full; returns the number of ticks.

    `external_effort` acts on the link all along; `edge_age` is the index of that state; `start_units` and
    `tick_units` are device time of the first sample and length of a tick (1/16 µs). `script` has what the hand
    wants in each tick and goes on at row `again` when it is over; see `sim_backend.operator.Script`.
    """
    m = controller.memory[0]
    row = want(state, edge_age, script, 0, again)
    count = advance(state, phi, gamma, plant, 0.0, external_effort)
    for k in range(len(counts)):
        units = min(
            state[edge_age] * UNITS_PER_SECOND, float(start_units + k * tick_units), float(OLDEST_EDGE)
        )
        edge_age_ns = int(np.rint(units)) * NS_NUMERATOR // NS_DENOMINATOR
        current = step(controller, count, edge_age_ns * 1e-9, 1)
        ends = m["phase"] == DONE
        for i in range(len(state)):  # a slice would be an array to count references to
            states[k, i] = state[i]
        counts[k] = count
        phases[k] = m["phase"]
        currents[k] = 0 if ends else current
        flags[k] = m["flags"]
        if ends:
            return k + 1
        row = want(state, edge_age, script, row, again)
        count = advance(state, phi, gamma, plant, m["effort_sent"], external_effort)
    return len(counts)


def run_trial(
    controller: Controller,
    plant: DiscretePlant,
    initial_position: float,
    *,
    most_ticks: int,
    start_units: int = OLDEST_EDGE,
    initial_velocity: float = 0.0,
    external_effort: float = 0.0,
    script: Script | None = None,
) -> Trace:
    """Run one trial, from rest unless a velocity is given.

    Parameters
    ----------
    controller
        Fresh controller; its memory is used up.
    plant
        Discretised at the controller's tick.
    initial_position
        Of the whole rig, one tick before the first sample (rad or m).
    most_ticks
        Where to stop when the law never ends.
    start_units
        Device time of the first sample (1/16 µs): how old an edge that never happened may look.
    initial_velocity
        Of all masses, one tick before the first sample (rad/s or m/s).
    external_effort
        Effort of the world on the link, all along (N·m or N).
    script
        What the hand of a held plant wants, tick by tick; without one it holds still where it is.
    """
    script = script or Script.silent()
    if len(script.rows) and plant.hand_position is None:
        raise ValueError("a script needs a plant that is held by a hand")
    trace = Trace.empty(most_ticks, plant)
    state = plant.at_rest(initial_position)
    for position in (plant.sensed_position, plant.handle_position, plant.hand_position):
        if position is not None:
            state[position + 1] = initial_velocity
    ticks = run_ticks(
        *run_arguments(controller, plant, state, external_effort, start_units, script), *trace.arrays
    )
    return trace.first(ticks)


def run_arguments(
    controller: Controller,
    plant: DiscretePlant,
    state: Vector,
    external_effort: float,
    start_units: int,
    script: Script,
) -> tuple[Any, ...]:
    """Arguments of `run_ticks` before the arrays of the trace, in its order."""
    return (
        controller.arguments(),
        state,
        *plant.arrays,
        external_effort,
        plant.edge_age,
        start_units,
        round(plant.tick_s * UNITS_PER_SECOND),
        script.rows,
        script.again,
    )
