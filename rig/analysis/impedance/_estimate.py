"""Impedance from whole periods of a multisine: a ratio of two lines, and how far it can be trusted.

    impedance = periodic(runs)  # of rig.analysis.impedance._signals.ExcitedRun, one for each realisation
    impedance.z, impedance.deviation, impedance.residual

The excitation r is the instrument: Ẑ = S_rF/S_rV with V = jω·X. Whole periods, so no window, no leakage, no detrending
but of a free rig's steady drift. Uncertainty comes from realisations, that is from other phases of the same lines; from
the periods of a single realisation (see `variance_from`) it is too small wherever friction is.

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
    """Measured (or ideal) impedance at the lines: effort over velocity at the handle.

    Attributes
    ----------
    lines_hz
        Frequencies (Hz), shape (n,); everything below with "each line" has this shape.
    z
        Impedance at each line, complex (N·s/m or N·m·s/rad).
    variance
        Variance of z at each line: mean |Ẑ − Z|², half in the real and half in the imaginary part. NaN if unknown.
    coherence_effort, coherence_motion
        γ² of effort and of velocity with the excitation at each line, over all periods of all realisations; NaN with
        a single period. A blind estimate of it is 1/(periods · realisations), not 0.
    residual
        Share of the motion's power (of velocity, in the band of `residual_band_hz`) off the excited lines; NaN where
        the record cannot show any.
    residual_band_hz
        Band in which the residual was counted.
    realisations, periods
        How many realisations went in, and periods of all of them together.
    method
        ``"periodic"``, ``"welch"``, ``"welch-h1"``, or what a closed form calls itself.
    variance_from
        Where the variance comes from: see the text of `rig.analysis.impedance._estimate`.
    degrees_of_freedom
        Degrees of freedom of the variance (real ones); infinite where it is exact.
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
        """Return an impedance that is known and not measured: no variance, full coherence, no residual."""
        lines = np.asarray(lines_hz, dtype=np.float64)
        ones, none = np.ones(len(lines)), np.zeros(len(lines))
        return cls(lines, np.asarray(z, dtype=np.complex128), none, ones, ones, 0.0, 0, 0, method)

    @property
    def magnitude(self) -> Floats:
        """Return |Z| at each line, shape (lines,)."""
        return np.abs(self.z)

    @property
    def phase_deg(self) -> Floats:
        """Return the phase at each line (degrees), −180 to 180: no unwrapping, because ±90° are what matters."""
        return np.asarray(np.degrees(np.angle(self.z)))

    @property
    def deviation(self) -> Floats:
        """Return the standard deviation of the real part at each line, of the imaginary part, and of the magnitude."""
        return np.sqrt(0.5 * self.variance)

    def spread(self, z_score: float) -> Floats:
        """Return the one-sided uncertainty of the real part (or |Z|) at each line, for the confidence of `z_score`.

        2 means 97.7 %.
        """
        # With few realisations the variance is uncertain itself: Student's distribution in place of the normal one asks
        # for 2.5 deviations with four realisations instead of 2.
        if math.isinf(self.degrees_of_freedom):
            return z_score * self.deviation
        return -float(special.stdtrit(self.degrees_of_freedom, special.ndtr(-z_score))) * self.deviation

    def within(self, band: tuple[float, float] | None) -> Impedance:
        """Return the lines of a band (Hz), ends included; all of them for None.

        Raises `ConfigError` when the band holds none.
        """
        if band is None:
            return self
        low, high = band
        slack = 1e-9 * self.lines_hz
        inside = (self.lines_hz >= low - slack) & (self.lines_hz <= high + slack)
        if not inside.any():
            raise ConfigError(
                f"no line lies between {low:g} and {high:g} Hz",
                remedy=f"choose a band within {self.lines_hz.min():g} to {self.lines_hz.max():g} Hz",
            )
        names = ("lines_hz", "z", "variance", "coherence_effort", "coherence_motion")
        return replace(self, **{name: getattr(self, name)[inside] for name in names})


def periodic(runs: Sequence[ExcitedRun], *, residual_band_hz: tuple[float, float] | None = None) -> Impedance:
    """Return the impedance by the ratio of lines, with the excitation as instrument.

    Parameters
    ----------
    runs
        One record for each realisation, all with the same rate, period and lines. Each should have other phases.
    residual_band_hz
        Band of the residual power; the excited one if left out.

    Returns
    -------
    Impedance
        With n ≥ 2 realisations, e_i = (F_i − Ẑ·V_i)·r_i* and Ẑ = Σ F_i·r_i*/Σ V_i·r_i*, the variance is
        Σ|e_i|²/(n·(n − 1))/|mean V_i·r_i*|². With one, the same over its periods.

    Raises
    ------
    ConfigError
        No runs, or runs that do not belong together.
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
    """Return the share of the velocity's power off the excited lines, between the ends of a band (Hz), over all runs.

    A transform of the whole record has bins between the lines: P periods put P − 1 of them between neighbours. What
    is there does not repeat with the excitation: chatter of an estimator, a limit cycle, noise. NaN for a band
    without such bins (a single period of a full grid) or without any motion.
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
    """Complex amplitudes at the lines, aligned, of shape (periods, lines)."""

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
    """Return products with the conjugate reference: a row for each realisation, or each period of the only one."""
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
    """Return the first of runs that have rate, period and lines in common; `ConfigError` if they have not."""
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
                "the runs have different rates, periods or lines",
                remedy="estimate an impedance from each kind of run separately",
            )
    return first
