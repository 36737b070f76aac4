"""Kalman filter on a chain of two or three integrators.

With `model = "triple"`, which Bélanger recommends, the state is (position, velocity, acceleration), driven by white
jerk of power spectral density q. With `double` it is (position, velocity), driven by white acceleration. The encoder
measures the position with an error of variance r. The filter computes in counts and periods: the transition matrix then
contains only 0, 1 and ½, r is 1/12, and q becomes the dimensionless intensity q·T⁵/Δ² (q·T³/Δ² for `double`).

In the steady state the filter is a differentiator with a low pass at ω0 ≈ (q/(r·T))^(1/6), or ^(1/4) for `double`. The
low pass of `double` is a second-order Butterworth filter with a lag of √2/ω0; `triple` follows a constant acceleration
without lag, but has a peak near ω0. Set `bandwidth_hz` first; use q to copy the value of a paper, in position² per s⁵
(s³ for `double`). Experiments name it ``kalman``. Its update must not allocate.

Source: Chawda et al., section II.B, equations (2) to (4) and Q after them; Bélanger et al. 1998; Xia et al. 1994 for
fading. Neither of the last two was available: the recursion is the standard form of the literature.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types

from rig.control.estimators._fdm import count_difference
from rig.control.estimators._kalman_model import process_noise, steady_gain
from rig.control.estimators.estimator import (
    COMMON,
    OWN_INTS,
    PERIOD,
    RESOLUTION,
    WINDOW,
    Choice,
    Estimator,
    Floats,
    Ints,
    Setting,
    check_below_nyquist,
)
from rig.core.errors import ConfigError
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE

# parameters: measurement variance, process noise, prior variance of the acceleration, the options, and INPUT, the
# acceleration by a unit of effort (counts per period²)
R, Q11, Q12, Q13, Q22, Q23, Q33, PRIOR33 = range(COMMON, COMMON + 8)
FADING, MEMORY, FORGETTING, STEADY, GAIN1, GAIN2, GAIN3, INPUT = range(COMMON + 8, COMMON + 16)
# state_f: position less the last count, velocity, acceleration; covariance; Ĉ0; squares of innovations
OFFSET, VELOCITY, ACCELERATION, P11, P12, P13, P22, P23, P33, POWER, SQUARES = range(11)
STARTED, PREVIOUS, INNOVATIONS = range(OWN_INTS, OWN_INTS + 3)  # state_i
INTS = OWN_INTS + 3

LONGEST_MEMORY = 64
LONGEST_GAP = 1000  # periods; after a longer one it restarts on the mean slope
PRIOR = 1.0  # variance of the unknown first velocity, counts² per period²
DEFAULT_BANDWIDTH_HZ = 200.0  # as fdm-butterworth has
# Largest ω0·T for the noise as the paper prints it: its Q has (7−i−j)! where the integral has (7−i−j), and a negative
# eigenvalue. From ω0·T ≈ 4 on the predicted variance turns negative after the start.
PRINTED_LIMIT = 3.0

FADINGS = ("none", "instant", "window", "stf")
NO_FADING, MEAN, STRONG_TRACKING = 0, 2, 3
VARIANCES = {"rounding": 1.0 / 12.0, "paper": 1.0 / 3.0}  # counts²
ORDERS = {"triple": 3, "double": 2}

_SIX = types.UniTuple(types.float64, 6)


@kernel(_SIX(*[types.float64] * 6), inline=True)
def _propagate(
    p11: float, p12: float, p13: float, p22: float, p23: float, p33: float
) -> tuple[float, float, float, float, float, float]:
    """Return p11, p12, p13, p22, p23, p33 of the covariance A·P·Aᵀ, with A = [[1, 1, ½], [0, 1, 1], [0, 0, 1]]."""
    a12 = p12 + p22 + 0.5 * p23
    a13 = p13 + p23 + 0.5 * p33
    a23 = p23 + p33
    m11 = p11 + p12 + 0.5 * p13 + a12 + 0.5 * a13
    return m11, a12 + a13, a13, p22 + p23 + a23, a23, p33


@kernel(_SIX(*[types.float64] * 7), inline=True)
def _correct(
    p11: float, p12: float, p13: float, p22: float, p23: float, p33: float, r: float
) -> tuple[float, float, float, float, float, float]:
    """Return the Kalman gain k1, k2, k3, and p22, p23, p33 of the covariance after a measurement of variance r.

    The first row of that covariance is r·(k1, k2, k3), which is exact for the optimal gain and one measured quantity.
    """
    # Joseph's form and not (1 − K·C)·P: it stays symmetric and positive under rounding.
    s = p11 + r
    k1, k2, k3 = p11 / s, p12 / s, p13 / s
    p22 += k2 * (k2 * s - 2.0 * p12)
    p23 += k2 * (k3 * s - p13) - k3 * p12
    p33 += k3 * (k3 * s - 2.0 * p13)
    return k1, k2, k3, p22, p23, p33


@kernel("void(f8, f8[::1], i8[::1], f8[::1])", inline=True, no_refcount=True)
def _start(velocity: float, state_f: Floats, state_i: Ints, parameters: Floats) -> None:
    """Start the filter at the newest count with a velocity (counts per period) and the prior covariance."""
    state_i[STARTED], state_i[INNOVATIONS] = 1, 0
    state_f[OFFSET], state_f[VELOCITY], state_f[ACCELERATION] = 0.0, velocity, 0.0
    state_f[P11], state_f[P12], state_f[P13] = parameters[R], 0.0, 0.0
    state_f[P22], state_f[P23], state_f[P33] = PRIOR, 0.0, parameters[PRIOR33]


# Fading. If innovations are larger than the model explains, the propagated covariance is multiplied by λ = max(1, (Ĉ0 −
# r − Q11)/M11), M = A·P·Aᵀ. With one measured quantity the variants of the literature differ only in Ĉ0, the
# innovations' variance: the last innovation's square (`instant`), the mean of several squares (`window`), or the
# recursion Ĉ0 ← (ρ·Ĉ0 + ν²)/(1 + ρ) of the strong tracking filter (`stf`), which averages about two samples. The paper
# does not state which it used.
@kernel("f8(f8, f8[::1], i8[::1], f8[::1])", inline=True, no_refcount=True)
def _innovation_variance(innovation: float, state_f: Floats, state_i: Ints, parameters: Floats) -> float:
    """Return the variance of the innovations so far (counts²), by the configured kind of fading; 0 without fading."""
    fading, seen = parameters[FADING], state_i[INNOVATIONS]
    state_i[INNOVATIONS] = seen + 1
    square = innovation * innovation
    if fading == NO_FADING:
        return 0.0
    if fading == MEAN:
        memory = int(parameters[MEMORY])
        state_f[SQUARES + seen % memory] = square
        remembered = min(seen + 1, memory)
        # Summed again: a running sum would keep the rounding of one huge innovation for ever.
        total = 0.0
        for i in range(remembered):
            total += state_f[SQUARES + i]
        return float(total / remembered)
    if fading == STRONG_TRACKING:
        if seen > 0:
            rho = parameters[FORGETTING]
            square = (rho * state_f[POWER] + square) / (1.0 + rho)
        state_f[POWER] = square
    return float(square)


@kernel("UniTuple(f8, 3)(f8, i8, f8[::1], f8[::1])", inline=True, no_refcount=True)
def _gain(
    variance: float, elapsed_ticks: int, state_f: Floats, parameters: Floats
) -> tuple[float, float, float]:
    """Propagate the covariance over the elapsed periods, correct it for a new sample, and return the Kalman gain.

    `variance` (counts²) of the innovations decides how far the covariance is inflated (fading).
    """
    r, q11, q12, q13 = parameters[R], parameters[Q11], parameters[Q12], parameters[Q13]
    q22, q23, q33 = parameters[Q22], parameters[Q23], parameters[Q33]
    p11, p12, p13 = state_f[P11], state_f[P12], state_f[P13]
    p22, p23, p33 = state_f[P22], state_f[P23], state_f[P33]
    for i in range(elapsed_ticks):
        p11, p12, p13, p22, p23, p33 = _propagate(p11, p12, p13, p22, p23, p33)
        if i == elapsed_ticks - 1 and variance - r - q11 > p11 > 0.0:
            fade = (variance - r - q11) / p11
            p11, p12, p13 = fade * p11, fade * p12, fade * p13
            p22, p23, p33 = fade * p22, fade * p23, fade * p33
        p11, p12, p13 = p11 + q11, p12 + q12, p13 + q13
        p22, p23, p33 = p22 + q22, p23 + q23, p33 + q33
    # The printed noise, which is no covariance, can come to this after fading or a gap: begin again from the prior.
    if not p11 > 0.0:
        p11, p12, p13, p22, p23, p33 = r, 0.0, 0.0, PRIOR, 0.0, parameters[PRIOR33]
    k1, k2, k3, p22, p23, p33 = _correct(p11, p12, p13, p22, p23, p33, r)
    state_f[P11], state_f[P12], state_f[P13] = r * k1, r * k2, r * k3
    state_f[P22], state_f[P23], state_f[P33] = p22, p23, p33
    return k1, k2, k3


@kernel(ESTIMATOR_SIGNATURE, no_refcount=True)
def update(
    count: int,
    edge_age_s: float,
    elapsed_ticks: int,
    effort: float,
    state_f: Floats,
    state_i: Ints,
    parameters: Floats,
) -> float:
    """Return the velocity (rad/s or m/s) at a new encoder count, by the Kalman filter; 0 for the first sample."""
    # The position is stored less the newest count, so that large counts cost no digits.
    scale = parameters[RESOLUTION] / parameters[PERIOD]
    moved = count_difference(count, state_i[PREVIOUS])
    state_i[PREVIOUS] = count
    if state_i[STARTED] == 0:
        _start(0.0, state_f, state_i, parameters)
        return 0.0
    state_i[WINDOW] = elapsed_ticks
    if elapsed_ticks > LONGEST_GAP:
        _start(moved / elapsed_ticks, state_f, state_i, parameters)
        return float(state_f[VELOCITY] * scale)

    offset, velocity, acceleration = state_f[OFFSET], state_f[VELOCITY], state_f[ACCELERATION]
    known = acceleration + parameters[INPUT] * effort
    for _ in range(elapsed_ticks):
        offset += velocity + 0.5 * known
        velocity += known
    innovation = moved - offset
    k1, k2, k3 = parameters[GAIN1], parameters[GAIN2], parameters[GAIN3]
    if parameters[STEADY] == 0.0:
        variance = _innovation_variance(innovation, state_f, state_i, parameters)
        k1, k2, k3 = _gain(variance, elapsed_ticks, state_f, parameters)
    velocity += k2 * innovation
    state_f[OFFSET] = (k1 - 1.0) * innovation
    state_f[VELOCITY] = velocity
    state_f[ACCELERATION] = acceleration + k3 * innovation
    return float(velocity * scale)


def design(settings: Mapping[str, Any], resolution: float, period_s: float) -> list[float]:
    """Return the Kalman filter's parameters: variances of noise, prior, options, steady gain.

    Raise `ConfigError` if settings exclude each other, such as a steady gain and fading.
    """
    order, r = ORDERS[settings["model"]], VARIANCES[settings["variance"]]
    printed, steady = settings["noise"] == "printed", settings["gain"] == "steady"
    _check_options(order, printed, steady, settings["fading"], settings["fading_window"])
    intensity = _intensity(settings, order, r, resolution, period_s)
    turn = (intensity / r) ** (1.0 / (2 * order))  # ω0·T
    if printed and turn > PRINTED_LIMIT:
        raise ConfigError(
            f'estimator kalman: noise = "printed" gives negative variances at a bandwidth of ω0·T = {turn:.3g}',
            remedy=f'choose noise = "integral", or a lower q or bandwidth_hz (ω0·T up to {PRINTED_LIMIT:g})',
        )
    noise = intensity * process_noise(order, printed=printed)
    gain = np.zeros(3)
    if steady:
        gain[:order] = _compute_steady_gain(order, intensity, r, printed)
    q = np.zeros((3, 3))  # the double integrator is the triple one that never has an acceleration
    q[:order, :order] = noise
    return [
        r,
        q[0, 0],
        q[0, 1],
        q[0, 2],
        q[1, 1],
        q[1, 2],
        q[2, 2],
        PRIOR if order == 3 else 0.0,
        float(FADINGS.index(settings["fading"])),
        settings["fading_window"],
        settings["forgetting"],
        float(steady),
        *gain.tolist(),
        0.0,
    ]


def steady_parameters(gains: Sequence[float], acceleration: float = 0.0) -> list[float]:
    """Return the Kalman filter's parameters for constant gains of position, velocity, acceleration (counts, periods).

    `acceleration` (counts per period²) is what one N·m or N of the motor causes; 0 if the effort is not used.
    """
    return [VARIANCES["rounding"], *[0.0] * (STEADY - R - 1), 1.0, *gains, acceleration]


# Cached: the Riccati equation takes 14 ms of processor time.
@lru_cache(maxsize=512)
def _compute_steady_gain(order: int, intensity: float, r: float, printed: bool) -> tuple[float, ...]:
    return tuple(steady_gain(intensity * process_noise(order, printed=printed), r).tolist())


def _check_options(order: int, printed: bool, steady: bool, fading: str, window: float) -> None:
    if window != round(window):
        raise ConfigError(
            f"estimator kalman: fading_window = {window:g} is not a whole number of samples",
            remedy=f"choose {int(window)} or {int(window) + 1}",
        )
    if printed and order != 3:
        raise ConfigError(
            'estimator kalman: noise = "printed" exists only for the triple integrator',
            remedy='choose model = "triple" or noise = "integral"',
        )
    if steady and fading != "none":
        raise ConfigError(
            f'estimator kalman: gain = "steady" is constant and excludes fading = {fading!r}',
            remedy='choose gain = "recursive" or fading = "none"',
        )


def _intensity(
    settings: Mapping[str, Any], order: int, r: float, resolution: float, period_s: float
) -> float:
    q, bandwidth_hz = settings["q"], settings["bandwidth_hz"]
    if q > 0.0:
        if bandwidth_hz != DEFAULT_BANDWIDTH_HZ:
            raise ConfigError(
                f"estimator kalman: q = {q:g} and bandwidth_hz = {bandwidth_hz:g} Hz are given; only one is allowed",
                remedy="give one of the two",
            )
        return float(q * period_s ** (2 * order - 1) / resolution**2)
    check_below_nyquist("kalman", "bandwidth_hz", bandwidth_hz, period_s)
    return float((2.0 * math.pi * bandwidth_hz * period_s) ** (2 * order) * r)


ESTIMATOR = Estimator(
    name="kalman",
    summary="Kalman filter on two or three integrators, with fading",
    source="Chawda et al., section II.B; Bélanger et al. (1998)",
    update=update,
    floats=SQUARES + LONGEST_MEMORY,
    ints=INTS,
    settings=(
        Choice("model", "triple", tuple(ORDERS), "integrators between white noise and position"),
        Setting(
            "bandwidth_hz", DEFAULT_BANDWIDTH_HZ, 0.1, 1e6, "Hz", "ω0/2π of the steady filter, if q is 0"
        ),
        # The paper's q = 2.5e4 with variance = "paper", at 1 kHz and 1 µm, is a bandwidth of 327 Hz: nearly a finite
        # difference.
        Setting(
            "q",
            0.0,
            0.0,
            1e20,
            "position²/s⁵",
            "density of white jerk (double: of acceleration, position²/s³)",
        ),
        Choice("noise", "integral", ("integral", "printed"), "covariance of the process noise"),
        Choice(
            "variance",
            "rounding",
            tuple(VARIANCES),
            "variance of the measurement: Δ²/12, or the paper's Δ²/3",
        ),
        Choice(
            "gain",
            "recursive",
            ("recursive", "steady"),
            "gain: recursive, with the covariance updated in each step, or steady, its limit",
        ),
        Choice("fading", "none", FADINGS, "estimate of the innovations' variance"),
        Setting("fading_window", 16.0, 1.0, LONGEST_MEMORY, "samples", 'memory of fading = "window"'),
        Setting("forgetting", 0.95, 0.0, 1.0, "1", 'weight ρ of the past for fading = "stf"'),
    ),
    design=design,
    position=OFFSET,
)
