"""Estimate the encoder's scale before and after the first contact, from the motor's effort and the measured motion.

`rig.experiments.trials.judgement` calls this module. A rigid mass with the described friction must gain the momentum
that the effort gives it, inside a wall and outside. If the ratio of measured to predicted motion differs before and
after the contact, the encoder's scale changed during the trial. The method does not work with a hand at the handle,
whose effort is not measured, and cannot detect a constant drift.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WINDOW_S = 0.01
# A ratio above this factor, or below its inverse, means a changed scale: the geometric mean of 1 and 2. In 200 trials
# of intact rigs the ratio was 0.86 to 1.17 (8 presets, 2026-11-29).
FACTOR = 1.4
# A scale is used only if half a count in every sample changes it by at most this much.
MOST_DOUBT = 0.5
# Tested friction relative to the described friction, whose uncertainty after an identification is 50 %.
FRICTIONS = (1.0, 0.5, 1.5)
# If the handle moves by fewer counts in a window, the direction of friction is unknown.
FRICTION_SPEED_COUNTS = 2.0


@dataclass(frozen=True, slots=True)
class MotionScale:
    """Measured over predicted motion (1: the encoder's scale is right), and the error by half a count per sample."""

    value: float
    doubt: float


@dataclass(frozen=True, slots=True)
class MotionBalance:
    """A comparison of the encoder's scale (measured over predicted motion) before and after the first contact.

    Attributes
    ----------
    before, after
        Scale before and after the contact, computed with the described friction; None without motion.
    least, most
        Smallest and largest value of `ratio` if friction is up to 50 % lower or higher than described; None if a scale
        is too uncertain.
    """

    before: MotionScale | None
    after: MotionScale | None
    least: float | None
    most: float | None

    @property
    def ratio(self) -> float | None:
        """Return the encoder's scale after the contact over the scale before it; None if one is too uncertain."""
        return _ratio(self.before, self.after)

    @property
    def changed(self) -> bool:
        """Return True if the encoder's scale changed in the trial; False if not, or if a scale is too uncertain."""
        if self.least is None or self.most is None:
            return False
        return self.least > FACTOR or self.most < 1.0 / FACTOR


def _ratio(before: MotionScale | None, after: MotionScale | None) -> float | None:
    # A resting handle shows no scale: the path must be curved by enough counts before and after the contact.
    if before is None or after is None or max(before.doubt, after.doubt) > MOST_DOUBT or before.value <= 0.0:
        return None
    return after.value / before.value


def motion_balance(
    position: Floats,
    effort: Floats,
    contact: int,
    *,
    tick_s: float,
    resolution: float,
    inertia: float,
    coulomb: float,
    damping: float,
) -> MotionBalance:
    """Compute the encoder's scale (measured over predicted motion) before and after the first contact.

    Parameters
    ----------
    position, effort
        Measured position (rad or m) and applied effort (N·m or N) of every tick of the push; no tick may be missing.
    contact
        Index of the tick of the first contact.
    tick_s, resolution
        Period of the loop (s), and size of one encoder count (rad or m).
    inertia, coulomb, damping
        Described inertia, Coulomb friction and viscous damping of motor and link together (kg·m² or kg, N·m or N,
        N·m·s/rad or N·s/m).
    """
    # In each window the position is x0 + v0·t + s·g(t), where g is the second integral of (effort − friction) divided
    # by the described inertia, and s is the encoder's scale times described over true inertia.
    length = max(8, round(WINDOW_S / tick_s))
    found: list[tuple[MotionScale | None, MotionScale | None]] = []
    for share in FRICTIONS:
        bend, path = _windows(position, effort, length, tick_s, resolution, inertia, share * coulomb, damping)
        last = np.arange(len(bend)) * (length // 2) + length
        # Before the contact use only the first half of the time from release to contact, but at least one window. An
        # error of the described inertia changes both scales, and hardly their ratio.
        early, late = last <= max(length, contact // 2), last - length >= contact
        found.append(
            (_scale(bend[early], path[early], resolution), _scale(bend[late], path[late], resolution))
        )
    before, after = found[0]
    if _ratio(before, after) is None:
        return MotionBalance(before, after, None, None)
    ratios = [late.value / early.value for early, late in found if early and late and early.value > 0.0]
    return MotionBalance(before, after, min(ratios), max(ratios))


def _scale(bend: Floats, path: Floats, resolution: float) -> MotionScale | None:
    power = float(np.sum(np.square(bend)))
    if power == 0.0:
        return None
    return MotionScale(
        float(np.sum(bend * path)) / power, 0.5 * resolution * float(np.sum(np.abs(bend))) / power
    )


def _windows(
    position: Floats,
    effort: Floats,
    length: int,
    tick_s: float,
    resolution: float,
    inertia: float,
    coulomb: float,
    damping: float,
) -> tuple[Floats, Floats]:
    """Return predicted and measured motion in half-overlapping time windows, (windows, length), trends removed."""
    view = np.lib.stride_tricks.sliding_window_view
    if len(position) < length:
        return np.zeros((0, length)), np.zeros((0, length))
    x, f = view(position, length)[:: length // 2], view(effort, length)[:: length // 2]
    third = max(2, length // 3)
    way = np.zeros_like(x)
    way[:, third:-third] = x[:, 2 * third :] - x[:, : -2 * third]
    way[:, :third], way[:, -third:] = way[:, third : third + 1], way[:, -third - 1 : -third]
    moving = np.abs(way) >= FRICTION_SPEED_COUNTS * resolution
    force = f - coulomb * np.where(moving, np.sign(way), np.clip(f / max(coulomb, 1e-300), -1.0, 1.0))
    predicted = np.cumsum(np.cumsum(force / inertia, axis=1), axis=1) * tick_s**2
    measured = x + damping / inertia * np.cumsum(x - x[:, :1], axis=1) * tick_s
    return _remove_trend(predicted), _remove_trend(measured)


def _remove_trend(rows: Floats) -> Floats:
    t = np.linspace(-1.0, 1.0, rows.shape[1])
    rows = rows - rows.mean(axis=1, keepdims=True)
    return rows - np.outer(rows @ t / (t @ t), t)
