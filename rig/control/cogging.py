"""Compensation of cogging (an effort that depends only on the motor's position), which wraps any law.

    effort = −fade(x) · clip(F(x), ± limit)

F is the identified map of effort over position. The fade falls from one to zero at both ends of the range in which F
was measured; outside of this range the compensation is zero.

The compensation acts whenever the wrapped law does: in trial and release, inside the wall and outside, not in homing.
In a recording it is part of the law's effort. The name of the law contains it, and its parameters come before those of
the wrapped law.

`rig.config.controller` wraps a law in it, and the simulation applies the same map to its motor. Kernels here must not
allocate.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.law import Law
from rig.core.model import Cogging
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE

Floats = NDArray[np.float64]

SUFFIX = "+cogging"  # of the name of a wrapped law
FADE = 0.05  # share of the range, at each end
WAVENUMBER, COSINE, SINE, HARMONIC = range(4)  # of one harmonic; how many numbers it has
# Parameters; OWN: where those of the wrapped law begin, behind the harmonics.
WALL, SIDE, MINIMUM, MAXIMUM, LIMIT, OWN, HARMONICS = range(7)


@kernel("f8(f8, f8[::1])", inline=True, no_refcount=True)
def effort_at(position: float, harmonics: Any) -> float:
    """Return the cogging effort (N·m or N) at a position (rad or m), as a sum of harmonics.

    `harmonics` is flat, with three numbers for each: wavenumber (rad per rad or m), cosine and sine coefficient (N·m or
    N).
    """
    effort = 0.0
    for i in range(0, harmonics.shape[0], HARMONIC):
        angle = harmonics[i + WAVENUMBER] * position
        effort += harmonics[i + COSINE] * math.cos(angle) + harmonics[i + SINE] * math.sin(angle)
    return effort


# The compensation cannot drive the rig: an effort that depends on position only gives no net energy on a closed path,
# even if the map is wrong. Only the delay can give energy, as in any wall: with the loop's delay τ a slope s of F adds
# damping s·τ where cogging stiffens, and removes s·τ where cogging softens; theory includes it
# (`rig.analysis.theory._loop`).
@kernel("f8(f8, f8, f8, f8, f8[::1])", inline=True)
def bounded_at(position: float, minimum: float, maximum: float, limit: float, harmonics: Any) -> float:
    """Return the cogging effort to compensate at a position (N·m or N), within ±limit.

    It fades to 0 at `minimum` and `maximum`, the ends of the measured range (rad or m), and is 0 beyond.
    """
    inside = min(position - minimum, maximum - position) / (FADE * (maximum - minimum))
    if inside <= 0.0:
        return 0.0
    # The limit bounds the effort whatever the map says: a position zero that has slipped can double the cogging.
    effort = effort_at(position, harmonics)
    return float(min(inside, 1.0) * min(max(effort, -limit), limit))


def compensate_cogging(law: Law, cogging: Cogging, limit: float) -> Law:
    """Return a law with the effort of `law` plus a compensation of cogging, at most `limit` (N·m or N)."""
    harmonics = cogging.harmonics

    def design(wall: Mapping[str, Any]) -> list[float]:
        own = float(HARMONICS + len(harmonics))
        ends = [cogging.minimum or 0.0, cogging.maximum or 0.0]
        return [wall["position"], wall["side"], *ends, limit, own, *harmonics, *law.design(wall)]

    return Law(
        law.name + SUFFIX,
        f"{law.summary}, with cogging compensated",
        _wrap_law(law.function),
        law.floats,
        design,
    )


def around(law: Law) -> Law:
    """Return `law` with a cogging compensation of zero, whose parameters a replay replaces by the recorded ones."""
    return compensate_cogging(law, Cogging(), 0.0)


@lru_cache(maxsize=32)  # compiling takes a second or two
def _wrap_law(function: Callable[..., float]) -> Any:
    @kernel(LAW_SIGNATURE, cache=False)
    def law_with_cogging_compensated(
        penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
    ) -> float:
        own = int(parameters[OWN])
        reaction = function(penetration, penetration_velocity, elapsed_ticks, state, parameters[own:])
        effort = bounded_at(
            parameters[WALL] + parameters[SIDE] * penetration,
            parameters[MINIMUM],
            parameters[MAXIMUM],
            parameters[LIMIT],
            parameters[HARMONICS:own],
        )
        return float(reaction + parameters[SIDE] * effort)

    return law_with_cogging_compensated
