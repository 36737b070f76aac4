"""The measured curves: the stiffest stable wall of a haptic paddle at each damping, under four velocity estimators.

They come from a public file of a course, without attribution: no paper, no repeats, and nothing about the rig's
inertia, transmission, encoder or gains. The stiffness rose in rungs of 0.2 N/mm, so that neighbours of one rung are
ties, and the damping in steps of 0.002 N·s/mm. All four names carry "50hz", which is read as the cut-off of a filter.
"""

from __future__ import annotations

from collections.abc import Mapping

DIFFERENCE, FOAW, KALMAN, LEVANT = "difference", "FOAW", "Kalman", "Levant"
ESTIMATORS = (DIFFERENCE, FOAW, KALMAN, LEVANT)

RUNG = 200.0  # N/m
DAMPING_STEP = 2.0  # N·s/m
CUTOFF_HZ = 50.0

# K (N/m) from B = 0 on, in steps of `DAMPING_STEP`.
CURVES: Mapping[str, tuple[float, ...]] = {
    DIFFERENCE: (1800, 2400, 2800, 3000, 2400, 2200, 1800, 1200, 100),
    FOAW: (5400, 5800, 5800, 5400, 4800, 4400, 2400, 1600, 800, 200),
    KALMAN: (3000, 4000, 4000, 3800, 3200, 2400, 2000, 1200, 800, 400, 100),
    LEVANT: (5200, 5800, 6200, 6200, 5800, 5600, 5200, 4800, 4000, 3200, 2400, 800, 200),
}
COLUMNS = max(map(len, CURVES.values()))


def dampings(columns: int = COLUMNS) -> tuple[float, ...]:
    """Dampings of the first columns (N·s/m)."""
    return tuple(DAMPING_STEP * column for column in range(columns))


def measured(name: str, damping: float) -> float:
    """The curve of an estimator at one of its dampings (N/m); 0 beyond its end."""
    curve, column = CURVES[name], round(damping / DAMPING_STEP)
    return curve[column] if column < len(curve) else 0.0


def peak(name: str) -> float:
    """The stiffest wall of a curve (N/m)."""
    return max(CURVES[name])


def damping_range(name: str) -> float:
    """The largest damping with a stable wall (N·s/m)."""
    return DAMPING_STEP * (len(CURVES[name]) - 1)


def rung_ratio(stiffness: float) -> float:
    """By what factor a measured stiffness and its neighbour differ."""
    return (stiffness + RUNG) / stiffness
