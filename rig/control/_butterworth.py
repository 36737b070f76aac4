"""Butterworth filters as second-order sections: the bilinear, prewarped design.

The filters of a verdict and the Butterworth estimator use it. It must not import scipy, which loads slowly.
"""

import math
from typing import Any

import numpy as np

# Not `scipy.signal.butter`, which gives the same coefficients (a test compares them): it takes a second to load, which
# every hit would need.
_TWICE_RATE = 4.0  # of the analogue prototype, whose sampling rate is 2


def low_pass(order: int, cutoff_hz: float, rate_hz: float) -> list[list[float]]:
    """Return the sections (b0, b1, b2, 1, a1, a2) of a Butterworth low pass, fastest first; the first has all gain."""
    corner = _prewarp(cutoff_hz, rate_hz)
    return _sections(corner * _prototype(order), -np.ones(order), corner**order)


def high_pass(order: int, cutoff_hz: float, rate_hz: float) -> list[list[float]]:
    """Return the sections (b0, b1, b2, 1, a1, a2) of a Butterworth high pass of even order, fastest poles first."""
    prototype = _prototype(order)
    return _sections(
        _prewarp(cutoff_hz, rate_hz) / prototype, np.ones(order), float(np.real(1.0 / np.prod(-prototype)))
    )


def band_pass(low_hz: float, high_hz: float, rate_hz: float) -> list[list[float]]:
    """Return sections (b0, b1, b2, 1, a1, a2) of a Butterworth band pass, two poles at each edge, fastest first."""
    low, high = _prewarp(low_hz, rate_hz), _prewarp(high_hz, rate_hz)
    width, middle = high - low, math.sqrt(low * high)
    half = (_prototype(2) * width / 2).astype(complex)
    apart = np.sqrt(half**2 - middle**2)
    return _sections(np.concatenate((half + apart, half - apart)), np.array([1.0, 1.0, -1.0, -1.0]), width**2)


def _prewarp(corner_hz: float, rate_hz: float) -> float:
    return float(_TWICE_RATE * np.tan(np.pi * (2.0 * corner_hz / rate_hz) / 2.0))


def _prototype(order: int) -> Any:
    """Return the poles of the analogue Butterworth low pass with a cut-off of 1 rad/s."""
    return -np.exp(1j * np.pi * np.arange(1 - order, order, 2) / (2 * order))


def _sections(analogue: Any, zeros: Any, gain: float) -> list[list[float]]:
    """Return second-order sections for poles of the analogue filter and zeros (±1) of the sampled filter.

    Each section gets the zeros nearest to its poles. The zeros at +1 are those of the analogue filter at zero
    frequency.
    """
    poles = (_TWICE_RATE + analogue) / (_TWICE_RATE - analogue)
    at_rest = np.zeros(int(np.sum(zeros > 0.0)))
    gain *= float(np.real(np.prod(_TWICE_RATE - at_rest) / np.prod(_TWICE_RATE - analogue)))
    odd = len(analogue) % 2
    left = zeros.tolist() + [0.0] * odd  # with a pole at zero it makes the real pole's section one of two
    rows = []
    for pole in sorted(poles[poles.imag > 0.0], key=lambda pole: abs(1.0 - abs(pole))):
        first, second = sorted(left, key=lambda zero: abs(pole - zero))[:2]
        left.remove(first)
        left.remove(second)
        rows.append([*_numerator(first, second), 1.0, -2.0 * pole.real, (pole * pole.conjugate()).real])
    if odd:
        real = poles[len(poles) // 2].real
        rows.append([*_numerator(*left), 1.0, -real, 0.0])
    rows.reverse()
    rows[0][:3] = [gain * value for value in rows[0][:3]]
    return [[float(value) for value in row] for row in rows]


def _numerator(first: float, second: float) -> list[float]:
    return [1.0, -(first + second), first * second]
