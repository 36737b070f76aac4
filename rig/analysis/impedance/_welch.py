"""Estimate an impedance by Welch's averaged spectra, with the settings of MATLAB's tfestimate.

The second paper (Chawda et al.) measured impedances in this way. Use it to compare with the paper and for records that
are not periodic; `rig.analysis.impedance._estimate.periodic` is better for a multisine. The defaults are those of
tfestimate: Hamming window, eight segments that overlap by half (so of length N/4.5), a transform of max(256, next power
of two), no detrending. Those of `scipy.signal.csd` differ (Hann, 256 samples, mean removed). Source: MathWorks,
documentation of tfestimate and spectrum.welch.

The transform's frequencies are not those of the spectral lines: with N = 16 000 samples at 4 kHz a segment has 0.9 s,
and the power of lines 1 Hz apart leaks from one line into the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rig.analysis.impedance._estimate import Impedance, residual_share, same_lines
from rig.analysis.impedance._signals import Complexes, ExcitedRun, Floats
from rig.core.deferred import signal
from rig.core.errors import ConfigError

SEGMENTS = 8  # of tfestimate
SMALLEST_TRANSFORM = 256  # of tfestimate


@dataclass(frozen=True, slots=True)
class WelchSettings:
    """Settings of Welch's averaged spectra: window, segments, transform and estimator.

    Attributes
    ----------
    window
        Name of the window for `scipy.signal.get_window`.
    segment_s
        Length of a segment (s); None for the length with which eight overlapping segments fill the record.
    overlap
        Share of a segment that the next segment repeats, 0 to below 1.
    transform_samples
        Length of the zero-padded transform; None for max(256, next power of two).
    estimator
        ``"h1"``: S_VF/S_VV with velocity as input, as tfestimate and the paper; ``"instrument"``: S_rF/S_rV with the
        excitation r as instrument.
    """

    window: str = "hamming"
    segment_s: float | None = None
    overlap: float = 0.5
    transform_samples: int | None = None
    estimator: Literal["h1", "instrument"] = "h1"

    def segment(self, samples: int, rate_hz: float) -> int:
        """Return the number of samples in a segment, for a record of `samples` samples at `rate_hz` (Hz)."""
        if self.segment_s is None:
            return max(1, int(samples / (SEGMENTS - (SEGMENTS - 1) * self.overlap)))
        return min(samples, max(1, round(self.segment_s * rate_hz)))

    def transform(self, segment: int) -> int:
        """Return the length of a segment's Fourier transform: as set, or a power of two, at least 256 and `segment`."""
        return self.transform_samples or max(SMALLEST_TRANSFORM, 1 << (segment - 1).bit_length())


TFESTIMATE = WelchSettings()


def estimate_welch(
    runs: Sequence[ExcitedRun],
    settings: WelchSettings = TFESTIMATE,
    *,
    residual_band_hz: tuple[float, float] | None = None,
) -> Impedance:
    """Return the impedance from averaged spectra, at the transform's frequencies from the lowest to the highest line.

    Parameters
    ----------
    runs
        Records with the same rate, period and spectral lines; their spectra are averaged.
    settings
        Window, segments and estimator; the defaults are those of tfestimate.
    residual_band_hz
        Band in which the residual power is computed (Hz); from the lowest to the highest line if left out.

    Returns
    -------
    Impedance
        `lines_hz` are the transform's frequencies. The variance is that of averaged spectra of noise,
        S_ee·S_uu/(n·|S_uv|²) with u the velocity or the instrument, v the velocity, S_ee the power of F − Ẑ·V and n the
        number of independent segments after overlap (Welch 1967); for H1 that is |Ẑ|²·(1 − γ²)/(n·γ²). Power that leaks
        from one line into another counts as noise.

    Raises
    ------
    ConfigError
        No runs are given, the runs differ in rate, period, lines or length, the overlap is out of range, or no
        frequency of the transform lies in the band.
    """
    first = same_lines(runs)
    if not 0.0 <= settings.overlap < 1.0:
        raise ConfigError(
            f"an overlap of {settings.overlap:g} is out of range: 0 or more and less than 1 is allowed",
            remedy="give the share of a segment that the next segment repeats, such as 0.5",
        )
    spectra = [_Spectra.of(run, settings) for run in runs]
    grid = spectra[0].frequency
    if any(len(one.frequency) != len(grid) for one in spectra):
        raise ConfigError(
            "the runs have different lengths, so their transforms cannot be averaged",
            remedy="give transform_samples, or runs of one length",
        )
    low, high = float(first.lines_hz[0]), float(first.lines_hz[-1])
    inside = (grid >= low * (1.0 - 1e-9)) & (grid <= high * (1.0 + 1e-9))
    if not inside.any():
        raise ConfigError(
            f"no frequency of the transform lies between {low:g} and {high:g} Hz",
            remedy="give a longer record or transform",
        )
    ff, vv, rr, vf, rf, rv = (
        sum((getattr(one, name)[inside] for one in spectra), np.zeros(int(inside.sum())))
        for name in ("ff", "vv", "rr", "vf", "rf", "rv")
    )
    independent = sum(one.independent for one in spectra)
    into, across, out = (vv, vv, vf) if settings.estimator == "h1" else (rr, rv, rf)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = out / across
        error = np.maximum(ff + np.abs(z) ** 2 * vv - 2.0 * np.real(z.conj() * vf), 0.0)
        variance = error * into / (independent * np.abs(across) ** 2)
        coherences = [np.abs(cross) ** 2 / (rr * power) for cross, power in ((rf, ff), (rv, vv))]
    band = residual_band_hz or (low, high)
    several = independent > 1.0
    return Impedance(
        lines_hz=grid[inside],
        z=z,
        variance=np.asarray(variance) if several else np.full(len(z), math.nan),
        coherence_effort=np.nan_to_num(coherences[0]),
        coherence_motion=np.nan_to_num(coherences[1]),
        residual=residual_share(runs, band),
        realisations=len(runs),
        periods=sum(run.periods for run in runs),
        method="welch-h1" if settings.estimator == "h1" else "welch",
        residual_band_hz=band,
        variance_from="segments" if several else "nothing",
        degrees_of_freedom=2.0 * (independent - 1.0) if several else math.inf,
    )


