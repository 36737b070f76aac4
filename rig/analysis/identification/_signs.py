"""Check with small pushes that a positive effort raises the position x, and by about the expected amount.

The effort of a push rises evenly until the handle has moved a little. Friction F holds the handle up to the breakaway
effort; then m·x″ = u − F − b·x′, with the commanded effort u (few steps, if the quantum of current is coarse). So m·(x
+ d·∫x dt) = ∬(u − F) dt², whose fit gives m and F; d = b/m is taken from the description, because a wrong scale of
effort or position does not change it. The result is accurate to some ten per cent: enough to detect a wrong torque
constant, a wrong ratio or a missing factor of four in the decoding.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import optimize
from rig.core.present import reported

Floats = NDArray[np.float64]

# A shorter travel may be noise.
LEAST_COUNTS = 2.0
# The fit begins after this share of a push's travel: earlier the inertia would depend on single counts.
SETTLED_SHARE = 0.25
SAME_SCALE = 3.0  # inertia within this factor of the expected one is as expected
FRICTIONS = 40  # that are tried, before the best of them is refined
ALIKE = 2.0  # squared misfit over that of the best friction, or of the counts' steps, up to which another fits as well
# Breakaway effort over sliding friction, from which stiction deserves a warning.
STICKS = 1.5
# Inertia right after a reversal over that of a second push in one direction, below which backlash is likely.
LOOSE = 0.5


@dataclass(frozen=True, slots=True)
class Push:
    """One push of the sign check and the handle's response: breakaway effort, travel and apparent inertia."""

    direction: Literal[-1, 1]
    moved: bool  # further than noise
    began_s: float  # fitted time from the start of the push to the start of motion; NaN if the fit cannot determine it
    seen: float  # way between the extreme positions, the brake included (rad or m, not negative)
    breakaway: float  # effort at the first motion (N·m or N, not negative); what was reached if nothing moved
    way: float  # signed (rad or m)
    inertia: float  # kg·m² or kg; NaN if the fit cannot determine it
    after_reversal: bool  # the push before went the other way


@dataclass(frozen=True, slots=True)
class SignCheck:
    """Result of `check_signs`: sign of the motion, inertia and breakaway efforts.

    Attributes
    ----------
    sign
        1 if the position rises with a positive effort, −1 if it falls, 0 if nothing moved or the pushes disagree.
    inertia
        Median of the inertia over the pushes (kg·m² or kg); NaN if no push determines it.
    scale
        `inertia` divided by the expected inertia.
    breakaway_up, breakaway_down
        Median effort at the first motion, by direction of the push (N·m or N); NaN if no push moved the handle.
    pushes
        Result of each push, in order of time.
    warnings
        Sentences about doubtful results, such as backlash, that a person should check.
    """

    sign: Literal[-1, 0, 1]
    inertia: float
    scale: float
    breakaway_up: float
    breakaway_down: float
    pushes: tuple[Push, ...]
    warnings: tuple[str, ...]

    @reported
    def ok(self) -> bool:
        """Return True if positive effort raises the position, and the inertia is roughly the expected one."""
        return self.sign == 1 and 1.0 / SAME_SCALE <= self.scale <= SAME_SCALE


def check_signs(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    *,
    resolution: float,
    expected_inertia: float,
    rest_s: float,
    damping: float = 0.0,
    friction: float | None = None,
) -> SignCheck:
    """Check signs and scale of a rig by pushes whose effort rises evenly from zero, with rests between the pushes.

    Parameters
    ----------
    time_s, effort, position
        Time (s), commanded effort (N·m or N) and position (rad or m) of the whole run, shape (n,), evenly sampled.
    resolution
        Travel for one count (rad or m).
    expected_inertia
        Inertia in the rig's description (kg·m² or kg).
    rest_s
        Time of zero effort that separates two pushes (s).
    damping
        Damping in the rig's description, back-EMF included (N·m·s/rad or N·s/m).
    friction
        Friction in the rig's description (N·m or N), used if the pushes do not determine it; None for the best fit.
    """
    pushes: list[Push] = []
    for first, last in _find_pushes(effort, max(1, round(rest_s / (time_s[1] - time_s[0])))):
        before = pushes[-1].direction if pushes else 0
        push = slice(first, last)
        pushes.append(
            _push(
                time_s[push],
                effort[push],
                position[push],
                resolution,
                damping / expected_inertia,
                friction,
                before,
            )
        )
    moved = [push for push in pushes if push.moved]
    agreement = {int(np.sign(push.way)) * push.direction for push in moved}
    sign: Literal[-1, 0, 1] = 0
    if len(agreement) == 1:
        sign = 1 if agreement == {1} else -1
    inertia = _median([push.inertia for push in moved])
    scale = inertia / expected_inertia
    return SignCheck(
        sign=sign,
        inertia=inertia,
        scale=scale,
        breakaway_up=_median([push.breakaway for push in moved if push.direction > 0]),
        breakaway_down=_median([push.breakaway for push in moved if push.direction < 0]),
        pushes=tuple(pushes),
        warnings=tuple(_warnings(pushes, moved, sign, scale)),
    )


def stiction_warning(breakaway: float, sliding: float) -> str | None:
    """Return a warning text if the breakaway effort far exceeds the sliding friction (both N·m or N), else None."""
    if not breakaway > STICKS * sliding:
        return None
    return (
        f"stiction: breaking away needs {breakaway:.3g} and sliding needs {sliding:.3g} N·m or N; with Coulomb "
        "friction alone both would be equal"
    )


