"""Compute the constant C of Levant's differentiator from a recorded motion: a sum of sines and its second derivative.

    f(t) = c + Σ A_i·sin(ω_i·t + φ_i),   f̈(t) = −Σ A_i·ω_i²·sin(ω_i·t + φ_i),   C = max |f̈|.

Source: Chawda et al., section IV. How many sines, and how long a stretch, they do not report, and both decide the
answer. Rounding alone leaves a `residual_rms` of 1/√12 of a count; many counts mean that the fit, and with it C, is too
smooth.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.core.deferred import optimize
from rig.core.errors import ConfigError, RecordingError
from rig.core.sample import Phase
from rig.recording.data import Recording

Floats = NDArray[np.float64]

DEFAULT_SINES = 6
# of the fit; more are thinned by averaging neighbours, which costs no bandwidth that matters
MOST_SAMPLES = 1000
BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06  # impact and first rebound: a long record drowns them
MARGIN = 0.05  # of the time at either end where the fit is unsupported on one side: no part of the maximum
_PADDING = 8  # of the spectrum in which a first guess is looked for


@dataclass(frozen=True, slots=True, eq=False)
class LipschitzFit:
    """A fitted sum of sines.

    Attributes
    ----------
    lipschitz
        C, largest magnitude of the fit's second derivative, without the first and last `MARGIN` of the time (position
        unit/s²).
    residual_rms
        RMS distance of the samples from the fit (position unit).
    offset
        The constant c (position unit).
    frequencies_hz, amplitudes, phases
        One element a sine, by falling amplitude; phases in rad at ``time_s[0]``.
    time_s, fitted, second_derivative
        The fit at the samples it was made of (seconds as given; position unit; position unit/s²).
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
    """Fit a sum of sines to the measured position around the first contact.

    Parameters
    ----------
    recording
        Recording of a hit. Only its measured position is used, so it may come from a real rig.
    sines
        How many; one more should change C little.
    before_s, after_s
        The stretch, from first contact (s); it ends where the trial ends.

    Raises
    ------
    RecordingError
        The handle never met the wall in a trial.
    ConfigError
        Too few samples for that many sines.
    """
    rows, time_s = recording.rows, recording.time_s
    trial = rows["phase"] == Phase.TRIAL
    contact = np.flatnonzero(trial & (rows["penetration"] > 0.0))
    if not len(contact):
        raise RecordingError("the recording has no contact", remedy="record a hit: `rig hit`")
    since_contact = time_s - time_s[contact[0]]
    chosen = trial & (since_contact >= -before_s) & (since_contact <= after_s)
    return identify_lipschitz(time_s[chosen], rows["position"][chosen].astype(np.float64), sines=sines)


def identify_lipschitz(time_s: Floats, position: Floats, *, sines: int = DEFAULT_SINES) -> LipschitzFit:
    """Fit a sum of sines to a motion and return its largest acceleration.

    Parameters
    ----------
    time_s
        Times of the samples, shape (n,), increasing; a steady rate is assumed only for first guesses.
    position
        Position at these times, shape (n,), rad or m.
    sines
        How many sines, at least 1; each has three numbers, and the fit needs ten samples for each.

    Raises
    ------
    ConfigError
        Too few samples for that many sines, arrays that do not belong together, or values that are not finite.

    Notes
    -----
    The frequencies are found one after the other, each at the peak of the spectrum of what the others leave, and
    refined together by nonlinear least squares; offset, amplitudes and phases follow linearly (variable projection).
    Source: Chawda et al., section IV; the choice of frequencies is ours.
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
            f"time_s has shape {t.shape} and position {y.shape}",
            remedy="give two flat arrays of equal length",
        )
    if not (np.isfinite(t).all() and np.isfinite(y).all() and (np.diff(t) > 0).all()):
        raise ConfigError(
            "the times do not increase, or a time or position is not finite",
            remedy="remove the rows with bad values",
        )
    if sines < 1 or len(t) < 10 * sines:
        raise ConfigError(
            f"{sines} sines cannot be fitted to {len(t)} samples",
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
    """Return regressors, shape (n, 1 + 2·sines): a constant, then all sines, then all cosines."""
    angle = 2.0 * np.pi * np.outer(t, frequencies)
    return np.hstack([np.ones((len(t), 1)), np.sin(angle), np.cos(angle)])


def _linear_part(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    """Return the offset, then the factors of sines and cosines, that are best for these frequencies."""
    return np.asarray(np.linalg.lstsq(_columns(frequencies, t), y, rcond=1e-9)[0])


def _evaluate(frequencies: Floats, t: Floats, linear: Floats) -> Floats:
    return np.asarray(_columns(frequencies, t) @ linear)


def _residual(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    return _evaluate(frequencies, t, _linear_part(frequencies, t, y)) - y


def _jacobian(frequencies: Floats, t: Floats, y: Floats) -> Floats:
    """Return the Jacobian of the residual by Kaufman: d/dω without its projection on the linear part."""
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
    # Near an end the fit is unsupported on one side: no part of the maximum.
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
