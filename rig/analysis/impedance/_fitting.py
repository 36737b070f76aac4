"""Fit mass, damping and stiffness to a measured impedance by weighted least squares, with standard deviations.

    fit(impedance, ("inertia", "damping")).values  # a bare rig
    fit(impedance, ("stiffness", "damping"), subtract=RigidRig(0.52, 13.2))  # a wall without the rig's own impedance

The model m·jω + b + K/(jω) is linear in its parameters, so the fit needs no start values and cannot diverge. Each line
is weighted by the inverse of its standard deviation; if no variance is known, all spectral lines have the same weight.
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
    """A rigid rig: inertia (kg or kg·m²), viscous damping and damping by back-EMF (N·s/m or N·m·s/rad).

    The back-EMF acts behind a first-order lag with the time constant `lag_s` (s).
    """

    inertia: float
    damping: float
    back_emf: float = 0.0
    lag_s: float = 0.0

    def impedance(self, lines_hz: ArrayLike) -> Complexes:
        """Return the impedance m·jω + b + b_e/(1 + jω·lag) at the frequencies `lines_hz` (Hz)."""
        s = 2j * np.pi * np.asarray(lines_hz, dtype=np.float64)
        return np.asarray(self.inertia * s + self.damping + self.back_emf / (1.0 + self.lag_s * s))


@dataclass(frozen=True, slots=True)
class Fit:
    """Parameters that `fit` has fitted to an impedance, and their standard deviations.

    Attributes
    ----------
    values, deviations
        Parameters and their standard deviations by name, in SI units; terms that were not fitted are absent. The
        deviations follow from the variances of the spectral lines and are multiplied by `misfit` if it is above 1
        (Birge's ratio). If variances are unknown, the deviations follow from the misfit alone.
    misfit
        Root mean square of the differences between model and lines, in standard deviations of the lines: near 1 if the
        model is right, larger if the differences are more than noise. NaN without variances.
    """

    values: dict[Term, float]
    deviations: dict[Term, float]
    misfit: float

    @classmethod
    def unknown(cls, *terms: Term) -> Fit:
        """Return a result with NaN for the parameters `terms`, for a band with too few spectral lines to fit."""
        return cls(dict.fromkeys(terms, math.nan), dict.fromkeys(terms, math.nan), math.nan)


def fit(
    impedance: Impedance,
    terms: Sequence[Term] = ("inertia", "damping"),
    *,
    band: tuple[float, float] | None = None,
    subtract: Complexes | RigidRig | None = None,
) -> Fit:
    """Fit inertia m, damping b and stiffness K of the model m·jω + b + K/(jω) to an impedance by least squares.

    Parameters
    ----------
    impedance
        Measured impedance.
    terms
        Parameters to fit: any of ``"inertia"``, ``"damping"`` and ``"stiffness"``.
    band
        Lowest and highest frequency of the spectral lines to use (Hz); all spectral lines if left out.
    subtract
        Known part that is subtracted before the fit: a rigid rig, or complex values at all lines of `impedance`.

    Raises
    ------
    ConfigError
        No terms are given, a term is unknown, the band has no lines, or there are more terms than measured numbers.
    """
    names = tuple(dict.fromkeys(terms))
    if not names or set(names) - {"inertia", "damping", "stiffness"}:
        raise ConfigError(
            f"the parameters to fit are {', '.join(names) or 'missing'}; only three can be fitted",
            remedy="give one or more of: inertia, damping, stiffness",
        )
    part = impedance.within(band)
    z = part.z - _values_at_lines(part, impedance, subtract)
    weights = _weights(part.variance)
    sound = np.isfinite(z) & np.isfinite(weights)
    if 2 * int(sound.sum()) < len(names):
        raise ConfigError(
            f"only {int(sound.sum())} frequencies are usable to fit {len(names)} parameters (two need one)",
            remedy="excite more frequencies, or widen the band",
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
    residual = wanted - (rows / size) @ scaled
    free = len(wanted) - len(names)
    misfit = math.sqrt(float(residual @ residual) / free) if free > 0 else math.nan
    weighted = _has_variance(part.variance)
    covariance = np.linalg.pinv((rows / size).T @ (rows / size)) / np.outer(size, size)
    deviations = np.sqrt(np.diag(covariance)) * (max(1.0, misfit) if weighted and free > 0 else misfit)
    return Fit(
        values={name: float(v) for name, v in zip(names, scaled / size, strict=True)},
        deviations={name: float(v) for name, v in zip(names, deviations, strict=True)},
        misfit=misfit if weighted else math.nan,
    )


def _values_at_lines(part: Impedance, whole: Impedance, subtract: Complexes | RigidRig | None) -> Complexes:
    if subtract is None:
        return np.zeros(len(part.z), np.complex128)
    if isinstance(subtract, RigidRig):
        return subtract.impedance(part.lines_hz)
    values = np.asarray(subtract, dtype=np.complex128)
    if values.shape != whole.z.shape:
        raise ConfigError(
            f"the array to subtract has {values.size} values, but the impedance has {len(whole.z)} frequencies",
            remedy="give one complex value for each frequency, or a RigidRig",
        )
    return values[np.searchsorted(whole.lines_hz, part.lines_hz)]


def _has_variance(variance: Floats) -> bool:
    return bool((variance > 0.0).any()) and bool((np.isfinite(variance)).any())


def _weights(variance: Floats) -> Floats:
    """Return 1/(standard deviation) for each spectral line; with variance 0 the largest weight of the others."""
    if not _has_variance(variance):
        return np.ones(len(variance))
    usable = np.isfinite(variance) & (variance > 0.0)
    least = float(variance[usable].min())
    floored = np.where(variance == 0.0, least, variance)
    return np.asarray(1.0 / np.sqrt(0.5 * floored))


def _real(values: Complexes) -> Floats:
    return np.concatenate([values.real, values.imag])
