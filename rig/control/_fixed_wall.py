"""The wall and its guard in fixed point, from counts to current quanta: the reference that firmware must match.

The same law as `rig.control._wall` and `rig.control._guard`, which use SI units and floating point. The host scales the
integers; the device only multiplies them. Formats (explained in `rig.control._fixed_point`):

    depth      Q24.8, counts            direction · (count − reference) · 2^8 − surface
    velocity   format of the estimator, counts per velocity period; positive with rising counts
    gains      31 bits and a sign       stiffness in quanta per LSB of depth, damping in quanta per LSB of velocity
    sums       64 bits, `shift` fractional bits, in current quanta

Gains, sums and the constant effort all have `shift` fractional bits, so that the wall is two products, one sum and one
rounding to the nearest quantum. There is no slew limit: in a trial it may not act (`rig.control.step`).

Source: Koul et al., equation (1), rendered there by an FPGA in fixed point.
"""

import math
from typing import NamedTuple

from numba import types

from rig.control._fixed_point import GREATEST, NEAREST, Format, saturate, shift_right
from rig.control.estimators._fdm import count_difference
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel

DEPTH_WORD, DEPTH_BITS = 32, 8
DEPTH = Format(DEPTH_WORD, DEPTH_BITS)  # the kernel takes its two numbers
GAIN_GREATEST = 2**31 - 1
CURRENT_GREATEST = 2**15 - 1  # of the wire, symmetric
MOST_SHIFT = 40  # beyond which a gain of one quantum would not gain precision
PRECISION = 1e-3  # relative, of a gain that is not zero


class FixedWall(NamedTuple):
    """A wall, its constant effort and its effort limit as integers, for devices without floating point."""

    reference: int  # count at position zero
    direction: int  # ±1: the wall is entered with rising or falling counts
    side: int  # ±1: the wall is entered with rising or falling position; current is positive with position
    surface: int  # of the wall, from the reference along `direction`: counts · 2^8
    stiffness: int  # quanta per LSB of depth · 2^shift
    damping: int  # quanta per LSB of velocity · 2^shift
    may_pull: int  # 1: the wall may pull a handle that leaves it
    entry_only: int  # 1: damping acts on the way in only
    constant: int  # current of the constant effort: quanta · 2^shift
    limit: int  # quanta
    shift: int


WALL = types.NamedUniTuple(types.int64, len(FixedWall._fields), FixedWall)


@kernel(types.int64(types.int64, WALL), inline=True)
def depth(count: int, wall: FixedWall) -> int:
    """Return the penetration of the wall at an encoder count (counts · 2^8), saturated; positive inside the wall."""
    travel = wall.direction * count_difference(count, wall.reference)
    return saturate((travel << DEPTH_BITS) - wall.surface, DEPTH_WORD)


@kernel(types.int64(types.int64, types.int64, WALL), inline=True)
def reaction(penetration: int, velocity: int, wall: FixedWall) -> int:
    """Return the reaction of the wall, positive towards free space, in current quanta (smallest steps) · 2^shift.

    `penetration` is the result of `depth`; `velocity` is in LSB of the estimator's format, positive with rising counts.
    """
    if penetration <= 0:
        return 0
    inwards = wall.direction * velocity
    if wall.entry_only != 0 and inwards < 0:
        inwards = 0
    total = wall.stiffness * penetration + wall.damping * inwards
    if total < 0 and wall.may_pull == 0:
        return 0
    return total


@kernel(types.int64(types.int64, WALL), inline=True)
def limit_current(total: int, wall: FixedWall) -> int:
    """Return the current in quanta (smallest steps) for an effort in quanta · 2^shift: rounded, within ±limit."""
    quanta = shift_right(total, wall.shift, NEAREST)
    return min(max(quanta, -wall.limit), wall.limit)


@kernel(types.int64(types.int64, types.int64, WALL))
def current_quanta(count: int, velocity: int, wall: FixedWall) -> int:
    """Return the current to command (quanta of the wire protocol) at an encoder count: wall, constant effort, limit.

    The 32-bit counter may have wrapped. `velocity` is in counts per velocity period, in LSB of the estimator's format,
    positive with rising counts.
    """
    return limit_current(wall.constant - wall.side * reaction(depth(count, wall), velocity, wall), wall)


