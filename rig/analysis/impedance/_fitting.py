"""Mass, damping and stiffness that a measured impedance stands for, by weighted least squares, with intervals.

    fit(impedance, ("inertia", "damping")).values  # a bare rig
    fit(impedance, ("stiffness", "damping"), subtract=Device(0.52, 13.2))  # a wall, the rig taken away

The model m·jω + b + K/(jω) is linear in its numbers, so there is nothing to start from and nothing to diverge. Each
line weighs by its variance; lines whose variance is unknown all weigh the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from rig.analysis.impedance._estimate import Impedance
from rig.analysis.impedance._signals import Complexes, Floats
from rig.core.errors import ConfigError

Term = Literal["inertia", "damping", "stiffness"]


@dataclass(frozen=True, slots=True)
class RigidRig:
    """Rigid rig: inertia (kg or kg·m²), viscous damping, and that of back-EMF behind a lag (N·s/m or N·m·s/rad; s)."""

    inertia: float
    damping: float
    back_emf: float = 0.0
    lag_s: float = 0.0

    def impedance(self, lines_hz: ArrayLike) -> Complexes:
        """m·jω + b + b_e/(1 + jω·lag) at these frequencies (Hz)."""
        s = 2j * np.pi * np.asarray(lines_hz, dtype=np.float64)
        return np.asarray(self.inertia * s + self.damping + self.back_emf / (1.0 + self.lag_s * s))


@dataclass(frozen=True, slots=True)
class Fit:
    """Numbers of the model and their standard deviations, by name; terms not asked for are absent.

    Attributes
    ----------
    values, deviations
        SI. Deviations are from the lines' variances, widened by a misfit above 1 (Birge's ratio: what the model does
        not explain is not known better than that); where variances are unknown, from the misfit alone.
    misfit
        Root mean square of the misfit per real number, in standard deviations of the lines: near 1 when the model
        holds; larger when noise is not all that is wrong. NaN without variances.
    """

    values: dict[Term, float]
    deviations: dict[Term, float]
    misfit: float

    @classmethod
    def unknown(cls, *terms: Term) -> Fit:
        """Return the fit of too few lines: all values NaN."""
        return cls(dict.fromkeys(terms, math.nan), dict.fromkeys(terms, math.nan), math.nan)


def fit(
    impedance: Impedance,
    terms: Sequence[Term] = ("inertia", "damping"),
    *,
    band: tuple[float, float] | None = None,
    subtract: Complexes | RigidRig | None = None,
) -> Fit:
    """Return the weighted least squares of m·jω + b + K/(jω) on an impedance.

    Parameters
    ----------
    impedance
        Measured impedance.
    terms
        Which of inertia, damping and stiffness to look for.
    band
        Lines to use (Hz); all if left out.
    subtract
        Known part that is not fitted: a rigid device, or an impedance at all lines of `impedance`.

    Raises
    ------
    ConfigError
        No terms or unknown ones, a band without lines, fewer numbers than terms.
    """
    names = tuple(dict.fromkeys(terms))
    if not names or set(names) - {"inertia", "damping", "stiffness"}:
        raise ConfigError(
            f"the terms to fit are {', '.join(names) or 'none'}",
            remedy="choose among inertia, damping and stiffness",
        )
    part = impedance.within(band)
    z = part.z - _at(part, impedance, subtract)
    weights = _weights(part.variance)
    sound = np.isfinite(z) & np.isfinite(weights)
    if 2 * int(sound.sum()) < len(names):
        raise ConfigError(
            f"only {int(sound.sum())} lines are usable to fit {len(names)} numbers",
            remedy="measure more lines, or widen the band",
        )
    s: Complexes = np.asarray(2j * np.pi * part.lines_hz[sound], dtype=np.complex128)
    columns: dict[Term, Complexes] = {
        "inertia": s,
        "damping": np.ones_like(s),
        "stiffness": np.asarray(1.0 / s),
    }
    rows = np.stack([_real(np.asarray(columns[name] * weights[sound])) for name in names], axis=1)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0.0] = 1.0
    wanted = _real(z[sound] * weights[sound])
    scaled, *_ = np.linalg.lstsq(rows / size, wanted, rcond=None)
    left = wanted - (rows / size) @ scaled
    free = len(wanted) - len(names)
    misfit = math.sqrt(float(left @ left) / free) if free > 0 else math.nan
    weighted = _has_variance(part.variance)
    covariance = np.linalg.pinv((rows / size).T @ (rows / size)) / np.outer(size, size)
    deviations = np.sqrt(np.diag(covariance)) * (max(1.0, misfit) if weighted and free > 0 else misfit)
    return Fit(
        values={name: float(v) for name, v in zip(names, scaled / size, strict=True)},
        deviations={name: float(v) for name, v in zip(names, deviations, strict=True)},
        misfit=misfit if weighted else math.nan,
    )


def _at(part: Impedance, whole: Impedance, subtract: Complexes | RigidRig | None) -> Complexes:
    if subtract is None:
        return np.zeros(len(part.z), np.complex128)
    if isinstance(subtract, RigidRig):
        return subtract.impedance(part.lines_hz)
    values = np.asarray(subtract, dtype=np.complex128)
    if values.shape != whole.z.shape:
        raise ConfigError(
            f"{values.size} values to subtract from {len(whole.z)} lines",
            remedy="give one value for each line",
        )
    return values[np.searchsorted(whole.lines_hz, part.lines_hz)]


def _has_variance(variance: Floats) -> bool:
    return bool((variance > 0.0).any()) and bool((np.isfinite(variance)).any())


def _weights(variance: Floats) -> Floats:
    """Return one over the deviation of each real number; a line of variance zero weighs like the best of the others."""
    if not _has_variance(variance):
        return np.ones(len(variance))
    usable = np.isfinite(variance) & (variance > 0.0)
    least = float(variance[usable].min())
    floored = np.where(variance == 0.0, least, variance)
    return np.asarray(1.0 / np.sqrt(0.5 * floored))


def _real(values: Complexes) -> Floats:
    return np.concatenate([values.real, values.imag])
