"""The Lipschitz constant C from a motion: sums of sines whose second derivative is known."""

from typing import Any

import numpy as np
import pytest

from rig.control.estimators.arrays import quantise
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.experiments.estimation.lipschitz import MARGIN, identify_lipschitz

QUANTUM = 1e-6


def chord(time_s: Any, sines: Any) -> Any:
    """Return position and second derivative of Σ A·sin(2πft + φ)."""
    w = [(a, 2 * np.pi * f, p) for a, f, p in sines]
    position = sum(a * np.sin(k * time_s + p) for a, k, p in w)
    return position, sum(-a * k * k * np.sin(k * time_s + p) for a, k, p in w)


SINES = ((1.5e-3, 7.0, 0.3), (4e-4, 23.0, -1.1), (8e-5, 61.0, 2.0))


@pytest.mark.parametrize("rate_hz", [1000, 10_000])
@pytest.mark.parametrize("noise", [0.0, 2e-6])
def test_fit_of_noisy_sines_gives_their_largest_acceleration(rate_hz: int, noise: float) -> None:
    time_s = 5.0 + np.arange(0.0, 0.4, 1 / rate_hz)  # a recording does not begin at zero
    position, second = chord(time_s, SINES)
    random = np.random.default_rng(11)
    measured = QUANTUM * quantise(position + random.normal(0, noise, len(position)), QUANTUM) + 0.02
    fit = identify_lipschitz(time_s, measured, sines=3)
    inner = (time_s >= time_s[0] + MARGIN * 0.4) & (time_s <= time_s[-1] - MARGIN * 0.4)
    assert fit.lipschitz == pytest.approx(np.abs(second[inner]).max(), rel=0.03)
    assert fit.second_derivative[inner] == pytest.approx(second[inner], abs=0.03 * np.abs(second).max())
    assert fit.frequencies_hz == pytest.approx([7.0, 23.0, 61.0], rel=0.01)
    assert fit.amplitudes == pytest.approx([1.5e-3, 4e-4, 8e-5], rel=0.05)
    assert fit.offset == pytest.approx(0.02, abs=1e-5)
    assert fit.residual_rms == pytest.approx(np.hypot(noise, QUANTUM / np.sqrt(12)), rel=0.15)


def test_the_reported_numbers_are_the_fitted_curve() -> None:
    time_s = np.arange(0.0, 0.5, 1e-3)
    position, _ = chord(time_s, SINES)
    fit = identify_lipschitz(time_s, position + 0.01, sines=3)
    again = list(zip(fit.amplitudes, fit.frequencies_hz, fit.phases, strict=True))
    rebuilt, second = chord(time_s - time_s[0], again)
    assert fit.fitted == pytest.approx(rebuilt + fit.offset, abs=1e-12)
    assert fit.second_derivative == pytest.approx(second, abs=1e-9 * fit.lipschitz)
    assert set(plain(fit)) == {
        "lipschitz", "residual_rms", "offset", "frequencies_hz", "amplitudes", "phases",
    }  # fmt: skip


def test_a_handle_that_never_moved_has_no_acceleration() -> None:
    fit = identify_lipschitz(np.arange(100) * 1e-3, np.full(100, 0.3), sines=2)
    assert fit.lipschitz == 0.0
    assert fit.residual_rms == 0.0


def test_unfittable_motion_is_refused() -> None:
    t = np.arange(100) * 1e-3
    with pytest.raises(ConfigError, match=r"shape \(100,\) and position \(99,\)"):
        identify_lipschitz(t, np.zeros(99))
    with pytest.raises(ConfigError, match=r"11 sines cannot be fitted to 100 samples.*1 to 10"):
        identify_lipschitz(t, np.zeros(100), sines=11)
    with pytest.raises(ConfigError, match="0 sines"):
        identify_lipschitz(t, np.zeros(100), sines=0)
    with pytest.raises(ConfigError, match="at least 10 samples"):
        identify_lipschitz(t[:5], np.zeros(5), sines=1)
    with pytest.raises(ConfigError, match="times do not increase"):
        identify_lipschitz(t[::-1], np.zeros(100))
    with pytest.raises(ConfigError, match="finite"):
        identify_lipschitz(t, np.full(100, np.nan))
