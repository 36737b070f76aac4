"""Multisines: efforts that excite a rig to measure its impedance, as sums of cosines at multiples of 1/period.

    multisine = Multisine.schroeder((1.0, 250.0), period_s=1.0, rms=2.0)
    multisine.crest_factor, multisine.peak
    effort = multisine.period(16_000, offset=0.5)  # one period, at the middle of each step

A multisine repeats exactly, so a spectrum of whole periods needs no window (`rig.analysis.impedance`). Schroeder's
phases give a small crest factor; random phases, drawn for each realisation, turn the distortion by friction from a bias
of the impedance into a scatter that averages out. Efforts are in N·m or N, times in s, frequencies in Hz.

Identification, measurements of impedance and excited laws (`rig.control.bilateral`) use it. It must not simulate or
read a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.core.errors import ConfigError
from rig.core.present import reported

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Spectrum = Literal["flat", "mass"] | Sequence[float] | Floats
ImpedanceModel = Callable[[Floats], ArrayLike] | ArrayLike

ON_GRID = 1e-6  # of a line spacing, or of a sample: by how much a whole number may be missed
OVERSAMPLING = 16  # points for each period of the highest line, where a peak is looked for


@dataclass(frozen=True, slots=True)
class Peak:
    """Largest expected effort, position or velocity under an excitation, and its limit (or None), in SI units."""

    name: str
    quantity: Literal["effort", "position", "velocity"]
    value: float
    limit: float | None

    @reported
    def holds(self) -> bool:
        """Return True if the largest value is finite and within its limit."""
        return math.isfinite(self.value) and (self.limit is None or self.value <= self.limit)


@dataclass(frozen=True, eq=False)
class Multisine:
    """A sum of cosines, Σ amplitude · cos(2π·line·t + phase), at multiples of 1/period.

    Attributes
    ----------
    period_s
        Period (s); the spectral lines are multiples of its inverse.
    lines_hz
        Excited frequencies (Hz), ascending, shape (n,).
    amplitudes
        Peak of each spectral line (N·m or N; rad, m, rad/s or m/s for a motion that `through` returns), shape (n,).
    phases
        Phase of each cosine at time 0 (rad), shape (n,).

    Raises
    ------
    ConfigError
        No lines, lines that are not ascending multiples of 1/period, or arrays of different lengths.
    """

    period_s: float
    lines_hz: Floats
    amplitudes: Floats
    phases: Floats

    def __post_init__(self) -> None:
        for name in ("lines_hz", "amplitudes", "phases"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64).reshape(-1))
        if not (math.isfinite(self.period_s) and self.period_s > 0.0):
            raise ConfigError(
                f"period_s = {self.period_s!r} s is not a valid period: it must be above 0 and finite",
                remedy="give a period above 0 s",
            )
        n = len(self.lines_hz)
        if n == 0 or len(self.amplitudes) != n or len(self.phases) != n:
            raise ConfigError(
                f"the multisine has {n} lines, but {len(self.amplitudes)} amplitudes and {len(self.phases)} phases",
                remedy="give one amplitude and one phase for each line, and at least one line",
            )
        if not all(np.isfinite(a).all() for a in (self.lines_hz, self.amplitudes, self.phases)):
            raise ConfigError(
                "a frequency, an amplitude or a phase of the multisine is not a finite number",
                remedy="give finite numbers",
            )
        off = np.abs(self.lines_hz * self.period_s - self.harmonics)
        if self.harmonics[0] < 1 or (np.diff(self.harmonics) < 1).any() or off.max() > ON_GRID:
            raise ConfigError(
                f"the lines (Hz) of the multisine are not ascending multiples of 1/period, {1.0 / self.period_s:g} Hz",
                remedy="choose ascending multiples of 1/period, or another period",
            )

    @classmethod
    def schroeder(
        cls,
        band: tuple[float, float],
        period_s: float = 1.0,
        *,
        rms: float | None = None,
        peak: float | None = None,
        spacing_lines: int = 1,
        odd: bool = False,
        spectrum: Spectrum = "flat",
        first_phase: float = 0.0,
    ) -> Multisine:
        """Return the multisine with Schroeder's phases: nearly constant envelope, like a sweep.

        Parameters
        ----------
        band
            Lowest and highest frequency (Hz), both included if they are multiples of 1/period.
        period_s
            Period (s); the spectral lines are multiples of its inverse.
        rms, peak
            Size (N·m or N): give one of the two, or neither if `spectrum` has absolute amplitudes.
        spacing_lines
            n: use only every n-th line, counted from the lowest in the band.
        odd
            Use odd multiples of 1/period only (every n-th of them), so that even distortion does not fall on a line.
        spectrum
            Amplitudes: ``"flat"``, ``"mass"`` (proportional to frequency, so that a mass has equal speed at each line),
            or one number for each line; the numbers are absolute (N·m or N) if neither `rms` nor `peak` is given.
        first_phase
            Phase of the lowest line (rad).

        Notes
        -----
        With p the fraction of the power in each line, φ_k = φ_1 − 2π·Σ_{l<k} (k − l)·p_l, k counting lines; for equal
        amplitudes this is φ_1 − π·k·(k − 1)/n. Source: Schroeder, IEEE Trans. Inf. Theory 16 (1970), 85.
        """
        lines = _lines(band, period_s, spacing_lines, odd)
        amplitudes = _spectrum(spectrum, lines)
        share = amplitudes**2 / np.sum(amplitudes**2)
        phases = first_phase - 2.0 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(share))[:-1]])
        return _scale_to_size(cls(period_s, lines, amplitudes, _wrap_phase(phases)), spectrum, rms, peak)

    @classmethod
    def random(
        cls,
        band: tuple[float, float],
        period_s: float = 1.0,
        *,
        seed: int | Sequence[int],
        rms: float | None = None,
        peak: float | None = None,
        spacing_lines: int = 1,
        odd: bool = False,
        spectrum: Spectrum = "flat",
    ) -> Multisine:
        """Return the multisine with random phases, uniform on the circle; the same seed gives the same phases.

        A seed may be several numbers, such as (seed, realisation). With `rms` given, each draw of the phases has a
        different peak; with `peak` given, a different rms. The other parameters (band, period, lines, spectrum) are
        those of `schroeder`.
        """
        lines = _lines(band, period_s, spacing_lines, odd)
        phases = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(lines))
        return _scale_to_size(cls(period_s, lines, _spectrum(spectrum, lines), phases), spectrum, rms, peak)

    @property
    def harmonics(self) -> NDArray[np.int64]:
        """Return the harmonic number (multiple of 1/period) of each spectral line of the multisine, shape (n,)."""
        return np.rint(self.lines_hz * self.period_s).astype(np.int64)

    @reported
    def rms(self) -> float:
        """Return the root mean square of the multisine over a period (N·m or N)."""
        return float(np.sqrt(0.5 * np.sum(self.amplitudes**2)))

    @cached_property
    def peak(self) -> float:
        """Return the largest magnitude of the multisine (N·m or N): the highest crest, found on a fine grid."""
        points = OVERSAMPLING * int(self.harmonics[-1] + 1)
        value = np.abs(self._samples(points, 0.0))
        before, after = np.roll(value, 1), np.roll(value, -1)
        crest = (value >= before) & (value >= after) & (value > 0.0)
        if not crest.any():
            return 0.0
        # Each crest on the grid is refined by a parabola through its neighbours.
        top, left, right = value[crest], before[crest], after[crest]
        bend = 2.0 * top - left - right
        lift = np.divide((left - right) ** 2, 8.0 * bend, out=np.zeros_like(top), where=bend > 0.0)
        return float((top + lift).max())

    @reported
    def crest_factor(self) -> float:
        """Return peak / rms: √2 for one line, about 1.7 with Schroeder's phases, 3 to 4 with random phases."""
        return self.peak / self.rms if self.rms > 0.0 else math.nan

    def at(self, time_s: ArrayLike) -> Floats:
        """Return the value of the multisine (N·m or N) at each time of `time_s` (s), in the same shape."""
        time = np.asarray(time_s, dtype=np.float64)
        total = np.zeros(time.shape)
        for line, amplitude, phase in zip(self.lines_hz, self.amplitudes, self.phases, strict=True):
            total += amplitude * np.cos(2.0 * np.pi * line * time + phase)
        return total

    def period(self, rate_hz: float, offset: float = 0.0) -> Floats:
        """Return one period of the multisine, sampled at the times (k + offset)/rate.

        Parameters
        ----------
        rate_hz
            Sampling rate (Hz). A period must be a whole number of samples, and all spectral lines below half the rate.
        offset
            Time of each sample within its step: 0 at the start, 0.5 in the middle. A sample from the start that is held
            over the step lags by half a step; a sample from the middle does not.

        Returns
        -------
        ndarray
            Values (N·m or N), shape (rate · period,).

        Raises
        ------
        ConfigError
            A period is not a whole number of samples, or a line is at or above half the rate.
        """
        samples = round(rate_hz * self.period_s)
        if samples < 1 or abs(rate_hz * self.period_s - samples) > ON_GRID:
            raise ConfigError(
                f"a period of {self.period_s:g} s is not a whole number of samples at {rate_hz:g} Hz",
                remedy=f"choose a period that is a whole multiple of 1/({rate_hz:g} Hz)",
            )
        if 2 * self.harmonics[-1] >= samples:
            raise ConfigError(
                f"the highest line, {self.lines_hz[-1]:g} Hz, is not below half the sampling rate of {rate_hz:g} Hz",
                remedy=f"end the band below {rate_hz / 2:g} Hz",
            )
        return self._samples(samples, offset)

    def ramped(self, time_s: ArrayLike, ramp_periods: int) -> Floats:
        """Return the multisine (N·m or N) at given times (s): 0 before time 0, then faded in over `ramp_periods`."""
        time = np.asarray(time_s, dtype=np.float64)
        return self.at(time) * ramp(time, ramp_periods * self.period_s)

    def scaled(self, factor: float) -> Multisine:
        """Return this multisine with all amplitudes multiplied by `factor`."""
        return replace(self, amplitudes=factor * self.amplitudes)

    def through(self, response: ArrayLike) -> Multisine:
        """Return a linear system's steady output for this multisine; `response` is its complex gain at each line."""
        gain = np.broadcast_to(np.asarray(response, dtype=np.complex128), self.lines_hz.shape)
        return replace(
            self, amplitudes=self.amplitudes * np.abs(gain), phases=_wrap_phase(self.phases + np.angle(gain))
        )

    def position(self, impedance: ImpedanceModel) -> Multisine:
        """Return the handle's steady position (rad or m) if this multisine is the effort: each line divided by jω·Z.

        `impedance` Z(jω) (N·m·s/rad or N·s/m) is a function of frequency (Hz), or its values at the spectral lines.
        """
        return self._divide_by(self._s * self._impedance(impedance))

    def velocity(self, impedance: ImpedanceModel) -> Multisine:
        """Return the handle's steady velocity (rad/s or m/s) if this is the effort: each line divided by Z(jω)."""
        return self._divide_by(self._impedance(impedance))

    def check(
        self,
        impedance: ImpedanceModel,
        *,
        effort_limit: float | None = None,
        position_limit: float | None = None,
        speed_limit: float | None = None,
        wall: ImpedanceModel | None = None,
        motor_limit: float | None = None,
        channel: Literal["external", "motor"] = "external",
    ) -> tuple[Peak, ...]:
        """Return the expected peaks of effort and motion with their limits, before the rig moves.

        Parameters
        ----------
        impedance
            Expected impedance Z(jω) at the handle (N·m·s/rad or N·s/m) of rig and wall: a function of frequency (Hz),
            or its values at the spectral lines.
        effort_limit
            Largest effort of the actuator that plays the excitation (N·m or N).
        position_limit
            Largest allowed distance from the rest position (rad or m).
        speed_limit
            Largest speed that the guard allows (rad/s or m/s).
        wall
            Impedance of the wall alone. If it is given, the effort by which the motor renders it is checked too.
        motor_limit
            Largest effort of the motor (N·m or N).
        channel
            ``"motor"`` if the rig's own motor plays the excitation and also renders the wall, else ``"external"``.

        Returns
        -------
        tuple of Peak
            Peaks in the steady state. A ramp of at least one period exceeds them little; friction reduces them.
        """
        whole = self._impedance(impedance)
        checks = [
            Peak("peak excitation", "effort", self.peak, effort_limit),
            Peak("peak position", "position", self.position(whole).peak, position_limit),
            Peak("peak speed", "velocity", self.velocity(whole).peak, speed_limit),
        ]
        if wall is not None or channel == "motor":
            share = (0.0 if wall is None else self._impedance(wall)) / whole
            carried = self.through(1.0 - share if channel == "motor" else share)
            checks.append(Peak("peak motor effort", "effort", carried.peak, motor_limit))
        return tuple(checks)

    @property
    def _s(self) -> Complexes:
        return np.asarray(2j * np.pi * self.lines_hz)

    def _impedance(self, model: ImpedanceModel) -> Complexes:
        values = model(self.lines_hz) if callable(model) else model
        return np.broadcast_to(np.asarray(values, dtype=np.complex128), self.lines_hz.shape)

    def _divide_by(self, by: Complexes) -> Multisine:
        if not (np.isfinite(by) & (by != 0.0)).all():
            raise ConfigError(
                "the impedance is zero or not a finite number at some spectral line of the multisine",
                remedy="check that the model's impedance is finite and not zero at every spectral line",
            )
        return self.through(1.0 / by)

    def _samples(self, samples: int, offset: float) -> Floats:
        spectrum = np.zeros(samples // 2 + 1, np.complex128)
        shift = 2.0 * np.pi * self.harmonics * offset / samples
        spectrum[self.harmonics] = 0.5 * samples * self.amplitudes * np.exp(1j * (self.phases + shift))
        return np.fft.irfft(spectrum, samples)


def ramp(time_s: ArrayLike, duration_s: float) -> Floats:
    """Return a raised cosine that rises from 0 at time 0 to 1 at `duration_s`; 0 before and 1 after."""
    time = np.asarray(time_s, dtype=np.float64)
    if duration_s <= 0.0:
        return np.where(time < 0.0, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(time / duration_s, 0.0, 1.0)))


def _lines(band: tuple[float, float], period_s: float, spacing: int, odd: bool) -> Floats:
    low, high = band
    if not (math.isfinite(high) and 0.0 < low <= high and period_s > 0.0 and spacing >= 1):
        raise ConfigError(
            f"a band of {low:g} to {high:g} Hz, period of {period_s:g} s and spacing {spacing} have no spectral line",
            remedy="give 0 < lowest ≤ highest frequency of the band, a period above 0 s and a spacing of at least 1",
        )
    first, last = math.ceil(low * period_s - ON_GRID), math.floor(high * period_s + ON_GRID)
    first = max(first, 1)
    if odd:
        harmonics = np.arange(first + (first % 2 == 0), last + 1, 2 * spacing)
    else:
        harmonics = np.arange(first, last + 1, spacing)
    if len(harmonics) == 0:
        raise ConfigError(
            f"no spectral line (multiple of {1.0 / period_s:g} Hz, 1/period) lies between {low:g} and {high:g} Hz",
            remedy="widen the band or lengthen the period",
        )
    return harmonics / period_s


def _spectrum(spectrum: Spectrum, lines: Floats) -> Floats:
    if isinstance(spectrum, str):
        if spectrum not in ("flat", "mass"):
            raise ConfigError(
                f"unknown spectrum {spectrum!r}", remedy="choose flat or mass, or give a list of amplitudes"
            )
        return np.ones_like(lines) if spectrum == "flat" else lines / lines[-1]
    amplitudes = np.array(spectrum, dtype=np.float64).reshape(-1)
    if len(amplitudes) != len(lines) or not (amplitudes >= 0.0).all() or not amplitudes.any():
        raise ConfigError(
            f"{len(amplitudes)} amplitudes are given for {len(lines)} lines; allowed is one number for each line, "
            "at least 0, and one of them above 0",
            remedy="give one amplitude for each line",
        )
    return amplitudes


def _wrap_phase(phases: Floats) -> Floats:
    return np.asarray((phases + np.pi) % (2.0 * np.pi) - np.pi)


def _scale_to_size(shape: Multisine, spectrum: Spectrum, rms: float | None, peak: float | None) -> Multisine:
    if rms is not None and peak is not None:
        raise ConfigError(
            f"rms = {rms:g} and peak = {peak:g} of the excitation are given; only one is allowed",
            remedy="leave out one of the two",
        )
    if rms is None and peak is None:
        if isinstance(spectrum, str):
            raise ConfigError(
                "the size of the excitation is missing", remedy="give its rms or its peak (N·m or N)"
            )
        return shape
    wanted, has = (rms, shape.rms) if rms is not None else (peak, shape.peak)
    assert wanted is not None
    if not (math.isfinite(wanted) and wanted > 0.0):
        raise ConfigError(
            f"the size of the excitation is {wanted!r}; it must be a finite number above zero",
            remedy="give a number above zero",
        )
    return shape.scaled(wanted / has)
