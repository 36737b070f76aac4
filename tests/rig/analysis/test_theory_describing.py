"""Describing functions against integrals, textbook closed forms, and a loop simulated with numpy alone."""

import math

import numpy as np
import pytest

from rig.analysis.theory.describing import reading


@pytest.mark.parametrize("duty", [0.5, 0.3, 0.05])
@pytest.mark.parametrize("amplitude", [0.1, 0.4, 0.9, 1.6, 7.3])
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
