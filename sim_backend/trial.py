"""A whole trial in one compiled call: plant, sensors and the law, without bytes, frames or clocks.

The same `rig.control.step.step`, the same `advance`, the same quantisers as the simulated device behind its link; what
is missing is everything that can go wrong in between. Both ways therefore give the same trajectory, to the last bit,
and a map of thousands of trials may be computed this way.

Device time appears only as the age of the last encoder edge, which the wire carries in units of 1/16 µs; it is rounded
here as it is there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from firmware_protocol.messages import OLDEST_EDGE, TIME_UNIT_NS
from rig.control.step import CONTROLLER_TYPE, DONE, Controller, ControllerArguments, step
from rig.realtime.groups import FloatRows, Ints, group, type_of
from rig.realtime.kernel import kernel
from sim_backend.coupled_hand import want
from sim_backend.inner import Vector
from sim_backend.operator import Script
from sim_backend.plant import PLANT_TYPE, DiscretePlant, PlantArguments, advance
from sim_backend.safety import UNITS_PER_SECOND

NS_NUMERATOR, NS_DENOMINATOR = TIME_UNIT_NS.as_integer_ratio()


@group
class Trace(NamedTuple):
    """What happened in each tick: plant state at the sample, count, phase, current commanded in answer, row flags."""

    states: FloatRows
    counts: Ints
    phases: Ints
    currents: Ints
    flags: Ints

    @classmethod
    def empty(cls, ticks: int, plant: DiscretePlant) -> Trace:
        """Room for as many ticks of a plant."""
        states = np.zeros((ticks, len(plant.at_rest(0.0))))
        return cls(states=states, **{name: np.zeros(ticks, np.int64) for name in cls._fields[1:]})

    def first(self, ticks: int) -> Trace:
        """Return its first ticks."""
        return Trace._make(array[:ticks] for array in self)


RUN_TYPES = (
    *(CONTROLLER_TYPE, PLANT_TYPE, type_of(Script)),
    *(types.float64, types.int64, types.int64, type_of(Trace)),
)


@kernel(types.int64(*RUN_TYPES))
def run_ticks(
    controller: ControllerArguments,
    plant: PlantArguments,
    script: Script,
    external_effort: float,
    start_units: int,
    tick_units: int,
    trace: Trace,
) -> int:
    """Run until the law is done or the trace is full; returns the number of ticks.

    `script` has what the hand wants; `external_effort` acts on the link all along; `start_units` and `tick_units` are
    device time of the first sample and length of a tick (1/16 µs).
    """
    m, state, edge_age = controller.memory[0], plant.state, plant.edge_age
    row = want(state, edge_age, script.rows, 0, script.again)
    count = advance(plant, 0.0, external_effort)
    for k in range(len(trace.counts)):
        units = min(
            state[edge_age] * UNITS_PER_SECOND, float(start_units + k * tick_units), float(OLDEST_EDGE)
        )
        edge_age_ns = int(np.rint(units)) * NS_NUMERATOR // NS_DENOMINATOR
        current = step(controller, count, edge_age_ns * 1e-9, 1)
        ends = m["phase"] == DONE
        for i in range(len(state)):  # a slice would be an array to count references to
            trace.states[k, i] = state[i]
        trace.counts[k] = count
        trace.phases[k] = m["phase"]
        trace.currents[k] = 0 if ends else current
        trace.flags[k] = m["flags"]
        if ends:
            return k + 1
        row = want(state, edge_age, script.rows, row, script.again)
        count = advance(plant, m["effort_sent"], external_effort)
    return len(trace.counts)


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
    arguments = run_arguments(controller, plant, state, external_effort, start_units, script)
    ticks = run_ticks(*arguments, trace)
    return trace.first(ticks)


def run_arguments(
    controller: Controller,
    plant: DiscretePlant,
    state: Vector,
    external_effort: float,
    start_units: int,
    script: Script,
) -> tuple[ControllerArguments, PlantArguments, Script, float, int, int]:
    """Arguments of `run_ticks` before the trace, in its order."""
    tick_units = round(plant.tick_s * UNITS_PER_SECOND)
    return (
        controller.arguments(),
        plant.arguments(state),
        script,
        external_effort,
        start_units,
        tick_units,
    )
