"""Simulate a rig that is excited about a point, in one compiled call without a byte link: for impedance measurements.

`rig.devices.excited_simulation` returns it. Each tick calls the control law (`rig.control.step.step`) once. There is no
homing.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numba import types

from firmware_protocol.messages import OLDEST_EDGE
from rig.control.bilateral import ramp
from rig.control.step import CONTROLLER_TYPE, TRIAL, ControllerArguments, ControllerState, step
from rig.core.errors import LawError
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from rig.devices.simulated import ExcitedMotion
from rig.realtime.groups import Floats, Ints, group, type_of
from rig.realtime.kernel import kernel
from sim_backend.bare.trial import NS_DENOMINATOR, NS_NUMERATOR
from sim_backend.board.safety import UNITS_PER_SECOND
from sim_backend.mechanics.inner import Vector
from sim_backend.mechanics.plant import PLANT_TYPE, DiscretePlant, PlantArguments, advance

MIN_INNER_RATE_HZ = 16_000.0  # 160 steps in a period of a 100 Hz excitation

_LIMITED = int(RowFlag.SATURATED | RowFlag.SLEW_BOUND)
_NONFINITE = int(RowFlag.NONFINITE)


@group
class ExcitedTrace(NamedTuple):
    """Recording of a run, in arrays that `excite` fills.

    `limited_ticks` (length 1) counts the ticks whose effort a limit changed. `counts`, `positions` (rad or m) and
    `velocities` (rad/s or m/s) are those of the handle; `withheld` is the sent minus the wanted effort in each tick
    (N·m or N).
    """

    limited_ticks: Ints
    counts: Ints
    positions: Floats
    velocities: Floats
    withheld: Floats


@kernel(
    types.int64(
        *(CONTROLLER_TYPE, PLANT_TYPE, type_of(ExcitedTrace), types.int64, types.int64, types.int64),
        *(types.float64[::1], types.int64),
    )
)
def excite(
    controller: ControllerArguments,
    plant: PlantArguments,
    kept: ExcitedTrace,
    count: int,
    steps_per_tick: int,
    steps_per_row: int,
    excitation: Any,
    ramp_steps: int,
) -> int:
    """Run the law until `kept.withheld` is full or a safety limit ends the run; return the number of whole ticks.

    The plant is discretised at the integration step, and `count` is its present encoder count. `steps_per_tick` is the
    number of integration steps in a tick, `steps_per_row` that between two recorded positions. `excitation` is one
    period of the second actuator's effort, in the middle of each step (N·m or N): taken at the beginning it would be
    late by half a step, which shows in a phase. It rises from zero during the first `ramp_steps` steps.
    """
    state, withheld = plant.state, kept.withheld
    m = controller.memory[0]
    inner_step, row, excitation_index = 0, 0, 0
    for k in range(withheld.shape[0]):
        # Rounded to the units of a STATE message, as over the byte link.
        units = min(state[plant.edge_age] * UNITS_PER_SECOND, float(OLDEST_EDGE))
        edge_age_ns = int(np.rint(units)) * NS_NUMERATOR // NS_DENOMINATOR
        current_active = m["current_sent"]  # no link delays the command
        step(controller, count, edge_age_ns * 1e-9, 1, current_active)
        if m["phase"] != TRIAL:
            return k
        effort = m["effort_sent"]
        withheld[k] = effort - m["effort_wanted"]
        if m["flags"] & _LIMITED != 0:
            kept.limited_ticks[0] += 1
        for _ in range(steps_per_tick):
            # A separate instrument samples faster than the law.
            if row * steps_per_row == inner_step:
                kept.counts[row] = count
                kept.positions[row] = state[plant.handle_position]
                kept.velocities[row] = state[plant.handle_position + 1]
                row += 1
            push = excitation[excitation_index]
            if inner_step < ramp_steps:
                push *= ramp(inner_step, ramp_steps)
            count = advance(plant, effort, push)
            inner_step += 1
            excitation_index += 1
            if excitation_index == excitation.shape[0]:
                excitation_index = 0
    return int(withheld.shape[0])


class ExcitedPlant:
    """A simulated rig that makes many impedance measurements, each from rest; a second actuator excites it."""

    def __init__(self, model: RigModel, tick_s: float, acquisition_hz: float, most_ticks: int) -> None:
        inner_s = min(model.simulation.inner_step_s, 1.0 / MIN_INNER_RATE_HZ)
        # Minus 1e-9: a quotient that rounding left just above a whole number must not add a step.
        self._steps_per_tick = max(1, math.ceil(tick_s / inner_s - 1e-9))
        # The plant's tick is now an integration step, so the same delay in seconds is more of its ticks.
        delay = model.simulation.computation_delay_ticks * self._steps_per_tick
        finer = replace(model, simulation=replace(model.simulation, computation_delay_ticks=delay))
        self._plant = DiscretePlant.build(finer, tick_s / self._steps_per_tick)
        self._tick_s = tick_s
        self._steps_per_row = self._divisor(acquisition_hz)
        rows = most_ticks * self._steps_per_tick // self._steps_per_row + 1
        self._counts = np.zeros(rows, np.int64)
        self._positions, self._velocities = np.zeros(rows), np.zeros(rows)
        self._withheld = np.zeros(most_ticks)

    @property
    def inner_rate_hz(self) -> float:
        """Return the rate of the plant's integration steps (Hz)."""
        return self._steps_per_tick / self._tick_s

    def _divisor(self, acquisition_hz: float) -> int:
        """Return the number of integration steps between two recorded positions; it divides those in a tick.

        It is the largest divisor that gives a rate of at least `acquisition_hz` (Hz), else 1.
        """
        most = max(1, min(self._steps_per_tick, math.floor(self.inner_rate_hz / acquisition_hz + 1e-9)))
        return next(n for n in range(most, 0, -1) if self._steps_per_tick % n == 0)

    def excite(
        self, controller: ControllerState, position: float, excitation: Vector, ramp_s: float, ticks: int
    ) -> ExcitedMotion:
        """Run the law for `ticks` ticks, from rest at `position` (rad or m), and return the recorded motion.

        `excitation` is one period of the second actuator's effort, a value per integration step (N·m or N); it rises
        during `ramp_s` (s). Raise `LawError` if the estimator or the law gave a value that is not finite.
        """
        plant = self._plant
        state = plant.at_rest(position)
        memory = controller.memory
        # The run begins at rest in the trial's phase, so nothing is homed. With the rig's own motor as the actuator
        # (`rig.control.bilateral`) the counts equal those of the same trial over the byte link to the last bit.
        memory["phase"], memory["phase_ticks"] = int(Phase.TRIAL), -1  # `step` adds 1 first: tick 0
        limited_ticks = np.zeros(1, np.int64)
        kept = ExcitedTrace(
            limited_ticks=limited_ticks,
            counts=self._counts,
            positions=self._positions,
            velocities=self._velocities,
            withheld=self._withheld[:ticks],
        )
        ran = excite(
            controller.arguments(),
            plant.arguments(state),
            kept,
            plant.count(state),
            self._steps_per_tick,
            self._steps_per_row,
            excitation,
            round(ramp_s * self.inner_rate_hz),
        )
        if int(memory["flags"][0]) & _NONFINITE:
            raise LawError(
                f"estimator {controller.estimator.estimator.name} or law {controller.law.law.name} gave a value that "
                f"is not finite, {ran * self._tick_s:.4g} s into the run",
                remedy="correct the law, or check its settings",
            )
        rows = ran * self._steps_per_tick // self._steps_per_row
        return ExcitedMotion(
            counts=self._counts[:rows].copy(),
            position=self._positions[:rows].copy(),
            velocity=self._velocities[:rows].copy(),
            withheld=self._withheld[:ran].copy(),
            saturated=int(limited_ticks[0]),
            ticks=ran,
            acquisition_s=self._tick_s * self._steps_per_row / self._steps_per_tick,
        )