def _find_pushes(effort: Floats, rest: int) -> list[tuple[int, int]]:
    busy = np.flatnonzero(effort != 0.0)
    if not len(busy):
        return []
    gaps = np.flatnonzero(np.diff(busy) > rest)
    firsts = [int(busy[0]), *(int(busy[g + 1]) for g in gaps)]
    lasts = [*(int(busy[g]) + 1 for g in gaps), int(busy[-1]) + 1]
    return list(zip(firsts, lasts, strict=True))


def _push(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    resolution: float,
    decay: float,
    friction: float | None,
    before: int,
) -> Push:
    direction: Literal[-1, 1] = 1 if effort[0] > 0.0 else -1
    push = direction * effort
    # A brake follows the push; its effort is never larger than that of the push.
    top = int(np.argmax(push)) + 1
    top += int(np.argmax(np.append(push[top:], -np.inf) < push[top - 1]))  # its last step, in coarse quanta
    way = position[:top] - position[0]
    away = np.flatnonzero(np.abs(way) >= LEAST_COUNTS * resolution)
    first = int(away[0]) if len(away) else top - 1
    inertia, began_s = _fit(time_s[:top], effort[:top], way, resolution, decay, friction)
    return Push(
        direction=direction,
        moved=abs(float(way[-1])) >= LEAST_COUNTS * resolution,
        began_s=began_s - float(time_s[0]),
        seen=float(np.ptp(position)),
        breakaway=abs(float(effort[first])),
        way=float(way[-1]),
        inertia=inertia,
        after_reversal=before == -direction,
    )


def _fit(
    time_s: Floats,
    effort: Floats,
    way: Floats,
    resolution: float,
    decay: float,
    expected_friction: float | None,
) -> tuple[float, float]:
    """Fit m·(x + d·∫x dt) = ∬(u − F) dt² to a push; return inertia m (kg·m² or kg) and start of motion (s), or NaN.

    `way` is the travel x, `effort` is u, `decay` is d (1/s); friction F is fitted. Only samples after the handle was
    last within `SETTLED_SHARE` of its travel are used.
    """
    step_s = time_s[1] - time_s[0]
    near = np.flatnonzero(np.abs(way) < SETTLED_SHARE * abs(way[-1]))
    since = slice(int(near[-1]) + 1 if len(near) else 0, None)
    if len(np.unique(way[since])) < 4:
        return math.nan, math.nan
    pushed, far = np.abs(effort), np.abs(way)
    seen = (far + decay * step_s * np.cumsum(far))[since]

    def given(friction: float) -> Floats:
        momentum = step_s * np.cumsum(np.maximum(pushed - friction, 0.0))
        return np.asarray(step_s * np.cumsum(momentum)[since])

    def excess(friction: float) -> float:
        action = given(friction)
        return float(np.sum((seen - action * (action @ seen) / (action @ action)) ** 2))

    most = float(pushed[np.flatnonzero(far > 0.0)[0]])
    grid = most * np.arange(FRICTIONS) / FRICTIONS
    best = grid[int(np.argmin([excess(friction) for friction in grid]))]
    bounds = (max(0.0, best - most / FRICTIONS), best + most / FRICTIONS)
    found = optimize.minimize_scalar(excess, bounds=bounds, method="bounded")
    friction = float(found.x)
    # Within one step of a coarse effort friction and inertia trade for each other: then the described friction decides.
    alike = ALIKE * max(float(found.fun), len(seen) * resolution**2 / 12.0)
    expected = friction if expected_friction is None else min(expected_friction, grid[-1])
    closer = np.linspace(expected, friction, FRICTIONS)
    friction = next((float(one) for one in closer if excess(one) <= alike), friction)
    action = given(friction)
    inertia = float((action @ action) / (action @ seen))
    return (inertia, float(time_s[np.argmax(pushed > friction)])) if inertia > 0.0 else (math.nan, math.nan)


def _warnings(pushes: list[Push], moved: list[Push], sign: int, scale: float) -> list[str]:
    found: list[str] = []
    if not moved:
        most = max((push.breakaway for push in pushes), default=0.0)
        found.append(
            f"the handle did not move with efforts of up to {most:.3g} N·m or N: check that the motor is connected "
            "and the handle is free"
        )
    elif sign == 0:
        found.append(
            "some pushes moved the handle in their direction, some against it: take all hands off the handle"
        )
    elif len(moved) < len(pushes):
        found.append(f"{len(pushes) - len(moved)} of {len(pushes)} pushes did not move the handle")
    if sign == -1:
        found.append("a positive effort lowers the position: encoder or motor are connected in reverse")
    if math.isfinite(scale) and not 1.0 / SAME_SCALE <= scale <= SAME_SCALE:
        found.append(
            f"the response to pushes shows {scale:.2g} times the described inertia: check the torque "
            "constant, the ratio and the decoding of the encoder"
        )
    turned = [push.inertia for push in moved if push.after_reversal and math.isfinite(push.inertia)]
    going_on = [push.inertia for push in moved[1:] if not push.after_reversal and math.isfinite(push.inertia)]
    if turned and going_on and max(turned) < LOOSE * min(going_on):
        found.append(
            "backlash: right after a reversal the apparent inertia is "
            f"{_median(turned) / _median(going_on):.2g} times that of motion in one direction"
        )
    return found


def _median(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan
