"""Compute the constant C of Levant's differentiator from a motion: fit a sum of sines, compute its second derivative.

    f(t) = c + Σ A_i·sin(ω_i·t + φ_i),   f̈(t) = −Σ A_i·ω_i²·sin(ω_i·t + φ_i),   C = max |f̈|.

`rig estimators lipschitz` and the reproduced paper use this module. Source: Chawda et al., section IV. The authors do
not report the number of sines and the length of the stretch, and both influence the result. Rounding alone causes a
`residual_rms` of 1/√12 of a count; if the residual is many counts, the fit is too smooth and C too small.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import optimize
from rig.core.errors import ConfigError, RecordingError
from rig.core.sample import Phase
from rig.recording.data import Recording

Floats = NDArray[np.float64]

DEFAULT_SINES = 6
# Largest number of samples of the fit: more samples are averaged in groups, which hardly reduces the bandwidth.
MOST_SAMPLES = 1000
BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06  # impact and first rebound only
# Fraction of the time at both ends that is excluded from the maximum, because the fit has samples on one side only.
MARGIN = 0.05
_PADDING = 8  # zero padding of the spectrum in which the initial frequencies are found


@dataclass(frozen=True, slots=True, eq=False)
class LipschitzFit:
    """A sum of sines that was fitted to a motion, and its largest acceleration.

    Attributes
    ----------
    lipschitz
        Constant C: largest magnitude of the fit's second derivative, without the first and last 5 % of the time (rad/s²
        or m/s²).
    residual_rms
        Rms distance of the samples from the fit (rad or m).
    offset
        Constant c of the sum (rad or m).
    frequencies_hz, amplitudes, phases
        Frequency (Hz), amplitude (rad or m) and phase at ``time_s[0]`` (rad) of each sine, by falling amplitude.
    time_s, fitted, second_derivative
        Times of the samples (s), and at these times the fit (rad or m) and its second derivative (rad/s² or m/s²).
    """

    lipschitz: float
    residual_rms: float
    offset: float
    frequencies_hz: Floats
    amplitudes: Floats
    phases: Floats
    time_s: Floats = field(repr=False)
    fitted: Floats = field(repr=False)
    second_derivative: Floats = field(repr=False)


def lipschitz_of(
    recording: Recording,
    *,
    sines: int = DEFAULT_SINES,
    before_s: float = BEFORE_CONTACT_S,
    after_s: float = AFTER_CONTACT_S,
) -> LipschitzFit:
    """Fit a sum of sines to the position around the first contact of a hit; its largest acceleration is Levant's C.

    Parameters
    ----------
    recording
        Recording of a hit. Only its measured position is used, so it may come from a real rig.
    sines
        Number of sines; with one sine more C should change little.
    before_s, after_s
        Lengths of the fitted time span before and after the first contact (s).

    Raises
    ------
    RecordingError
        The handle did not reach the wall in the trial.
    ConfigError
        There are too few samples for this number of sines.
    """
    rows, time_s = recording.rows, recording.time_s
    trial = rows["phase"] == Phase.TRIAL
    contact = np.flatnonzero(trial & (rows["penetration"] > 0.0))
    if not len(contact):
        raise RecordingError("the recording has no contact with a wall", remedy="record a hit: `rig hit`")
    since_contact = time_s - time_s[contact[0]]
    chosen = trial & (since_contact >= -before_s) & (since_contact <= after_s)
    return identify_lipschitz(time_s[chosen], rows["position"][chosen].astype(np.float64), sines=sines)


def identify_lipschitz(time_s: Floats, position: Floats, *, sines: int = DEFAULT_SINES) -> LipschitzFit:
    """Fit a sum of sines to a motion; return the fit with its largest acceleration.

    Parameters
    ----------
    time_s
        Times of the samples (s), shape (n,), ascending; a constant rate is assumed only for initial guesses.
    position
        Position at these times, shape (n,), rad or m.
    sines
        Number of sines, at least 1; the fit needs ten samples for each sine.

    Raises
    ------
    ConfigError
        There are too few samples for this number of sines, the arrays have different shapes, or a value is not finite.

    Notes
    -----
    Frequencies are found one after the other, each at the peak of the residual's spectrum, and are then refined
    together by nonlinear least squares; offset, amplitudes and phases follow linearly (variable projection). Source:
    Chawda et al., section IV; the choice of frequencies is ours.
    """
    time_s, position = _check_motion(time_s, position, sines)
    t, y = _thin_out(time_s - time_s[0], position - position[0])
    length, step = t[-1] - t[0], float(np.median(np.diff(t)))
    scale = float(np.std(y)) or 1.0
    lowest, highest = 0.1 / length, 0.25 / step
    found: Floats = np.empty(0)
    # One sine after another, each started at the peak of the residual's spectrum: all at once, the descent ends in a
    # local minimum.
    for _ in range(sines):
        rest = y - _evaluate(found, t, _linear_part(found, t, y))
        guess = np.append(found, np.clip(_spectral_peak(rest, step), 1.01 * lowest, 0.99 * highest))
        # Frequencies alone are free: offset and amplitudes are linear and solved within (variable projection).
        found = optimize.least_squares(
            _residual,
            guess,
            _jacobian,
            args=(t, y / scale),
            bounds=(lowest, highest),
            x_scale=1.0 / length,
            max_nfev=40,
        ).x
    return _as_fit(found, time_s, position, _linear_part(found, t, y))


def _check_motion(time_s: Floats, position: Floats, sines: int) -> tuple[Floats, Floats]:
    t, y = np.asarray(time_s, dtype=np.float64), np.asarray(position, dtype=np.float64)
    if t.ndim != 1 or t.shape != y.shape:
        raise ConfigError(
            f"time_s has shape {t.shape} and position {y.shape}; both must be equal and one-dimensional",
            remedy="give two one-dimensional arrays of equal length",
        )
    if not (np.isfinite(t).all() and np.isfinite(y).all() and (np.diff(t) > 0).all()):
        raise ConfigError(
            "the times do not increase, or a time or position is not finite",
            remedy="remove the samples with such values",
        )
    if sines < 1 or len(t) < 10 * sines:
        raise ConfigError(
            f"{sines} sines cannot be fitted to {len(t)} samples: each sine needs 10 samples",
            remedy=f"choose 1 to {len(t) // 10} sines" if len(t) >= 10 else "give at least 10 samples",
        )
    return t, y


def _thin_out(t: Floats, y: Floats) -> tuple[Floats, Floats]:
    group = -(-len(t) // MOST_SAMPLES)
    whole = len(t) // group * group
    return t[:whole].reshape(-1, group).mean(axis=1), y[:whole].reshape(-1, group).mean(axis=1)


def _spectral_peak(rest: Floats, step: float) -> float:
    size = _PADDING * len(rest)
    spectrum = np.abs(np.fft.rfft(rest - rest.mean(), size))
    return float(np.argmax(spectrum) / (size * step))


def _columns(frequencies: Floats, t: Floats) -> Floats:
    """Return the regressors, shape (n, 1 + 2·sines): a column of ones, then all sines, then all cosines."""
    angle = 2.0 * np.pi * np.outer(t, frequencies)
    return np.hstack([np.ones((len(t), 1)), np.sin(angle), np.cos(angle)])


def _linear_part(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    """Return the best offset, factors of the sines and factors of the cosines for given frequencies (Hz)."""
    return np.asarray(np.linalg.lstsq(_columns(frequencies, t), y, rcond=1e-9)[0])


def _evaluate(frequencies: Floats, t: Floats, linear: Floats) -> Floats:
    return np.asarray(_columns(frequencies, t) @ linear)


def _residual(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    return _evaluate(frequencies, t, _linear_part(frequencies, t, y)) - y


def _jacobian(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    """Return the residual's derivatives by each frequency, with Kaufman's approximation (variable projection)."""
    columns, linear = _columns(frequencies, t), _linear_part(frequencies, t, y)
    n = len(frequencies)
    sine, cosine = columns[:, 1 : n + 1], columns[:, n + 1 :]
    derivative = 2.0 * np.pi * t[:, None] * (linear[1 : n + 1] * cosine - linear[n + 1 :] * sine)
    basis = np.linalg.qr(columns)[0]
    return np.asarray(derivative - basis @ (basis.T @ derivative))


def _as_fit(frequencies: Floats, time_s: Floats, position: Floats, linear: Floats) -> LipschitzFit:
    t = time_s - time_s[0]
    n = len(frequencies)
    curvature = linear * np.concatenate([[0.0], np.tile(-((2.0 * np.pi * frequencies) ** 2), 2)])
    fitted = _evaluate(frequencies, t, linear) + position[0]
    second = _evaluate(frequencies, t, curvature)
    amplitudes = np.hypot(linear[1 : n + 1], linear[n + 1 :])
    phases = np.arctan2(linear[n + 1 :], linear[1 : n + 1])
    order = np.argsort(-amplitudes, kind="stable")
    inner = (t >= MARGIN * t[-1]) & (t <= (1.0 - MARGIN) * t[-1])
    return LipschitzFit(
        lipschitz=float(np.abs(second[inner]).max()),
        residual_rms=float(np.sqrt(np.mean((position - fitted) ** 2))),
        offset=float(linear[0] + position[0]),
        frequencies_hz=frequencies[order],
        amplitudes=amplitudes[order],
        phases=phases[order],
        time_s=time_s,
        fitted=fitted,
        second_derivative=second,
    )
