"""Tracking loop and disturbance observer: poles, motions followed without error, and the tracking loop's bias."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

import rig
from rig.config import settings_of_rig
from rig.control import estimators
from rig.control.estimators import _kalman as kalman
from rig.control.estimators import _poles as poles
from rig.core.errors import ConfigError

RESOLUTION, RATE = 1e-6, 20_000
PERIOD = 1.0 / RATE
INERTIA = 1e-3
COUNTS = np.cumsum(np.random.default_rng(1).integers(-40, 41, 400))


def error_dynamics(gains: list[float], order: int) -> NDArray[np.float64]:
    """Return (I − L·H)·F, the error after the correction, computed without the product's code."""
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])[:order, :order]
    measured = np.eye(order)[0]
    return np.asarray((np.eye(order) - np.outer(gains[:order], measured)) @ transition)


@pytest.mark.parametrize("turn", [1e-4, 1e-2, 0.5, 2.0])
@pytest.mark.parametrize("angles", [(0.75,), (0.5,), (2 / 3, 1.0)])
def test_gains_place_the_poles_of_the_estimation_error(turn: float, angles: tuple[float, ...]) -> None:
    """Compare characteristic polynomials in z − 1, because triple roots near 1 have no well-conditioned values."""
    pairs = [turn * np.exp(1j * math.pi * angle) for angle in angles]
    wanted_poles = [
        complex(p) for pole in pairs for p in ((pole,) if pole.imag < 1e-12 else (pole, pole.conjugate()))
    ]
    order = len(wanted_poles)
    found = error_dynamics(poles.gains(wanted_poles), order) - np.eye(order)
    wanted = np.poly([np.expm1(pole) for pole in wanted_poles]).real
    # Coefficient k has the size turn^k: each is compared with its own, up to rounding of the eigenvalues' sums.
    assert np.poly(found) == pytest.approx(wanted, rel=1e-6, abs=1e-14)


def test_the_tracking_loop_with_the_gains_of_a_steady_kalman_filter_is_that_filter() -> None:
    settings = {"model": "double", "gain": "steady", "bandwidth_hz": 300.0}
    parameters = estimators.get("kalman").prepare(settings, RESOLUTION, PERIOD).parameters
    gain = parameters[kalman.GAIN1 : kalman.GAIN3 + 1].tolist()
    pole = np.log(np.linalg.eigvals(error_dynamics(gain, 2)).astype(complex))[0]
    filtered = rig.estimate("kalman", COUNTS, PERIOD, resolution=RESOLUTION, **settings)
    tracked = rig.estimate(
        "tracking",
        COUNTS,
        PERIOD,
        resolution=RESOLUTION,
        frequency_hz=float(abs(pole)) * RATE / (2.0 * math.pi),
        damping=float(-pole.real / abs(pole)),
    )
    assert tracked == pytest.approx(filtered, rel=1e-9, abs=1e-9 * np.abs(filtered).max())


def test_the_disturbance_observer_without_effort_tends_to_the_steady_kalman_filter_of_three_integrators() -> (
    None
):
    """At high rates both have third-order Butterworth poles; they differ by about ω0·T."""
    common = {"resolution": RESOLUTION}
    filtered = rig.estimate("kalman", COUNTS, PERIOD, **common, bandwidth_hz=50.0, gain="steady")
    observed = rig.estimate(
        "disturbance", COUNTS, PERIOD, **common, frequency_hz=50.0, inertia=INERTIA,
        effort=np.zeros(len(COUNTS)),
    )  # fmt: skip
    turn = 2.0 * math.pi * 50.0 * PERIOD
    assert np.abs(observed - filtered).max() < turn * np.abs(filtered).max()


def motion(effort: NDArray[np.float64], force: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return velocity and position of an inertia, exactly sampled, under a constant force and efforts held a period."""
    acceleration = (effort + force) / INERTIA
    velocity = np.cumsum(acceleration) * PERIOD
    before = velocity - acceleration * PERIOD
    return velocity, np.cumsum(before * PERIOD + 0.5 * acceleration * PERIOD**2)


def test_a_known_effort_and_a_constant_force_leave_only_the_noise_of_the_counts() -> None:
    """A tracking loop would err by 2·ζ·a/ω0; the observer has no lag, and also estimates the constant force."""
    effort = 0.3 * np.sin(2.0 * math.pi * 60.0 * PERIOD * np.arange(RATE))
    velocity, position = motion(effort, 0.02)
    counts = rig.quantise(position, RESOLUTION)
    settled = slice(RATE // 4, None)
    observed = rig.estimate(
        "disturbance", counts, PERIOD, resolution=RESOLUTION, effort=effort, inertia=INERTIA,
        frequency_hz=150.0,
    )  # fmt: skip
    tracked = rig.estimate("tracking", counts, PERIOD, resolution=RESOLUTION, frequency_hz=150.0)
    # Rounding by ±½ count through the filter: at most the sum of its impulse response, some counts times ω0.
    noise = 4.0 * RESOLUTION * 2.0 * math.pi * 150.0
    assert np.abs(observed - velocity)[settled].max() < noise
    assert np.abs(tracked - velocity)[settled].max() > 20.0 * noise


def test_a_handle_pressed_at_rest_reads_zero_because_the_force_is_a_state() -> None:
    """Without the force as a state, a loop fed with the effort F would read −2·ζ·F/(ω0·J) at rest."""
    at_rest = rig.estimate(
        "disturbance", np.zeros(RATE, int), PERIOD, resolution=RESOLUTION, effort=np.full(RATE, -2.0),
        inertia=INERTIA, frequency_hz=150.0,
    )  # fmt: skip
    assert abs(at_rest[-1]) < 1e-9 * 2.0 / (2.0 * math.pi * 150.0 * INERTIA)


def test_an_estimator_that_uses_the_effort_is_refused_without_it() -> None:
    with pytest.raises(ConfigError, match="disturbance needs the effort"):
        rig.estimate("disturbance", COUNTS, PERIOD, resolution=RESOLUTION, inertia=INERTIA)
    with pytest.raises(ConfigError, match="effort has shape"):
        rig.estimate(
            "disturbance", COUNTS, PERIOD, resolution=RESOLUTION, inertia=INERTIA, effort=np.zeros(3)
        )


@pytest.mark.parametrize(("kind", "inertia"), [("constant-effort", 1.02e-3), ("human", 3.2e-4)])
def test_an_observers_inertia_includes_the_end_mass_only_where_it_hangs(kind: str, inertia: float) -> None:
    """A bug gave a person's trial, which has no end mass, an observer with 3.2 times the true inertia."""
    x = rig.load("koul-rigid", changes={"trial.kind": kind, "rig.limits.human": False})
    assert settings_of_rig(x)["inertia"] == pytest.approx(inertia)