def align_signals(run: ExcitedRun) -> tuple[Floats, Floats, Floats]:
    """Return excitation, effort and velocity of a run over time, all at the instants of its samples, shape (n,).

    Delays, hold and derivative are applied to the transform of the whole record, which is exact for a periodic record.
    """
    samples = len(run.position)
    frequency: Floats = np.arange(samples // 2 + 1) * np.float64(run.rate_hz / samples)

    def through(channel: Floats, gain: Complexes) -> Floats:
        spectrum = np.fft.rfft(channel) * gain
        if samples % 2 == 0:
            spectrum[-1] = 0.0  # half the rate has no phase to shift
        return np.fft.irfft(spectrum, samples)

    return (
        run.excitation,
        through(run.effort, run.effort_gain(frequency)),
        through(run.level_position(), run.velocity_gain(frequency)),
    )


@dataclass(frozen=True)
class _Spectra:
    """Averaged spectra (S_xy = mean of X*·Y) of effort f, velocity v, excitation r; number of independent segments."""

    frequency: Floats
    ff: Floats
    vv: Floats
    rr: Floats
    vf: Complexes
    rf: Complexes
    rv: Complexes
    independent: float

    @classmethod
    def of(cls, run: ExcitedRun, settings: WelchSettings) -> _Spectra:
        r, f, v = align_signals(run)
        length = settings.segment(len(r), run.rate_hz)
        overlap = int(settings.overlap * length)
        window = signal.get_window(settings.window, length, fftbins=False)
        transform = max(settings.transform(length), length)

        def cross(x: Floats, y: Floats) -> Complexes:
            return np.asarray(
                signal.csd(
                    x, y, fs=run.rate_hz, window=window, noverlap=overlap, nfft=transform, detrend=False
                )[1]
            )

        frequency: Floats = np.arange(transform // 2 + 1) * np.float64(run.rate_hz / transform)
        count = 1 + (len(r) - length) // (length - overlap)
        return cls(
            frequency,
            cross(f, f).real,
            cross(v, v).real,
            cross(r, r).real,
            cross(v, f),
            cross(r, f),
            cross(r, v),
            _independent(window, length - overlap, count),
        )


def _independent(window: Floats, step: int, count: int) -> float:
    """Return the equivalent number of independent segments among `count` segments that overlap.

    The number is n/(1 + 2·Σ (1 − k/n)·ρ_k), with n = `count` and ρ_k the squared correlation of the window with itself,
    shifted by k·`step` samples. Source: Welch, IEEE Trans. Audio Electroacoust. 15 (1967), 70.
    """
    power = float(np.sum(window**2))
    total = 1.0
    for k in range(1, count):
        shift = k * step
        if shift >= len(window):
            break
        share = float(np.sum(window[shift:] * window[:-shift])) / power
        total += 2.0 * (1.0 - k / count) * share**2
    return count / total
