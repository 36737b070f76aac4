"""Friction compensation: the motor supplies a part of the Coulomb friction that a hand would feel.

    effort = share · level · φ(velocity / dead band),    φ(x) = x·(3 − x²)/2 for |x| ≤ 1, else the sign of x

The level is the friction in the direction of motion, up or down. Inside the dead band the effort falls smoothly to
zero, so that a handle at rest gets no effort. The dead band must be wider than the encoder's noise, which would cause
chatter.

It acts only if a law is wrapped in it, and whenever that law does: in trial and release, inside the wall and outside.
In a recording the name of the law contains it, and the first four parameters of the law belong to it.

`rig.config.controller` wraps a law in it. Kernels here must not allocate.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.control.law import Law
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE

Floats = NDArray[np.float64]

SUFFIX = "+friction"  # of the name of a wrapped law
DEFAULT_SHARE = 0.8
INWARDS, OUTWARDS, DEAD_BAND, SHARE, OWN = range(5)  # parameters; the wrapped law's own begin at OWN


# The compensation cannot drive the rig: it is at most share · level, and while the handle slides with velocity v,
# friction dissipates level · |v|. Whatever velocity the estimator returns, the power of compensation and friction
# together is at most −(1 − share) · level · |v| ≤ 0; at rest it is zero. So the compensation adds no energy while the
# rig's true friction is at least share · level (by default 0.8 of the identified level); if it is lower by d, the added
# energy is at most d · |distance slid|. On a rig of two masses this holds for the mass that the motor drives and its
# friction: use levels of the motor side if the link has much friction.
@kernel("f8(f8, f8, f8, f8, f8)", inline=True)
def compensation(velocity: float, rising: float, falling: float, dead_band: float, share: float) -> float:
    """Return the effort (N·m or N) that compensates friction at a velocity (rad/s or m/s), in its direction.

    `rising` and `falling` are the friction levels (N·m or N) for positive and negative velocity, `share` (0 to 1) is
    their compensated fraction, and below `dead_band` (rad/s or m/s) the effort falls smoothly to 0.
    """
    level = share * (rising if velocity > 0.0 else falling)
    x = velocity / dead_band
    if x >= 1.0:
        return level
    if x <= -1.0:
        return -level
    return level * 0.5 * x * (3.0 - x * x)


@dataclass(frozen=True, slots=True, kw_only=True)
class Compensation:
    """Settings of a friction compensation.

    Attributes
    ----------
    up, down
        Identified friction while the position rises and while it falls (N·m or N, at least 0).
    dead_band
        Speed from which the compensation acts fully (rad/s or m/s, above 0).
    share
        Fraction of the friction that is compensated, from 0 to below 1.

    Raises
    ------
    ConfigError
        A value is outside of its range.
    """

    up: float
    down: float
    dead_band: float
    share: float = DEFAULT_SHARE

    def __post_init__(self) -> None:
        if not (0.0 <= self.up < math.inf and 0.0 <= self.down < math.inf):
            raise ConfigError(
                f"the friction levels {self.up!r} (rising) and {self.down!r} (falling position) are not valid: "
                "they must be finite and at least 0",
                remedy="give finite numbers from 0 on (N·m or N)",
            )
        if not 0.0 < self.dead_band < math.inf:
            raise ConfigError(
                f"the dead band of {self.dead_band!r} is not a valid speed: it must be finite and above zero",
                remedy="give a speed above the noise of the velocity estimate (dead_band_of)",
            )
        if not 0.0 <= self.share < 1.0:
            raise ConfigError(
                f"the compensated share of the friction, {self.share!r}, is out of range",
                remedy=f"choose 0 to below 1; {DEFAULT_SHARE} leaves a margin for friction that varies",
            )


def dead_band_of(resolution: float, velocity_rate: float, cutoff_hz: float) -> float:
    """Return a dead band for friction compensation (rad/s or m/s): four times the velocity that one count causes.

    `resolution` is the travel for one count (rad or m), `velocity_rate` the rate of the estimator (Hz), `cutoff_hz` the
    cut-off of its low pass (Hz).
    """
    # One count is an impulse of resolution·rate in a difference; a second-order Butterworth filter answers it with a
    # peak of about 0.46·2π·cut-off·resolution.
    return 4.0 * resolution * min(velocity_rate, 0.46 * 2.0 * math.pi * cutoff_hz)


def compensate_friction(law: Law, wanted: Compensation) -> Law:
    """Return a law with the effort of `law` plus a compensation of friction."""

    def design(wall: Mapping[str, Any]) -> list[float]:
        inwards, outwards = (wanted.up, wanted.down) if wall["side"] > 0 else (wanted.down, wanted.up)
        return [inwards, outwards, wanted.dead_band, wanted.share, *law.design(wall)]

    return Law(
        law.name + SUFFIX,
        f"{law.summary}, with friction compensation",
        _wrap_law(law.function),
        law.floats,
        design,
    )


def around(law: Law) -> Law:
    """Return `law` with a friction compensation of zero, whose parameters a replay replaces by the recorded ones."""
    return compensate_friction(law, Compensation(up=0.0, down=0.0, dead_band=1.0))


@lru_cache(maxsize=32)  # compiling takes a second or two
def _wrap_law(function: Callable[..., float]) -> Any:
    @kernel(LAW_SIGNATURE, cache=False)
    def law_with_compensation(
        penetration: float, penetration_velocity: float, elapsed_ticks: int, state: Floats, parameters: Floats
    ) -> float:
        reaction = function(penetration, penetration_velocity, elapsed_ticks, state, parameters[OWN:])
        return reaction - compensation(
            penetration_velocity,
            parameters[INWARDS],
            parameters[OUTWARDS],
            parameters[DEAD_BAND],
            parameters[SHARE],
        )

    return law_with_compensation
