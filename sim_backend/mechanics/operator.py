"""Compute the intended motion of a simulated person for each tick: a script for the hand of `rig.core.model.Operator`.

The hand follows the handle during homing, waits, reaches into the wall on a raised cosine, stays there and presses. A
script is computed once, before the session. The simulated device and the trial without a byte link play the same
script, from the tick after arming. It must not react to the wall: the coupled hand does.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.model import Operator, OperatorReach, RigModel
from rig.realtime.groups import FloatRows, Int, group
from sim_backend.mechanics.coupled_hand import INTENTIONS

Rows = NDArray[np.float64]

PRESS_HZ = 2.0  # slow modulation of the press: the reproduction's; voluntary force hardly goes beyond 10 Hz
TREMOR_HZ = np.arange(8.0, 12.25, 0.5)  # physiological tremor of the hand, 8 to 12 Hz (PMC3032442)
# A script repeats its last two seconds without a seam, so it lasts forever and stays small.
REPEAT_S = 2.0  # all of these frequencies have a whole number of periods in it


@group
class OperatorScript(NamedTuple):
    """The intended motion of a simulated hand: a row per tick with position, velocity and pressing effort at the link.

    Units are rad, rad/s and N·m (rotary) or m, m/s and N. After the last row the script continues at row `again`. With
    an empty script the hand holds still.
    """

    rows: FloatRows
    again: Int = 0

    @classmethod
    def silent(cls) -> OperatorScript:
        """Return a script without rows (no intended motion), for a rig without a hand."""
        return cls(rows=np.zeros((0, INTENTIONS)))

    @classmethod
    def of(cls, model: RigModel, tick_s: float, position: float, session: int = 0) -> OperatorScript:
        """Return the script (intended motion) of the hand for one session.

        Parameters
        ----------
        model
            Rig with operator and reach; if it lacks either, the script is empty.
        tick_s
            Length of a tick (s). Each row is the intention in the middle of its tick and holds for the whole tick.
        position
            Position of the handle at the start of the session (rad or m).
        session
            Number of earlier sessions of this person; each session has a different tremor.
        """
        if model.operator is None or model.reach is None:
            return cls.silent()
        return _write_script(
            model.operator, model.reach, model.mechanics.handle_radius, tick_s, position, session
        )


@lru_cache(maxsize=8)  # rigs of a map differ in nothing that changes the script; 2 MB each, never written to
def _write_script(
    operator: Operator, reach: OperatorReach, radius: float, tick_s: float, position: float, session: int
) -> OperatorScript:
    homing_s = abs(reach.start - position) / reach.pace
    begin_s = homing_s + reach.wait_s
    rows_before_repeat = math.ceil((begin_s + operator.reach_s) / tick_s)
    t: Rows = (np.arange(rows_before_repeat + round(REPEAT_S / tick_s), dtype=np.float64) + 0.5) * tick_s

    remaining = np.clip(1.0 - t / homing_s, 0.0, 1.0) if homing_s > 0.0 else np.zeros_like(t)
    homing = (position - reach.start) * remaining
    homing_rate = np.where(remaining > 0.0, math.copysign(reach.pace, reach.start - position), 0.0)
    reached, reach_rate = _raised_cosine((t - begin_s) / operator.reach_s)
    reach_rate = reach_rate / operator.reach_s
    trembling, tremor_rate = tremor(t, operator.tremor / radius, np.random.default_rng([reach.seed, session]))
    # A hand that is quite still would hide a buzz behind Coulomb friction: the press swells and ebbs slowly.
    swell = 1.0 + operator.press_modulation * np.sin(2.0 * math.pi * PRESS_HZ * (t - begin_s))

    travel = reach.target - reach.start
    rows = np.empty((len(t), INTENTIONS))
    # Tremor arrives with the press: its force grows with the force exerted (Sutton and Sykes 1967).
    rows[:, 0] = reach.start + homing + travel * reached + trembling * reached
    rows[:, 1] = homing_rate + travel * reach_rate + tremor_rate * reached + trembling * reach_rate
    rows[:, 2] = math.copysign(operator.press * radius, travel) * swell * reached
    return OperatorScript(rows=rows, again=rows_before_repeat)


def _raised_cosine(x: Rows) -> tuple[Rows, Rows]:
    """Return a value that rises smoothly from 0 at x = 0 to 1 at x = 1, and its derivative."""
    x = np.clip(x, 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(math.pi * x), 0.5 * math.pi * np.sin(math.pi * x)


def tremor(t: Rows, rms: float, generator: np.random.Generator) -> tuple[Rows, Rows]:
    """Return a hand tremor at the times `t` (s): displacement with the root mean square `rms`, and its rate per second.

    The tremor is a sum of sine waves of equal size at the frequencies `TREMOR_HZ` with random phases.
    """
    omega = 2.0 * math.pi * TREMOR_HZ
    phase = generator.uniform(0.0, 2.0 * math.pi, len(omega))
    # n sines of equal size with random phases: the squares of their rms values add up to rms².
    amplitude = rms * math.sqrt(2.0 / len(omega))
    value, rate = np.zeros_like(t), np.zeros_like(t)
    for frequency, shift in zip(omega, phase, strict=True):
        value += amplitude * np.sin(frequency * t + shift)
        rate += amplitude * frequency * np.cos(frequency * t + shift)
    return value, rate
