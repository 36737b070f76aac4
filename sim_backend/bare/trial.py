"""Simulate a whole trial in one compiled call: plant, sensors and control law, without bytes, frames or clocks.

The trial uses the same `step`, `advance` and quantisers as the simulated device behind a link, so both give the same
trajectory to the last bit. It has no watchdog; a caller that delays samples (`ages`) must keep that in mind.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.messages import OLDEST_EDGE, TIME_UNIT_NS
from rig.control.step import CONTROLLER_TYPE, DONE, ControllerArguments, ControllerState, step
from rig.core.sample import RowFlag
from rig.realtime.groups import FloatRows, Floats, Ints, group, type_of
from rig.realtime.kernel import kernel
from sim_backend.board.safety import UNITS_PER_SECOND
from sim_backend.mechanics.coupled_hand import want
from sim_backend.mechanics.inner import Vector
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import PLANT_TYPE, DiscretePlant, PlantArguments, advance

NS_NUMERATOR, NS_DENOMINATOR = TIME_UNIT_NS.as_integer_ratio()
UNSEEN = -1  # phase of a sample that the law did not process
IN_TIME = np.zeros(0, np.int64)  # ages of samples that all come at once
_LATE, _GAP = int(RowFlag.LATE), int(RowFlag.GAP)


@group
class Trace(NamedTuple):
    """Recording of a trial, one row for each tick.

    A row has the plant's state, estimated velocity (rad/s or m/s), encoder count, phase, active and commanded current
    (quanta) and row flags. A sample that the law did not process has the phase `UNSEEN`, and velocity and flags 0.
    """

    states: FloatRows
    velocities: Floats
    counts: Ints
    phases: Ints
    active: Ints
    currents: Ints
    flags: Ints

    @classmethod
    def empty(cls, ticks: int, plant: DiscretePlant) -> Trace:
        """Return a recording of zeros with room for `ticks` ticks of a plant."""
        states = np.zeros((ticks, len(plant.at_rest(0.0))))
        integers = {name: np.zeros(ticks, np.int64) for name in cls._fields[2:]}
        return cls(states=states, velocities=np.zeros(ticks), **integers)

    def first(self, ticks: int) -> Trace:
        """Return the recording cut to its first `ticks` ticks."""
        return Trace._make(array[:ticks] for array in self)


RUN_TYPES = (
    *(CONTROLLER_TYPE, PLANT_TYPE, type_of(OperatorScript), types.int64[::1]),
    *(types.float64, types.int64, types.int64, type_of(Trace)),
)


@kernel(types.int64(*RUN_TYPES))
def run_ticks(
    controller: ControllerArguments,
    plant: PlantArguments,
    script: OperatorScript,
    ages: Ints,
    external_effort: float,
    start_units: int,
    tick_units: int,
    trace: Trace,
) -> int:
    """Run until the law is done or the recording `trace` is full; return the number of ticks up to the last sample.

    `script` contains the intended motion of the hand. `ages` is the age in ticks, in each tick, of the newest sample
    that has reached the law; 0 means no delay, also for ticks beyond the array's end. Late samples get the same flags
    as in real time. `external_effort` acts on the link during the whole run (N·m or N). `start_units` is the device
    time of the first sample, `tick_units` the length of a tick (1/16 µs).
    """
    m, state, edge_age = controller.memory[0], plant.state, plant.edge_age
    # The device moves one tick under zero effort between ARM and its first sample.
    row = want(state, edge_age, script.rows, 0, script.again)
    count = advance(plant, 0.0, external_effort)
    seen = -1
    for k in range(len(trace.counts)):
        for i in range(len(state)):  # a slice would be an array to count references to
            trace.states[k, i] = state[i]
        trace.counts[k] = count
        trace.active[k] = m["current_sent"]  # set by the command before, as a STATE reports it
        trace.phases[k], trace.flags[k], trace.velocities[k] = UNSEEN, 0, 0.0
        age = ages[k] if k < len(ages) else 0
        sample = k - age
        # No newer sample has come: the law computes no command, and the device holds the last one.
        if sample > seen:
            elapsed = 1 if seen < 0 else sample - seen
            seen = sample
            # The wire carries the age of the last edge in units of 1/16 µs: round here as there, or the velocity
            # estimates differ in their last bits. An edge that never happened looks as old as the device's clock.
            units = min(
                trace.states[sample, edge_age] * UNITS_PER_SECOND,
                float(start_units + sample * tick_units),
                float(OLDEST_EDGE),
            )
            edge_age_ns = int(np.rint(units)) * NS_NUMERATOR // NS_DENOMINATOR
            current = step(
                controller, trace.counts[sample], edge_age_ns * 1e-9, elapsed, trace.active[sample]
            )
            ends = m["phase"] == DONE
            trace.phases[sample] = m["phase"]
            trace.velocities[sample] = m["velocity"]
            # With DONE the loop sends STOP in place of the law's current.
            trace.currents[sample] = 0 if ends else current
            trace.flags[sample] = m["flags"] | (_LATE if age > 1 else 0) | (_GAP if elapsed > 1 else 0)
            if ends:
                return sample + 1
        row = want(state, edge_age, script.rows, row, script.again)
        count = advance(plant, m["effort_sent"], external_effort)
    return len(trace.counts)


def run_trial(
    controller: ControllerState,
    plant: DiscretePlant,
    initial_position: float,
    *,
    most_ticks: int,
    start_units: int = OLDEST_EDGE,
    initial_velocity: float = 0.0,
    external_effort: float = 0.0,
    script: OperatorScript | None = None,
    ages: NDArray[np.int64] = IN_TIME,
) -> Trace:
    """Simulate one trial and return its trace.

    Parameters
    ----------
    controller
        New controller; the run changes its memory, so it cannot be used again.
    plant
        Plant, discretised at the controller's tick.
    initial_position
        Position of all masses one tick before the first sample (rad or m).
    most_ticks
        Largest number of ticks, for a law that never ends.
    start_units
        Device time of the first sample (1/16 µs). Before the first encoder edge, this is the reported age of the edge.
    initial_velocity
        Velocity of all masses one tick before the first sample (rad/s or m/s).
    external_effort
        External effort on the link during the whole run (N·m or N).
    script
        Intended motion of the hand, tick by tick; without a script the hand holds still.
    ages
        Age in ticks, in each tick, of the newest sample that has reached the law (`run_ticks`); by default no delay.
    """
    script = script or OperatorScript.silent()
    if len(script.rows) and plant.hand_position is None:
        raise ValueError("the plant has no hand, but a script for a hand was given; leave out `script`")
    trace = Trace.empty(most_ticks, plant)
    state = plant.at_rest(initial_position)
    for position in (plant.sensed_position, plant.handle_position, plant.hand_position):
        if position is not None:
            state[position + 1] = initial_velocity
    arguments = run_arguments(controller, plant, state, external_effort, start_units, script, ages)
    ticks = run_ticks(*arguments, trace)
    return trace.first(ticks)


def run_arguments(
    controller: ControllerState,
    plant: DiscretePlant,
    state: Vector,
    external_effort: float,
    start_units: int,
    script: OperatorScript,
    ages: NDArray[np.int64] = IN_TIME,
) -> tuple[ControllerArguments, PlantArguments, OperatorScript, NDArray[np.int64], float, int, int]:
    """Return the arguments of `run_ticks` in the order of its parameters, without the last one (`trace`)."""
    tick_units = round(plant.tick_s * UNITS_PER_SECOND)
    return (
        controller.arguments(),
        plant.arguments(state),
        script,
        ages,
        external_effort,
        start_units,
        tick_units,
    )
