"""The Kalman filter against matrices in SI units, the Riccati equation, and physical requirements."""
# ruff: noqa: N806  (matrices have capital letters)

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from rig.control import estimators
from rig.control.estimators._kalman import GAIN1, P11, P12, P13, P22, P23, P33
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities

RESOLUTION, PERIOD = 1e-6, 1e-3  # Chawda et al., section V
FADINGS = ("instant", "window", "stf")


def prepare(resolution: Any = RESOLUTION, period_s: Any = PERIOD, **given_settings: Any) -> Any:
    return estimators.get("kalman").prepare(given_settings, resolution, period_s)


def covariance(prepared: Any) -> Any:
    p = prepared.state_f
    return np.array([[p[P11], p[P12], p[P13]], [p[P12], p[P22], p[P23]], [p[P13], p[P23], p[P33]]])


def textbook(
    counts: Any, elapsed: Any, *, order: Any, q: Any, r: Any, fading: str = "none", memory: int = 16,
    rho: float = 0.95, printed: bool = False, period: Any = PERIOD, resolution: Any = RESOLUTION,
) -> Any:  # fmt: skip
    """Return velocities and largest λ of the textbook filter: matrices, metres and seconds, absolute positions."""
    T, n = period, order
    A = linalg.expm(np.diag(np.ones(n - 1), 1) * T)
    H = np.eye(1, n)
    units = np.diag([T**-i for i in range(n)])
    Q = np.array(
        [
            [
                q * T ** (2 * n + 1 - i - j)
                / (math.factorial(n - i) * math.factorial(n - j))
                / (math.factorial(2 * n + 1 - i - j) if printed else 2 * n + 1 - i - j)
                for j in range(1, n + 1)
            ]
            for i in range(1, n + 1)
        ]
    )  # fmt: skip
    x = np.zeros((n, 1))
    x[0] = counts[0] * resolution
    P = units @ np.diag([r, *[resolution**2] * (n - 1)]) @ units.T
    power, squares, out, largest = None, [], [0.0], 1.0
    for count, periods in zip(counts[1:], elapsed[1:], strict=True):
        for _ in range(periods - 1):
            x, P = A @ x, A @ P @ A.T + Q
        x, M = A @ x, A @ P @ A.T
        nu = (count * resolution - H @ x).item()
        squares.append(nu**2)
        power = nu**2 if power is None else (rho * power + nu**2) / (1 + rho)
        c0 = {"none": 0.0, "instant": nu**2, "window": np.mean(squares[-memory:]), "stf": power}[fading]
        fade = max(1.0, (c0 - r - Q[0, 0]) / M[0, 0])
        P = fade * M + Q
        K = P @ H.T / ((H @ P @ H.T).item() + r)
        x = x + K * nu
        L = np.eye(n) - K @ H
        P = L @ P @ L.T + r * K @ K.T
        out.append(x[1, 0])
        largest = max(largest, fade)
    return np.array(out), largest


MOTION = st.lists(
    st.tuples(st.integers(-30, 30), st.sampled_from([1, 1, 1, 1, 2, 5])), min_size=2, max_size=60
)


@given(
    samples=MOTION,
    order=st.sampled_from([2, 3]),
    variance=st.sampled_from([("rounding", 12), ("paper", 3)]),
    fading=st.sampled_from(["none", *FADINGS]),
    bandwidth_hz=st.sampled_from([5.0, 40.0, 250.0]),
    memory=st.sampled_from([1, 4, 16, 64]),
    rho=st.sampled_from([0.0, 0.5, 0.95]),
)
def test_every_variant_is_the_textbook_filter(
    samples: Any, order: Any, variance: Any, fading: Any, bandwidth_hz: Any, memory: Any, rho: Any
) -> None:
    """The product computes with scalars in counts and periods about a moving origin, the oracle with SI matrices."""
    name, divisor = variance
    counts, elapsed = np.cumsum([s for s, _ in samples]).tolist(), [n for _, n in samples]
    r = RESOLUTION**2 / divisor
    q = (2 * math.pi * bandwidth_hz) ** (2 * order) * r * PERIOD
    expected, _ = textbook(counts, elapsed, order=order, q=q, r=r, fading=fading, memory=memory, rho=rho)
    mine = velocities(
        prepare(
            model="triple" if order == 3 else "double", q=q, variance=name, fading=fading,
            fading_window=memory, forgetting=rho,
        ),
        counts, elapsed,
    )  # fmt: skip
    scale = np.abs(expected).max() + RESOLUTION / PERIOD
    assert mine == pytest.approx(expected, rel=1e-7, abs=1e-7 * scale)


@pytest.mark.parametrize("fading", ["none", *FADINGS])
def test_the_noise_as_printed_runs_as_printed(fading: Any) -> None:
    random = np.random.default_rng(2)
    counts = np.cumsum(random.integers(-20, 20, 200)).tolist()
    r, bandwidth_hz = RESOLUTION**2 / 3, 100.0
    q = (2 * math.pi * bandwidth_hz) ** 6 * r * PERIOD
    expected, largest = textbook(counts, [1] * 200, order=3, q=q, r=r, fading=fading, printed=True)
    mine = velocities(prepare(q=q, variance="paper", noise="printed", fading=fading), counts)
    assert mine == pytest.approx(expected, rel=1e-7, abs=1e-7 * np.abs(expected).max())
    assert (largest > 2.0) == (fading != "none")  # fading really happened


