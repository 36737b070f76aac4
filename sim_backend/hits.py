"""Hits without bytes, one compiled call each: the trial, and the measuring of what was recorded and what is true.

A map of thousands of walls is made of these calls. They allocate nothing and do not hold the GIL, so a thread for each
core keeps it busy, and memory does not grow with the number of hits. What comes out is what
`rig.control.verdict.judge` says of the recording of the same trial over the byte link.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.messages import OLDEST_EDGE
from rig.control import judging
from rig.control.measure import NUMBERS, NUMBERS_TYPE, SECTIONS_TYPE, SETTINGS_TYPE, measure
from rig.control.step import DONE, THROWN_OUT, TRIAL, Controller, ControllerArguments
from rig.control.verdict import Limits, Measured
from rig.core.errors import LawError
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from rig.devices.simulated import SimulatedHit
from rig.realtime.kernel import kernel
from sim_backend.operator import Script
from sim_backend.plant import DiscretePlant
from sim_backend.trial import RUN_TYPES, Trace, run_arguments, run_ticks

_NONFINITE = int(RowFlag.NONFINITE)
_FLOATS = types.float64[::1]

# Rows of the derived signals.
POSITION, PENETRATION, EFFORT, PENETRATION_TRUE = range(4)
SIGNALS = 4


@kernel(
    types.int64(
        *RUN_TYPES, types.int64, types.int64, types.int64, types.float64[:, ::1], _FLOATS,
        SETTINGS_TYPE, SETTINGS_TYPE, SECTIONS_TYPE, _FLOATS, NUMBERS_TYPE, NUMBERS_TYPE,
    ),
)  # fmt: skip
def hit(
    controller: ControllerArguments, state: Any, phi: Any, gamma: Any, plant: Any, external_effort: float,
    edge_age: int, start_units: int, tick_units: int, script: Any, again: int,
    states: Any, counts: Any, phases: Any, currents: Any, flags: Any,
    sensed: int, handle: int, actuated: int, signals: Any, no_velocity: Any,
    recorded_settings: Any, true_settings: Any, sections: Any, scratch: Any, recorded: Any, true: Any,
) -> int:  # fmt: skip
    """Run one trial and measure its trial phase; returns its number of ticks.

    The arguments of `sim_backend.trial.run_ticks`, then the places of sensed position, handle and motor effort in the
    state, room for `SIGNALS` signals, an empty array, and those of `rig.control.measure.measure` for both sides.
    """
    ticks = run_ticks(
        controller, state, phi, gamma, plant, external_effort, edge_age, start_units, tick_units, script, again,
        states, counts, phases, currents, flags,
    )  # fmt: skip
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
        signals[EFFORT, last] = currents[last] * c["effort_quantum"]
        signals[PENETRATION_TRUE, last] = c["wall_side"] * (states[last, sensed] - c["wall_position"])
        last += 1
    measure(
        signals[POSITION, first:last], no_velocity, signals[EFFORT, first:last], signals[PENETRATION, first:last],
        flags[first:last], recorded_settings, sections, scratch, recorded,
    )  # fmt: skip
    measure(
        states[first:last, handle], states[first:last, handle + 1], states[first:last, actuated],
        signals[PENETRATION_TRUE, first:last], flags[first:last], true_settings, sections, scratch, true,
    )  # fmt: skip
    return ticks


class SimulatedRig:
    """A rig to hit again and again; see `rig.devices.simulated`."""

    def __init__(self, model: RigModel, tick_s: float, limits: Limits, most_ticks: int) -> None:
        self._held = replace(
            model, encoder=replace(model.encoder, offset=0.0)
        )  # all that a script depends on
        self._limits = limits
        self._plant = _plant(model, tick_s)
        self._meter = judging.meter(limits, tick_s, model.encoder.resolution)
        self._trace = Trace.empty(most_ticks, self._plant)
        self._signals = np.zeros((SIGNALS, most_ticks))

    def hit(self, controller: Controller, start: float) -> SimulatedHit:
        """Run one trial from rest at a position and measure it."""
        plant, meter, trace = self._plant, self._meter, self._trace
        recorded, true = np.zeros(1, NUMBERS), np.zeros(1, NUMBERS)
        arguments: tuple[Any, ...] = (
            *run_arguments(
                controller, plant, plant.at_rest(start), 0.0, OLDEST_EDGE, self._script(start)
            ),
            *trace.arrays, plant.sensed_position, plant.handle_position, plant.effort, self._signals, _NOTHING,
            *meter.arrays, recorded, true,
        )  # fmt: skip
        ticks = hit(*arguments)
        ended = int(trace.flags[ticks - 1])
        if ended & _NONFINITE:
            raise LawError(
                f"estimator {controller.estimator.estimator.name} or law {controller.law.law.name} gave a value that "
                f"is not finite, {ticks * plant.tick_s:.4g} s into the hit",
                remedy="mend it, or check its settings",
            )
        # What trips in the release leaves the verdict of the push alone.
        pushed = ticks > 1 and trace.phases[ticks - 2] == Phase.RELEASE
        thrown_out = bool(ended & THROWN_OUT) and not pushed
        return SimulatedHit(
            Measured(recorded[0], self._limits, thrown_out),
            Measured(true[0], self._limits, thrown_out),
            ticks,
        )

    def _script(self, start: float) -> Script:
        return _script(self._held, self._plant.tick_s, start)


# The rigs of a map differ in little: what they share is made once, and nobody writes into it. (The exponential of a
# matrix also wakes the threads of a linear algebra library, which then spin for a while on cores that others want.)
_plant = lru_cache(maxsize=64)(DiscretePlant.build)
_script = lru_cache(maxsize=8)(Script.of)  # 2 MB each


_NOTHING = np.zeros(0)
