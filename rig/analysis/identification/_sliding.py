"""Fit Coulomb friction for each direction and viscous damping to strokes at constant speeds.

At constant speed the motor's effort is friction alone: up + b·v for v > 0, −down + b·v for v < 0. Under voltage drive
this effort is the command minus the back-EMF, whose damping must be given: no motion separates it from viscous damping.
A constant external effort (weight, a bent cable) adds to one level and subtracts from the other, and sliding cannot
separate it from friction that differs by direction. So only the levels up and down are measured; `coulomb` is half of
up + down, `bias` half of up − down.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.analysis.identification._interval import Interval, quantile
from rig.analysis.identification._quality import IdentificationError
from rig.core.present import reported

Floats = NDArray[np.float64]

# The beginning of a stroke is excluded: this long, or this share of it if that is shorter.
SETTLE_S, SETTLE_SHARE = 0.2, 0.6
END_S = 0.01  # so is its end
PIECES = 3  # of each stroke
# Shortest travel in a piece of a stroke (counts).
LEAST_COUNTS = 10.0
# Largest scatter about the fitted line, over the largest effort.
LARGEST_SCATTER = 0.3
# By how much of its way a piece may differ from the stroke that was asked for, one count aside. With this the interval
# held the damping of 104 simulated rigs of 106 (9 presets with coarser encoders, 52 random data sheets, rates of 1 to 4
# kHz; 2026-11-29). Before it held 83 of 108, and in every tenth the damping was wrong by more than 156 %, now 31 %.
UNSTEADY = 0.03


@dataclass(frozen=True, slots=True)
class Stroke:
    """A commanded motion at constant speed: its begin and end (s) and its velocity (rad/s or m/s)."""

    begin_s: float
    end_s: float
    velocity: float


@dataclass(frozen=True, eq=False)
class Sliding:
    """Friction of a handle that slides at constant speed, as fitted by `fit_sliding`.

    Attributes
    ----------
    up, down
        Coulomb friction against rising and against falling position (N·m or N, positive).
    damping
        Viscous damping without back-EMF (N·m·s/rad or N·s/m).
    coulomb, bias
        Half of up + down, and half of up − down (N·m or N).
    velocity, effort
        Points of the fit: mean velocity (rad/s or m/s) and effort (N·m or N) of each piece of a stroke, shape (n,).
    scatter
        Rms distance of the points from the fitted line (N·m or N).
    correlation
        Correlation of the errors of `coulomb` and `damping`, −1 to 1: a steeper line starts lower.
    """

    up: Interval
    down: Interval
    damping: Interval
    coulomb: Interval
    bias: Interval
    velocity: Floats = field(repr=False)
    effort: Floats = field(repr=False)
    scatter: float
    correlation: float = 0.0

    @reported
    def points(self) -> int:
        """Return the number of points in the friction fit, each the mean over a piece of a stroke."""
        return len(self.velocity)

    def at(self, velocity: Floats) -> Floats:
        """Return the effort (N·m or N) that overcomes friction at each velocity (rad/s or m/s)."""
        level = np.where(velocity > 0.0, self.up.value, -self.down.value)
        return np.asarray(level + self.damping.value * velocity)


def fit_sliding(
    time_s: Floats,
    effort: Floats,
    position: Floats,
    strokes: Sequence[Stroke],
    *,
    resolution: float,
    back_emf: float = 0.0,
) -> Sliding:
    """Fit Coulomb friction and viscous damping to strokes at constant speeds.

    Parameters
    ----------
    time_s, effort, position
        Time (s), commanded effort (N·m or N) and position (rad or m) of the whole run, shape (n,), evenly sampled; the
        times of `strokes` have the same origin.
    strokes
        Commanded strokes, in both directions and at two speeds or more.
    resolution
        Travel for one count (rad or m).
    back_emf
        Damping by back-EMF under voltage drive (N·m·s/rad or N·s/m).

    Raises
    ------
    IdentificationError
        Too few strokes kept their speed, a direction or a second speed is missing, or the points scatter too much about
        the line.
    """
    velocity, level = _points(time_s, effort, position, strokes, resolution)
    level = level - back_emf * velocity
    rising = velocity > 0.0
    if rising.sum() < 2 or (~rising).sum() < 2 or len(np.unique(np.round(velocity, 12))) < 3:
        raise IdentificationError(
            f"parts of the strokes that moved at the requested speed: {int(rising.sum())} in the positive direction, "
            f"{int((~rising).sum())} in the negative; at least two in each are needed, at two different speeds",
            remedy="keep everything off the handle; a wider window of positions makes the strokes longer, and a "
            "higher sampling rate (`rate`) allows a stiffer position control during the strokes",
        )
    # level = coulomb·sign(v) + bias + damping·v
    matrix = np.column_stack([np.sign(velocity), np.ones(len(level)), velocity])
    solution = np.linalg.lstsq(matrix, level, rcond=None)[0]
    residual = level - matrix @ solution
    freedom = len(level) - matrix.shape[1]
    # Friction varies with position, and with a coarse encoder the servo's effort has ripple: scatter about the line
    # gives the intervals. The pieces of a stroke are independent points for the Coulomb friction alone, in which errors
    # that depend on position cancel between the directions. For bias and slope they are correlated, and all pieces of a
    # stroke count as one: as independent points, the interval held the bias beside cogging in 164 runs of a test (now
    # 190 of 200) and the damping of 35 rigs of 40 (now 99 of 100, `tests.benchmarks.identified_intervals`, 2026-11-29).
    covariance = float(residual @ residual) / max(freedom, 1) * np.linalg.inv(matrix.T @ matrix)
    points = np.sqrt([1.0, PIECES, PIECES])
    covariance *= np.outer(points, points)
    factor = quantile(freedom)
    scale = float(np.sqrt(covariance[0, 0] * covariance[2, 2]))

    def interval(*weights: float) -> Interval:
        w = np.asarray(weights)
        return Interval(float(w @ solution), factor * float(np.sqrt(w @ covariance @ w)))

    fit = Sliding(
        up=interval(1.0, 1.0, 0.0),
        down=interval(1.0, -1.0, 0.0),
        damping=interval(0.0, 0.0, 1.0),
        coulomb=interval(1.0, 0.0, 0.0),
        bias=interval(0.0, 1.0, 0.0),
        velocity=velocity,
        effort=level,
        scatter=float(np.sqrt(np.mean(residual**2))),
        correlation=float(covariance[0, 2]) / scale if scale > 0.0 else 0.0,
    )
    largest = float(np.abs(level).max())
    if fit.scatter > LARGEST_SCATTER * largest:
        raise IdentificationError(
            f"the effort of sliding scatters by {fit.scatter:.3g} N·m or N about the fitted line; at most "
            f"{LARGEST_SCATTER * largest:.3g} ({LARGEST_SCATTER:.0%} of the largest effort) is allowed",
            remedy="slide more slowly, so that the servo follows, and look in the plot for positions at which a "
            "part of the mechanism sticks",
        )
    return fit


def _points(
    time_s: Floats, effort: Floats, position: Floats, strokes: Sequence[Stroke], resolution: float
) -> tuple[Floats, Floats]:
    velocities, efforts = [], []
    for stroke in strokes:
        begin = stroke.begin_s + min(SETTLE_S, SETTLE_SHARE * (stroke.end_s - stroke.begin_s))
        chosen = np.flatnonzero((time_s >= begin) & (time_s < stroke.end_s - END_S))
        for piece in np.array_split(chosen, PIECES):
            if len(piece) < 2:
                continue
            way = position[piece[-1]] - position[piece[0]]
            elapsed_s = time_s[piece[-1]] - time_s[piece[0]]
            asked = stroke.velocity * elapsed_s
            if abs(way - asked) > UNSTEADY * abs(asked) + resolution or abs(way) < LEAST_COUNTS * resolution:
                continue
            velocities.append(way / elapsed_s)
            efforts.append(effort[piece].mean())
    return np.array(velocities), np.array(efforts)