@pytest.mark.parametrize(("model", "order"), [("triple", 3), ("double", 2)])
def test_a_bandwidth_is_a_q(model: str, order: int) -> None:
    by_bandwidth = prepare(model=model, bandwidth_hz=50.0).parameters
    q = (2 * math.pi * 50.0) ** (2 * order) * (RESOLUTION**2 / 12) * PERIOD
    assert by_bandwidth == pytest.approx(prepare(model=model, q=q).parameters, rel=1e-12)


@pytest.mark.parametrize("model", ["triple", "double"])
@pytest.mark.parametrize("bandwidth_hz", [1.0, 30.0, 100.0, 450.0])
def test_the_recursion_converges_to_the_steady_gain(model: str, bandwidth_hz: float) -> None:
    """PHYSICS 2i (A) 1: two ways to one number, the recursion of the loop and scipy's Riccati equation."""
    recursive = prepare(model=model, bandwidth_hz=bandwidth_hz)
    velocities(recursive, [0] * int(20_000 / bandwidth_hz + 50))
    gain = covariance(recursive)[0] * 12  # the first row of the covariance is r·K
    steady = prepare(model=model, bandwidth_hz=bandwidth_hz, gain="steady")
    assert gain == pytest.approx(steady.parameters[GAIN1 : GAIN1 + 3], rel=1e-6, abs=1e-15)


@pytest.mark.parametrize("noise", ["integral", "printed"])
@pytest.mark.parametrize("fading", ["none", *FADINGS])
def test_a_burst_of_false_counts_is_forgotten(fading: Any, noise: str) -> None:
    """Jumps over the whole counter range must not persist in the state or the covariance."""
    random = np.random.default_rng(6)
    counts = np.cumsum(random.integers(-3, 4, 3000)).tolist()
    burst = random.integers(-(2**31), 2**31, 7).tolist()
    clean, hit = (prepare(bandwidth_hz=20.0, fading=fading, noise=noise) for _ in range(2))
    expected = velocities(clean, counts)[-1000:]
    seen = velocities(hit, [0] * 50 + burst + counts)[-1000:]
    assert seen == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_over_a_gap_the_steady_filter_predicts_with_its_acceleration() -> None:
    """At constant acceleration without rounding, lost samples cost no accuracy."""
    elapsed = [1] * 400 + [7, 1, 30, 1]
    k = np.cumsum(elapsed) - 1
    for gain in ("recursive", "steady"):
        v = velocities(prepare(gain=gain), (k**2).tolist(), elapsed)
        assert v[-4:] / (RESOLUTION / PERIOD) == pytest.approx(2 * k[-4:], rel=1e-6)


def test_a_gap_of_days_is_a_restart_from_the_mean_slope() -> None:
    later = [0, 1000, 1003, 1009]
    v = velocities(prepare(), [5, 50, 10_050], [1, 1, 2000])
    assert v[-1] == pytest.approx(5 * RESOLUTION / PERIOD, rel=1e-12)
    one, two = prepare(), prepare()
    velocities(one, [5, 50, -7, 10_050])
    a = velocities(one, later, [10**9, 1, 1, 1])
    b = velocities(two, [10_050, *later], [1, 10**9, 1, 1, 1])[1:]
    assert (a == b).all()  # whatever was before


VARIANTS = [
    *[{"model": m, "gain": g} for m in ("triple", "double") for g in ("recursive", "steady")],
    *[{"noise": n, "fading": f} for n in ("integral", "printed") for f in FADINGS],
    {"noise": "printed", "bandwidth_hz": 900.0},
    {"noise": "printed", "bandwidth_hz": 900.0, "fading": "instant"},
    {"noise": "printed", "gain": "steady"},
]


@pytest.mark.parametrize("chosen", VARIANTS)
def test_every_variant_keeps_the_promises_of_the_family(chosen: Any) -> None:
    linear = "fading" not in chosen and chosen.get("bandwidth_hz") is None
    check_estimator("kalman", chosen, linear=linear)


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"bandwidth_hz": 500.0}, r"bandwidth_hz = 500 Hz is not below the Nyquist frequency 500 Hz"),
        ({"bandwidth_hz": 50.0, "q": 1.0}, r"q = 1 and bandwidth_hz = 50 Hz are given; only one.*give one"),
        ({"model": "double", "noise": "printed"}, r"only for the triple integrator.*integral"),
        ({"gain": "steady", "fading": "stf"}, r"excludes fading.*recursive"),
        ({"noise": "printed", "q": 1e7}, r"negative variances at a bandwidth of ω0·T = .*up to 3"),
        ({"fading_window": 2.5, "fading": "window"}, r"fading_window = 2.5 is not a whole number"),
        ({"model": "quadruple"}, r"model = 'quadruple' is unknown.*triple, double"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(chosen: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        prepare(**chosen)
