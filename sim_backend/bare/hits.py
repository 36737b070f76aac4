"""Simulate and measure one hit on a wall in one compiled call, without a byte link. Maps consist of thousands of hits.

The result equals that of `rig.control.judging.judge` for a recording of the same trial over the byte link.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.messages import OLDEST_EDGE
from rig.control import judging
from rig.control.judging import METER_TYPE, NUMBERS, NUMBERS_TYPE, MeterArguments, measure
from rig.control.step import DONE, THROWN_OUT, TRIAL, ControllerArguments, ControllerState
from rig.control.verdict import Measured, Thresholds
from rig.core.errors import LawError
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from rig.devices.simulated import Rendering, SimulatedHit
from rig.realtime.kernel import kernel
from sim_backend.bare.trial import RUN_TYPES, Trace, run_arguments, run_ticks
from sim_backend.mechanics.inner import EFFORT_LIMIT
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant, PlantArguments

_NONFINITE = int(RowFlag.NONFINITE)

# Rows of the derived signals.
POSITION, PENETRATION, EFFORT, PENETRATION_TRUE, REACTION, RATE_TRUE = range(6)
SIGNALS = 6
SINGULAR = (
    1e-12  # share of the product of both sums of squares below which penetration and rate are proportional
)
STIFFNESS, DAMPING, VELOCITY_ERROR = range(3)  # indices into `rendering`


@kernel("void(f8[:], f8[:], f8[:], f8[::1])")
def render(effort: Any, penetration: Any, rate: Any, rendering: Any) -> None:
    """Fit stiffness and damping to a trial's effort inside the wall, write them to `rendering`; NaN if undetermined."""
    xx = xv = vv = xf = vf = 0.0
    for k in range(len(effort)):
        x, v, f = penetration[k], rate[k], effort[k]
        if x > 0.0:
            xx, xv, vv, xf, vf = xx + x * x, xv + x * v, vv + v * v, xf + x * f, vf + v * f
    determinant = xx * vv - xv * xv
    rendering[STIFFNESS] = rendering[DAMPING] = np.nan
    if determinant > SINGULAR * xx * vv:
        rendering[STIFFNESS] = (xf * vv - vf * xv) / determinant
        rendering[DAMPING] = (vf * xx - xf * xv) / determinant


@kernel(types.int64(*RUN_TYPES, types.float64[:, ::1], METER_TYPE, NUMBERS_TYPE, types.float64[::1]))
def hit(
    controller: ControllerArguments,
    plant: PlantArguments,
    script: OperatorScript,
    ages: Any,
    external_effort: float,
    start_units: int,
    tick_units: int,
    trace: Trace,
    signals: Any,
    meter: MeterArguments,
    numbers: Any,
    rendering: Any,
) -> int:
    """Run one trial and measure its trial phase; return the number of ticks of the whole run.

    The first eight arguments are those of `sim_backend.bare.trial.run_ticks`. `signals` is scratch memory of `SIGNALS`
    rows, one column for each tick. `meter` contains the filters of the measurement. The measured numbers are written to
    the two records of `numbers` (dtype `rig.control.judging.NUMBERS`): those of the values that a rig records, and
    those of the plant's state. Rendered stiffness, damping and velocity error are written to `rendering`.
    """
    # Nothing here allocates or takes the GIL: a thread for each core stays busy, and memory does not grow with the
    # number of hits.
    ticks = run_ticks(controller, plant, script, ages, external_effort, start_units, tick_units, trace)
    states, counts, phases, flags = trace.states, trace.counts, trace.phases, trace.flags
    c = controller.control[0]
    # A run that filled the arrays was cut off, in homing or later: it is not measured.
    first = 0 if phases[ticks - 1] == DONE else ticks
    while first < ticks and phases[first] != TRIAL:
        first += 1
    last, squares = first, 0.0
    while last < ticks and phases[last] == TRIAL:
        position = c["resolution"] * (counts[last] - c["reference_count"])
        signals[POSITION, last] = position
        signals[PENETRATION, last] = c["wall_side"] * (position - c["wall_position"])
        signals[EFFORT, last] = trace.currents[last] * c["effort_quantum"]
        signals[PENETRATION_TRUE, last] = c["wall_side"] * (
            states[last, plant.sensed_position] - c["wall_position"]
        )
        velocity = states[last, plant.sensed_position + 1]
        signals[RATE_TRUE, last] = c["wall_side"] * velocity
        signals[REACTION, last] = c["wall_side"] * (c["constant_effort"] - signals[EFFORT, last])
        squares += (trace.velocities[last] - velocity) ** 2
        last += 1
    rendering[VELOCITY_ERROR] = math.sqrt(squares / max(1, last - first))
    shown, moved = signals[:, first:last], states[first:last]
    render(shown[REACTION], shown[PENETRATION_TRUE], shown[RATE_TRUE], rendering)
    measure(
        shown[POSITION],
        shown[POSITION, :0],  # no recorded velocity: it is derived from the counts
        shown[EFFORT],
        shown[PENETRATION],
        flags[first:last],
        meter.recorded,
        meter.sections,
        meter.scratch,
        numbers[:1],
    )
    measure(
        moved[:, plant.handle_position],
        moved[:, plant.handle_position + 1],
        moved[:, plant.effort],
        shown[PENETRATION_TRUE],
        flags[first:last],
        meter.true,
        meter.sections,
        meter.scratch,
        numbers[1:],
    )
    return ticks