def design_wall(
    *,
    stiffness: float,
    damping: float,
    resolution: float,
    period_s: float,
    velocity: Format,
    effort_quantum: float,
    effort_limit: float,
    wall_position: float = 0.0,
    side: int = 1,
    constant_effort: float = 0.0,
    added_effort: float = 0.0,
    reference_count: int = 0,
    may_pull: bool = False,
    entry_only: bool = False,
) -> FixedWall:
    """Return the integers of a wall that is given in SI units.

    Parameters
    ----------
    stiffness, damping
        K and B (N·m/rad and N·m·s/rad, or N/m and N·s/m).
    resolution
        Travel for one count (rad or m), negative when counts fall while the position rises.
    period_s
        Velocity period T2 (s); `velocity` is in counts per period.
    velocity
        Format of the velocity that `current_quanta` receives (counts per period).
    effort_quantum
        Effort of one current quantum (N·m or N).
    effort_limit
        Largest effort of wall and constant effort together (N·m or N); rounded down to whole quanta.
    wall_position, side
        Surface of the wall from the reference (rad or m), and +1 when it is entered with rising position.
    constant_effort
        Effort added inside and outside the wall (N·m or N), positive with position.
    added_effort
        Largest magnitude of a further effort that the device adds (N·m or N); the sums have bits for it.
    reference_count
        Count at position zero.
    may_pull, entry_only
        True if the wall may pull; if damping acts on entry only.

    Raises
    ------
    ConfigError
        A value does not fit its word, or the relative error of a rounded gain exceeds `PRECISION`.
    """
    delta = abs(resolution)
    gains = {  # quanta per LSB
        "stiffness": stiffness * delta / effort_quantum * DEPTH.lsb,
        "damping": damping * delta / (effort_quantum * period_s) * velocity.lsb,
    }
    constant = constant_effort / effort_quantum
    # The factor makes 10.999… quanta 11: the quotient of two decimals is rounded.
    limit = math.floor(effort_limit / effort_quantum * (1.0 + 1e-12))
    if not 0 <= limit <= CURRENT_GREATEST:
        raise ConfigError(
            f"the effort limit {effort_limit:g} is {limit} current quanta; allowed are 0 to {CURRENT_GREATEST}",
            remedy="lower the effort limit or choose a larger current quantum (smallest step of the current)",
        )
    for name, value in (*gains.items(), ("constant effort", abs(constant))):
        if not 0.0 <= value <= GAIN_GREATEST:
            raise ConfigError(
                f"the {name} is {value:g} quanta (smallest steps of the current); allowed are 0 to {GAIN_GREATEST}",
                remedy="choose a softer wall",
            )
    shift = _greatest_shift(tuple(gains.values()), abs(constant) + added_effort / effort_quantum, velocity)
    whole = {name: _nearest(value, shift) for name, value in gains.items()}
    for name, value in gains.items():
        if abs(math.ldexp(whole[name], -shift) - value) > PRECISION * value:
            raise ConfigError(
                f"the {name} is {value:.3g} current quanta per LSB of depth or velocity, which {shift} fractional bits "
                f"can represent only as the integer {whole[name]}",
                remedy=f"raise the {name}, or choose a velocity format with fewer fractional bits",
            )
    return FixedWall(
        reference=reference_count,
        direction=side if resolution > 0.0 else -side,
        side=side,
        surface=DEPTH.quantised(side * wall_position / delta, "wall position in counts"),
        stiffness=whole["stiffness"],
        damping=whole["damping"],
        may_pull=int(may_pull),
        entry_only=int(entry_only),
        constant=_nearest(constant, shift),
        limit=limit,
        shift=shift,
    )


def _greatest_shift(gains: tuple[float, ...], added: float, velocity: Format) -> int:
    """Return the largest number of fractional bits, 1 to `MOST_SHIFT`, with which no gain and no sum overflows.

    Raises `ConfigError` if even one bit makes a gain or a sum overflow.
    """
    # Whatever the count and the velocity: the proof that the device needs no check of its sums.
    extremes = (DEPTH.limits[1], -velocity.limits[0])
    for shift in range(MOST_SHIFT, 0, -1):
        whole = [_nearest(gain, shift) for gain in gains]
        largest = sum(gain * extreme for gain, extreme in zip(whole, extremes, strict=True))
        if max(whole) <= GAIN_GREATEST and largest + _nearest(added, shift) + 2**shift <= GREATEST:
            return shift
    raise ConfigError(
        "sums of the wall in integers exceed 64 bits",
        remedy="choose a softer wall or a shorter word for the velocity",
    )


def _nearest(value: float, bits: int) -> int:
    return math.floor(math.ldexp(value, bits) + 0.5)
