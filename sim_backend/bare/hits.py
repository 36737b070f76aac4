"""Simulate and measure one hit on a wall in one compiled call, without a byte link. Maps consist of thousands of hits.

The result equals that of `rig.control.judging.judge` for a recording of the same trial over the byte link.
"""

from __future__ import annotations

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
from rig.devices.simulated import SimulatedHit
from rig.realtime.kernel import kernel
from sim_backend.bare.trial import RUN_TYPES, Trace, run_arguments, run_ticks
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant, PlantArguments

_NONFINITE = int(RowFlag.NONFINITE)

# Rows of the derived signals.
POSITION, PENETRATION, EFFORT, PENETRATION_TRUE = range(4)
SIGNALS = 4


@kernel(types.int64(*RUN_TYPES, types.float64[:, ::1], METER_TYPE, NUMBERS_TYPE, NUMBERS_TYPE))
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
    recorded: Any,
    true: Any,
) -> int:
    """Run one trial and measure its trial phase; return the number of ticks of the whole run.

    The first eight arguments are those of `sim_backend.bare.trial.run_ticks`. `signals` is scratch memory of `SIGNALS`
    rows. `meter` contains the filters of the measurement. The measured numbers are written to `recorded` (from the
    values that a rig records) and `true` (from the plant's state), both of dtype `rig.control.judging.NUMBERS`.
    """
    # Nothing here allocates or takes the GIL: a thread for each core stays busy, and memory does not grow with the
    # number of hits.
    ticks = run_ticks(controller, plant, script, ages, external_effort, start_units, tick_units, trace)
    states, counts, phases, flags = trace.states, trace.counts, trace.phases, trace.flags
    c = controller.control[0]
    # A run that filled the arrays was cut off, in homing or later: nothing of it is measured.
    first = 0 if phases[ticks - 1] == DONE else ticks
    while first < ticks and phases[first] != TRIAL:
        first += 1
    last = first
    while last < ticks and phases[last] == TRIAL:
        position = c["resolution"] * (counts[last] - c["reference_count"])
        signals[POSITION, last] = position
        signals[PENETRATION, last] = c["wall_side"] * (position - c["wall_position"])
        signals[EFFORT, last] = trace.currents[last] * c["effort_quantum"]
        signals[PENETRATION_TRUE, last] = c["wall_side"] * (
            states[last, plant.sensed_position] - c["wall_position"]
        )
        last += 1
    shown, moved = signals[:, first:last], states[first:last]
    measure(
        shown[POSITION],
        shown[POSITION, :0],  # the velocity is that of the counts
        shown[EFFORT],
        shown[PENETRATION],
        flags[first:last],
        meter.recorded,
        meter.sections,
        meter.scratch,
        recorded,
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
        true,
    )
    return ticks


class RigOfHits:
    """A simulated rig that makes many hits on a wall, each from rest (`rig.devices.simulated`)."""

    def __init__(self, model: RigModel, tick_s: float, thresholds: Thresholds, most_ticks: int) -> None:
        self._model = model
        self._thresholds = thresholds
        self._plant = DiscretePlant.build(model, tick_s)
        self._meter = judging.meter(thresholds, tick_s, model.encoder.resolution)
        self._trace = Trace.empty(most_ticks, self._plant)
        self._signals = np.zeros((SIGNALS, most_ticks))

    def hit(self, controller: ControllerState, start: float) -> SimulatedHit:
        """Run one hit from rest at `start` (rad or m); return the measured numbers and the ticks of the run.

        Raise `LawError` if the estimator or the law gave a value that is not finite.
        """
        plant, meter, trace = self._plant, self._meter, self._trace
        recorded, true = np.zeros(1, NUMBERS), np.zeros(1, NUMBERS)
        state, script = plant.at_rest(start), OperatorScript.of(self._model, plant.tick_s, start)
        arguments = run_arguments(controller, plant, state, 0.0, OLDEST_EDGE, script)
        ticks = hit(*arguments, trace, self._signals, meter.arguments(), recorded, true)
        ended = int(trace.flags[ticks - 1])
        if ended & _NONFINITE:
            raise LawError(
                f"estimator {controller.estimator.estimator.name} or law {controller.law.law.name} gave a value that "
                f"is not finite, {ticks * plant.tick_s:.4g} s into the hit",
                remedy="correct the law, or check its settings",
            )
        # A guard that trips in the release must not change the verdict of the push before it.
        pushed = ticks > 1 and trace.phases[ticks - 2] == Phase.RELEASE
        thrown_out = bool(ended & THROWN_OUT) and not pushed
        return SimulatedHit(
            Measured(recorded[0], self._thresholds, thrown_out),
            Measured(true[0], self._thresholds, thrown_out),
            ticks,
        )
