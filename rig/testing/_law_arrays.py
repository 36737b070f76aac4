"""Run a force law over arrays of penetration and velocity, as `rig.control.estimators.arrays` runs an estimator.

The checks of laws use it. It must not limit what a law returns.
"""

from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.control.laws import PreparedLaw
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_FLOATS, _INTS = types.float64[::1], types.int64[::1]


def run(prepared: PreparedLaw, penetration: Floats, velocity: Floats, elapsed: Ints) -> Floats:
    """Return the force or torque (N or N·m) of a prepared law in each tick, called as in the loop.

    `penetration` is in rad or m, `velocity` in rad/s or m/s, `elapsed` in ticks since the previous call.
    """
    found = np.empty(len(penetration))
    run_all(prepared.law.function, penetration, velocity, elapsed, prepared.state, prepared.parameters, found)
    return found


@kernel(types.void(LAW, _FLOATS, _FLOATS, _INTS, _FLOATS, _FLOATS, _FLOATS))
def run_all(
    law: Any,
    penetration: Floats,
    velocity: Floats,
    elapsed: Ints,
    state: Floats,
    parameters: Floats,
    found: Floats,
) -> None:
    """Call a law once for each tick and write the law's force or torque (N or N·m) to the array `found`."""
    for k in range(len(penetration)):
        found[k] = law(penetration[k], velocity[k], elapsed[k], state, parameters)
