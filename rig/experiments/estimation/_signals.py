"""Define reference motions in closed form: position, velocity and acceleration as functions of time.

Estimators, filters and experiments are compared with these motions. Lengths are in position units (m, or rad times a
radius). Amplitudes and frequencies are those of a hand-held handle: 0.1 to 0.3 m/s, up to 40 Hz.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

BISECTIONS = 60  # halves any interval below the rounding of its ends


class Motion(NamedTuple):
    """A motion at given times: position, velocity and acceleration, three arrays with the shape of the times."""

    position: Floats
    velocity: Floats
    acceleration: Floats


@dataclass(frozen=True, slots=True)
class Signal:
    """A reference motion, and the time span in which an estimator is judged on it.

    Attributes
    ----------
    name
        Name of the signal in commands.
    meaning
        Property of estimators that the signal shows.
    motion
        Function of time (s, any shape) that returns a `Motion`; the velocity is continuous.
    start_s
        Begin of the judged span (s): an estimator that started at time 0 has settled.
    end_s
        End of the signal (s).
    """

    name: str
    meaning: str
    motion: Callable[[Floats], Motion]
    start_s: float
    end_s: float

    def __call__(self, time_s: ArrayLike) -> Motion:
        """Return position, velocity and acceleration at these times (s)."""
        return self.motion(np.asarray(time_s, dtype=np.float64))


def ramp(speed: float = 0.01 * np.pi) -> Signal:
    """Return a motion of constant speed (m/s); the default is not a whole number of counts per sampling period."""

    def motion(t: Floats) -> Motion:
        return Motion(speed * t, np.full_like(t, speed), np.zeros_like(t))

    return Signal("ramp", "steady speed: noise, and nothing to be late for", motion, 0.2, 0.5)


def sine(amplitude: float = 0.01, frequency_hz: float = 5.0) -> Signal:
    """Return the oscillation amplitude · sin(2π·frequency·t), with the amplitude in m."""
    w = 2.0 * np.pi * frequency_hz

    def motion(t: Floats) -> Motion:
        s, c = np.sin(w * t), np.cos(w * t)
        return Motion(amplitude * s, amplitude * w * c, -amplitude * w**2 * s)

    return Signal("sine", "free swinging, 5 Hz", motion, 0.2, 0.6)


def chirp(
    amplitude: float = 0.001, start_hz: float = 1.0, end_hz: float = 40.0, sweep_s: float = 1.0
) -> Signal:
    """Return a sine of constant amplitude (m) whose frequency rises linearly from `start_hz` to `end_hz`."""
    rate = (end_hz - start_hz) / sweep_s

    def motion(t: Floats) -> Motion:
        phase = 2.0 * np.pi * (start_hz * t + 0.5 * rate * t**2)
        w = 2.0 * np.pi * (start_hz + rate * t)
        s, c = np.sin(phase), np.cos(phase)
        return Motion(amplitude * s, amplitude * w * c, amplitude * (2.0 * np.pi * rate * c - w**2 * s))

    return Signal("chirp", "1 to 40 Hz: what a hand can do, and more", motion, 0.2, sweep_s)


def wall_bounce(
    approach: float = 0.1, contact_s: float = 0.1, ring_hz: float = 34.0, damping_ratio: float = 0.05
) -> Signal:
    """Return the motion of a hit on a stiff wall with little damping: steady approach (m/s), then decaying oscillation.

    The wall is at position 0. From the contact (time `contact_s`) on, x = (v/ω)·exp(−ζ·ω₀·τ)·sin(ω·τ), the free motion
    of a mass on the wall's spring; position and velocity are continuous at the contact. `ring_hz` is the damped
    frequency ω/2π. The bound of the acceleration is v·ω, 21.4 m/s² with the defaults.
    """
    w = 2.0 * np.pi * ring_hz
    decay = w * damping_ratio / np.sqrt(1.0 - damping_ratio**2)

    def motion(t: Floats) -> Motion:
        tau = np.maximum(t - contact_s, 0.0)
        envelope = approach / w * np.exp(-decay * tau)
        s, c = np.sin(w * tau), np.cos(w * tau)
        ringing = Motion(
            envelope * s,
            envelope * (w * c - decay * s),
            envelope * ((decay**2 - w**2) * s - 2.0 * decay * w * c),
        )
        before = t < contact_s
        return Motion(
            np.where(before, approach * (t - contact_s), ringing.position),
            np.where(before, approach, ringing.velocity),
            np.where(before, 0.0, ringing.acceleration),
        )

    return Signal("wall-bounce", "approach at 0.1 m/s, then 34 Hz ringing", motion, 0.05, 0.5)


def slow_reversal(amplitude: float = 0.001, frequency_hz: float = 1.0) -> Signal:
    """Return a slow oscillation (amplitude in m): counts are rare around a reversal, where estimators differ most."""
    return Signal(
        "slow-reversal", "6 mm/s at most, and twice to rest", sine(amplitude, frequency_hz).motion, 0.2, 1.0
    )


SIGNALS: dict[str, Signal] = {
    signal.name: signal for signal in (ramp(), sine(), chirp(), wall_bounce(), slow_reversal())
}


def edge_times(signal: Signal, time_s: ArrayLike, resolution: float, *, offset: float = 0.5) -> Floats:
    """Return the time of the last encoder edge at or before each sample, as an ideal capture unit measures it.

    Parameters
    ----------
    signal
        Motion whose velocity changes sign at most once between two samples.
    time_s
        Times of the samples (s), ascending, shape (n,).
    resolution
        Travel for one count (position units); its sign does not matter.
    offset
        Distance of position zero from the lower edge of its cell, the range of one count (counts, 0 to below 1).

    Returns
    -------
    ndarray of float64
        Times of the edges (s), shape (n,); −inf before the first edge after ``time_s[0]``.

    Notes
    -----
    At an edge the position passes a boundary between two encoder cells. The motion is monotone between samples and
    turning points, so the last passed boundary is the near boundary of the last cell; its time is found by bisection.
    """
    times = np.asarray(time_s, dtype=np.float64)
    delta = abs(resolution)
    knots = np.union1d(times, _turning_points(signal, times))
    position = signal(knots).position
    cell = np.floor(position / delta + offset)
    crossed = np.flatnonzero(cell[1:] != cell[:-1])
    rising = position[crossed + 1] > position[crossed]
    boundary = delta * (cell[crossed + 1] + np.where(rising, 0.0, 1.0) - offset)
    last = np.full(len(knots), -np.inf)
    last[crossed + 1] = _bisect(
        lambda t: np.where(rising, 1.0, -1.0) * (signal(t).position - boundary),
        knots[crossed],
        knots[crossed + 1],
    )
    last = np.maximum.accumulate(last) if len(last) else last
    return np.asarray(last[np.searchsorted(knots, times)], dtype=np.float64)


def _turning_points(signal: Signal, times: Floats) -> Floats:
    sign = np.sign(signal(times).velocity)
    turns = np.flatnonzero(sign[1:] * sign[:-1] < 0)
    after = sign[turns + 1]
    return _bisect(lambda t: after * signal(t).velocity, times[turns], times[turns + 1])


def _bisect(function: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    """Return the zero of each component of a function that is negative at `low` and not negative at `high`."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = function(middle) < 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high