class RigOfHits:
    """A simulated rig that hits a wall many times, each time from rest (a `rig.devices.simulated.SimulatedRig`)."""

    def __init__(self, model: RigModel, tick_s: float, thresholds: Thresholds, most_ticks: int) -> None:
        self._model = model
        self._thresholds = thresholds
        self._plant = DiscretePlant.build(model, tick_s)
        self._meter = judging.meter(thresholds, tick_s, model.encoder.resolution)
        self._trace = Trace.empty(most_ticks, self._plant)
        self._signals = np.zeros((SIGNALS, most_ticks))

    def hit(self, controller: ControllerState, start: float) -> SimulatedHit:
        """Run one hit from rest at `start` (rad or m); return what recorded and exact signals give, and the ticks.

        Raise `LawError` if the estimator or the law gave a value that is not finite.
        """
        plant, meter, trace = self._plant, self._meter, self._trace
        ratio = self._model.amplifier.effort_quantum / controller.control[0]["effort_quantum"]
        # The controller is wrong about the effort of a quantum: the same currents move the plant by another effort.
        if ratio != 1.0:
            gamma, parameters = plant.gamma.copy(), plant.parameters.copy()
            gamma[:, 0] *= ratio
            parameters[EFFORT_LIMIT] /= ratio
            plant = replace(plant, gamma=gamma, parameters=parameters)
        numbers, rendering = np.zeros(2, NUMBERS), np.zeros(3)
        state, script = plant.at_rest(start), OperatorScript.of(self._model, plant.tick_s, start)
        arguments = run_arguments(controller, plant, state, 0.0, OLDEST_EDGE, script)
        ticks = hit(*arguments, trace, self._signals, meter.arguments(), numbers, rendering)
        ended = int(trace.flags[ticks - 1])
        if ended & _NONFINITE:
            raise LawError(
                f"estimator {controller.estimator.estimator.name} or law {controller.law.law.name} gave a value that "
                f"is not finite, {ticks * plant.tick_s:.4g} s into the hit",
                remedy="correct the law, or check its settings",
            )
        # A safety limit that acts in the release must not change the verdict on the trial before it.
        pushed = ticks > 1 and trace.phases[ticks - 2] == Phase.RELEASE
        thrown_out = bool(ended & THROWN_OUT) and not pushed
        return SimulatedHit(
            Measured(numbers[0], self._thresholds, thrown_out),
            Measured(numbers[1], self._thresholds, thrown_out),
            Rendering(*rendering.tolist()),
            ticks,
        )
