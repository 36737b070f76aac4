"""Estimate an impedance and its variance from whole periods of a multisine excitation.

    impedance = periodic(runs)  # of rig.analysis.impedance._signals.ExcitedRun, one for each realisation
    impedance.z, impedance.deviation, impedance.residual

The excitation r is the instrument: Ẑ = S_rF/S_rV with V = jω·X. The records are whole periods, so no window is needed
and no power leaks between lines; only a steady drift of the position is removed. The variance is computed from the
scatter over realisations (the same lines with other phases). From the periods of a single realisation it is too small
if the rig has friction, because the distortion by friction repeats in each period.

Source of the estimator and its variance: the standard theory of instruments and of ratios (Pintelon and Schoukens,
"System Identification: A Frequency Domain Approach", chapters 2 and 4, from memory); the delta method is written out
below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.analysis.impedance._signals import Complexes, ExcitedRun, Floats
from rig.core.deferred import special
from rig.core.errors import ConfigError

VarianceFrom = Literal["realisations", "periods", "segments", "nothing"]


@dataclass(frozen=True, eq=False)
class Impedance:
    """Measured (or ideal) impedance at the excited frequencies ("lines"): effort over velocity at the handle.

    Attributes
    ----------
    lines_hz
        Frequencies of the spectral lines (Hz), shape (n,); each attribute "at each line" has this shape, too.
    z
        Complex impedance at each line (N·s/m or N·m·s/rad).
    variance
        Variance of z at each line, mean |Ẑ − Z|²: half in the real and half in the imaginary part. NaN if unknown.
    coherence_effort, coherence_motion
        Coherence γ² of effort and of velocity with the excitation at each line, over all periods of all realisations;
        NaN with a single period. For unrelated signals it is about 1/(periods · realisations), not 0.
    residual
        Share of the velocity's power within `residual_band_hz` that is not at the excited spectral lines; NaN if the
        record has no frequencies between the lines (a single period).
    residual_band_hz
        Lowest and highest frequency of the band in which `residual` was computed (Hz).
    realisations, periods
        Number of realisations, and number of periods of all realisations together.
    method
        Estimator: ``"periodic"``, ``"welch"`` or ``"welch-h1"``; ``"exact"`` or another name for a computed impedance.
    variance_from
        Repetitions whose scatter gives the variance: ``"realisations"``, ``"periods"`` (of a single realisation),
        ``"segments"`` (of Welch's method), or ``"nothing"`` if there is no scatter (exact, or a single period).
    degrees_of_freedom
        Degrees of freedom of the variance; infinite if the variance is exactly known (0) or unknown (NaN).
    """

    lines_hz: Floats
    z: Complexes
    variance: Floats
    coherence_effort: Floats
    coherence_motion: Floats
    residual: float
    realisations: int
    periods: int
    method: str
    residual_band_hz: tuple[float, float] = (math.nan, math.nan)
    variance_from: VarianceFrom = "nothing"
    degrees_of_freedom: float = math.inf

    @classmethod
    def exact(cls, lines_hz: Floats, z: Complexes, method: str = "exact") -> Impedance:
        """Return an impedance that is computed and not measured: variance 0, coherence 1, residual 0."""
        lines = np.asarray(lines_hz, dtype=np.float64)
        ones, none = np.ones(len(lines)), np.zeros(len(lines))
        return cls(lines, np.asarray(z, dtype=np.complex128), none, ones, ones, 0.0, 0, 0, method)

    @property
    def magnitude(self) -> Floats:
        """Return the magnitude |Z| of the impedance at each excited frequency (N·s/m or N·m·s/rad), shape (n,)."""
        return np.abs(self.z)

    @property
    def phase_deg(self) -> Floats:
        """Return the phase of the impedance at each excited frequency (degrees, −180 to 180), shape (n,)."""
        return np.asarray(np.degrees(np.angle(self.z)))

    @property
    def deviation(self) -> Floats:
        """Return the standard deviation of real part, imaginary part or magnitude at each spectral line (SI units)."""
        return np.sqrt(0.5 * self.variance)

    def spread(self, z_score: float) -> Floats:
        """Return the one-sided uncertainty of the real part (or magnitude) at each excited frequency, shape (n,).

        The unit is N·s/m or N·m·s/rad. `z_score` gives the confidence, in standard deviations of a normal distribution:
        2 means 97.7 %.
        """
        # With few realisations the variance is uncertain itself: Student's distribution in place of the normal one asks
        # for 2.5 deviations with four realisations instead of 2.
        if math.isinf(self.degrees_of_freedom):
            return z_score * self.deviation
        return -float(special.stdtrit(self.degrees_of_freedom, special.ndtr(-z_score))) * self.deviation

    def within(self, band: tuple[float, float] | None) -> Impedance:
        """Return the impedance at the spectral lines in a band (lowest, highest frequency in Hz); None: at every line.

        Raise `ConfigError` if no excited frequency lies in the band.
        """
        if band is None:
            return self
        low, high = band
        slack = 1e-9 * self.lines_hz
        inside = (self.lines_hz >= low - slack) & (self.lines_hz <= high + slack)
        if not inside.any():
            raise ConfigError(
                f"no excited frequency lies between {low:g} and {high:g} Hz",
                remedy=f"choose a band within {self.lines_hz.min():g} to {self.lines_hz.max():g} Hz",
            )
        names = ("lines_hz", "z", "variance", "coherence_effort", "coherence_motion")
        return replace(self, **{name: getattr(self, name)[inside] for name in names})


def periodic(runs: Sequence[ExcitedRun], *, residual_band_hz: tuple[float, float] | None = None) -> Impedance:
    """Estimate the impedance at each excited spectral line: Ẑ = S_rF/S_rV, with the excitation r as instrument.

    Parameters
    ----------
    runs
        One record for each realisation (draw of the phases), all with the same rate, period and spectral lines.
    residual_band_hz
        Band in which the residual power is computed (Hz); from the lowest to the highest line if left out.

    Returns
    -------
    Impedance
        With n ≥ 2 realisations, e_i = (F_i − Ẑ·V_i)·r_i* and Ẑ = Σ F_i·r_i*/Σ V_i·r_i*, the variance is
        Σ|e_i|²/(n·(n − 1))/|mean V_i·r_i*|². With one realisation, i counts its periods instead.

    Raises
    ------
    ConfigError
        No runs are given, or they differ in rate, period or lines.
    """
    first = same_lines(runs)
    lines = [_Lines.of(run) for run in runs]
    source: VarianceFrom = "realisations" if len(runs) > 1 else "periods"
    effort = _with_instrument(lines, "effort", source)
    motion = _with_instrument(lines, "velocity", source)
    # Both with the instrument: noise that is not correlated with r averages out. The plain ratio S_VF/S_VV ("H1", as
    # tfestimate) is biased low by noise of the velocity: |H|·S_vv/(S_vv + S_nn).
    n = len(effort)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = effort.mean(axis=0) / motion.mean(axis=0)
        error = np.sum(np.abs(effort - z * motion) ** 2, axis=0)
        variance = error / (n * (n - 1.0)) / np.abs(motion.mean(axis=0)) ** 2
    band = residual_band_hz or (float(first.lines_hz[0]), float(first.lines_hz[-1]))
    return Impedance(
        lines_hz=first.lines_hz.copy(),
        z=z,
        variance=variance if n > 1 else np.full(len(z), math.nan),
        coherence_effort=_coherence(lines, "effort"),
        coherence_motion=_coherence(lines, "velocity"),
        residual=residual_share(runs, band),
        realisations=len(runs),
        periods=sum(run.periods for run in runs),
        method="periodic",
        residual_band_hz=band,
        variance_from=source if n > 1 else "nothing",
        degrees_of_freedom=2.0 * (n - 1) if n > 1 else math.inf,
    )


def residual_share(runs: Sequence[ExcitedRun], band: tuple[float, float]) -> float:
    """Return the share of the velocity's power within a band (Hz) that is not at the excited lines, over all runs.

    A record of P periods has P − 1 frequencies between neighbouring harmonics. Power at these does not repeat with the
    excitation: chatter of an estimator, a limit cycle, noise. Return NaN if the band has no such frequencies (one
    period with every harmonic excited) or if nothing moves.
    """
    off = total = 0.0
    seen = False
    for run in runs:
        frequency = np.arange(len(run.position) // 2 + 1) * (run.rate_hz / len(run.position))
        power = np.abs(2.0 * np.pi * frequency * np.fft.rfft(run.level_position())) ** 2
        inside = (frequency >= band[0] * (1.0 - 1e-9)) & (frequency <= band[1] * (1.0 + 1e-9))
        excited = np.zeros(len(frequency), bool)
        excited[run.bins * run.periods] = True
        seen |= bool((inside & ~excited).any())
        off += float(power[inside & ~excited].sum())
        total += float(power[inside].sum())
    return off / total if seen and total > 0.0 else math.nan


@dataclass(frozen=True)
class _Lines:
    """Complex amplitudes of excitation, effort and velocity at the excited frequencies, shape (periods, lines)."""

    reference: Complexes
    effort: Complexes
    velocity: Complexes

    @classmethod
    def of(cls, run: ExcitedRun) -> _Lines:
        return cls(
            _transform(run, run.excitation),
            _transform(run, run.effort) * run.effort_gain(run.lines_hz),
            _transform(run, run.level_position()) * run.velocity_gain(run.lines_hz),
        )


def _transform(run: ExcitedRun, channel: Floats) -> Complexes:
    spectra = np.fft.rfft(channel.reshape(run.periods, run.period_samples), axis=1)
    return np.asarray(spectra[:, run.bins] * (2.0 / run.period_samples))


def _with_instrument(
    lines: Sequence[_Lines], channel: Literal["effort", "velocity"], of: VarianceFrom
) -> Complexes:
    """Return effort or velocity (`channel`) times the conjugate excitation at the excited frequencies.

    The result has a row for each realisation (run with other phases), or for each period of the only realisation.
    """
    # Coulomb friction's distortion repeats in every period: periods agree with each other while all are wrong alike.
    products = [np.asarray(getattr(one, channel) * one.reference.conj()) for one in lines]
    return np.stack([p.mean(axis=0) for p in products]) if of == "realisations" else products[0]


def _coherence(lines: Sequence[_Lines], channel: Literal["effort", "velocity"]) -> Floats:
    reference = np.concatenate([one.reference for one in lines])
    answer: NDArray[np.complex128] = np.concatenate([getattr(one, channel) for one in lines])
    if len(reference) < 2:
        return np.full(reference.shape[1], math.nan)
    cross = np.abs(np.mean(answer * reference.conj(), axis=0)) ** 2
    powers = np.mean(np.abs(reference) ** 2, axis=0) * np.mean(np.abs(answer) ** 2, axis=0)
    return np.asarray(np.divide(cross, powers, out=np.zeros_like(powers), where=powers > 0.0))


def same_lines(runs: Sequence[ExcitedRun]) -> ExcitedRun:
    """Return the first run; raise `ConfigError` unless all runs have the same rate, period and spectral lines."""
    if not runs:
        raise ConfigError(
            "no runs are given, so an impedance cannot be estimated", remedy="excite the rig at least once"
        )
    first = runs[0]
    for run in runs[1:]:
        if (
            run.rate_hz != first.rate_hz
            or run.period_samples != first.period_samples
            or not np.array_equal(run.bins, first.bins)
        ):
            raise ConfigError(
                "the runs differ in sampling rate, period or excited frequencies, which one estimate needs to be equal",
                remedy="group the runs by rate, period and frequencies, and estimate an impedance from each group",
            )
    return first
