"""Describing functions against integrals and textbook closed forms."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from rig.analysis.theory._describing import limit_cycle, reading
from rig.core.model import Amplifier, Encoder, Mechanics, RigModel


@pytest.mark.parametrize(
    ("amplitude", "duty"), [(0.1, 0.3), (0.4, 0.05), (0.9, 0.5), (1.6, 0.3), (1.6, 0.05), (7.3, 0.5)]
)
def test_the_first_harmonic_of_a_reading_is_that_of_a_rounded_cosine(amplitude: float, duty: float) -> None:
    turn = 2.0 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    wave = np.cos(turn)
    biases = np.linspace(0.0, 1.0, 1001)
    means = [np.rint(bias + amplitude * wave[::100]).mean() for bias in biases]
    bias = biases[int(np.argmin(np.abs(np.array(means) - duty)))]
    harmonic = 2.0 * np.mean(np.rint(bias + amplitude * wave) * wave)
    assert reading(amplitude, duty) == pytest.approx(harmonic, abs=0.02 * max(1.0, amplitude))


def test_a_single_edge_is_a_relay_of_half_a_count() -> None:
    for amplitude in (1e-6, 0.3, 0.99):
        assert reading(amplitude, 0.5) == pytest.approx(2.0 / math.pi)  # Δ/2 · 4/π
    assert reading(0.0, 0.25) == pytest.approx(2.0 / math.pi * math.sin(0.25 * math.pi))


def test_a_large_motion_reads_as_itself() -> None:
    assert reading(300.0, 0.37) == pytest.approx(300.0, rel=1e-3)


# --- a rigid rig with an electrical lag, B = 0: closed forms ------------------------------------------------

J, DAMPER, LAG, COUNT, K = 2e-3, 0.5, 2e-3, 1e-4, 300.0


def rig(coulomb: float = 0.0) -> RigModel:
    mechanics = Mechanics(
        structure="rigid", motor_inertia=J, link_inertia=0.0, motor_damping=DAMPER, motor_coulomb=coulomb
    )
    amplifier, encoder = Amplifier(effort_per_ampere=1.0, effort_limit=1.0, lag_s=LAG), Encoder(quantum=COUNT)
    return RigModel(
        name="textbook", motion="rotary", mechanics=mechanics, amplifier=amplifier, encoder=encoder
    )


FAST = "uniform:100k,estimator=fdm"  # the tick does not count beside the lag
BALANCED = 2.0 / math.pi * K * COUNT  # effort of a single edge's first harmonic


def test_a_relay_round_a_motor_has_the_textbooks_cycle() -> None:
    """K/(s·(J·s + b)·(τ·s + 1)) with a relay: ω² = b/(J·τ), amplitude (4M/π)·K/b·τ₁τ/(τ₁ + τ), τ₁ = J/b, M = Δ/2."""
    slow = J / DAMPER
    found = limit_cycle(rig(), FAST, K, 0.0)
    assert found.frequency_hz == pytest.approx(1.0 / (2.0 * math.pi * math.sqrt(slow * LAG)), rel=5e-3)
    assert found.amplitude == pytest.approx(BALANCED / DAMPER * slow * LAG / (slow + LAG) / COUNT, rel=5e-3)
    assert not found.may_rest
    assert found.alone, "the phase of such a loop falls, and crosses -180 degrees once"


@pytest.mark.parametrize("coulomb", [3e-4, 2e-3])
def test_coulomb_friction_shrinks_it_as_the_balance_of_its_first_harmonic_says(coulomb: float) -> None:
    def excess(w: float) -> float:
        driven = BALANCED / (1.0 + (w * LAG) ** 2)
        return driven * (w * LAG - DAMPER / (J * w)) - 4.0 * coulomb / math.pi

    w = brentq(excess, 350.0, 700.0)
    found = limit_cycle(rig(coulomb), FAST, K, 0.0)
    assert found.frequency_hz == pytest.approx(w / (2.0 * math.pi), rel=1e-2)
    assert found.amplitude == pytest.approx(BALANCED / (1.0 + (w * LAG) ** 2) / (J * w**2) / COUNT, rel=2e-2)
    assert limit_cycle(rig(coulomb), FAST, K, 0.0, friction=False) == limit_cycle(rig(), FAST, K, 0.0)


def test_friction_may_hold_what_it_is_stronger_than_and_ends_the_cycle_in_the_end() -> None:
    half = 0.5 * K * COUNT
    assert not limit_cycle(rig(0.99 * half), FAST, K, 0.0).may_rest
    held = limit_cycle(rig(1.01 * half), FAST, K, 0.0)
    assert held.may_rest
    assert not held.found


def test_a_mean_reading_near_a_whole_count_buzzes_less() -> None:
    whole = limit_cycle(rig(), FAST, K, 0.0).amplitude
    near = limit_cycle(rig(), FAST, K, 0.0, duty=0.1).amplitude
    assert near == pytest.approx(whole * math.sin(0.1 * math.pi), rel=1e-3)
