"""Multisines: phases and sizes from closed forms, bounds of peaks, and predicted numbers for a plan."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.excitation import Multisine, ramp
from rig.core.errors import ConfigError
from rig.core.present import plain

BAND = (1.0, 250.0)


def test_unequal_amplitudes_get_schroeders_general_phases() -> None:
    amplitudes = np.array([3.0, 1.0, 2.0, 0.5])
    share = amplitudes**2 / np.sum(amplitudes**2)
    expected = [-2 * np.pi * sum((k - m) * share[m] for m in range(k)) for k in range(4)]
    found = Multisine.schroeder((1.0, 4.0), spectrum=amplitudes, first_phase=0.3)
    assert np.exp(1j * found.phases) == pytest.approx(np.exp(1j * (0.3 + np.array(expected))))
    assert found.amplitudes == pytest.approx(amplitudes)  # absolute, because no size was asked for


@pytest.mark.parametrize("spectrum", ["flat", "mass"])
def test_schroeders_phases_give_less_than_half_the_crest_of_zero_phases(spectrum: str) -> None:
    multisine = Multisine.schroeder(BAND, rms=1.0, spectrum=spectrum)
    aligned = Multisine(1.0, multisine.lines_hz, multisine.amplitudes, np.zeros(250))
    random = [Multisine.random(BAND, seed=s, rms=1.0, spectrum=spectrum).crest_factor for s in range(10)]
    assert 1.5 < multisine.crest_factor < 2.0
    assert multisine.crest_factor < min(random)
    assert 2.8 < np.mean(random) < 4.2
    assert aligned.crest_factor > 10.0


@given(
    seed=st.integers(0, 10_000),
    low=st.integers(1, 20),
    width=st.integers(0, 40),
    spacing=st.integers(1, 4),
    odd=st.booleans(),
)
def test_rms_and_peak_match_a_fine_sampling(seed: int, low: int, width: int, spacing: int, odd: bool) -> None:
    multisine = Multisine.random((low, low + width + 1), seed=seed, peak=3.0, spacing_lines=spacing, odd=odd)
    fine = multisine.at(np.arange(20_000) / 20_000)
    assert np.abs(fine).max() <= 3.0 * (1 + 1e-3)
    assert multisine.peak == pytest.approx(3.0) == pytest.approx(np.abs(fine).max(), rel=2e-3)
    assert multisine.rms == pytest.approx(np.sqrt(np.mean(fine**2)), rel=1e-9)


def test_lines_are_what_was_asked_for() -> None:
    assert Multisine.schroeder((1.0, 3.0), 2.0, rms=1.0).lines_hz == pytest.approx([1, 1.5, 2, 2.5, 3])
    assert Multisine.schroeder((2.0, 9.0), rms=1.0, odd=True).lines_hz == pytest.approx([3, 5, 7, 9])
    assert Multisine.schroeder((2.0, 9.0), rms=1.0, spacing_lines=3).lines_hz == pytest.approx([2, 5, 8])
    odd = Multisine.schroeder((2.0, 9.0), rms=1.0, spacing_lines=2, odd=True)
    assert odd.lines_hz == pytest.approx([3, 7])
    rounded = Multisine.schroeder((0.1, 0.3), 10.0, rms=1.0)  # 0.3 · 10 < 3 in floats
    assert rounded.harmonics.tolist() == [1, 2, 3]


def test_a_mass_moves_equally_fast_at_each_line_of_its_spectrum() -> None:
    speed = Multisine.schroeder(BAND, rms=2.0, spectrum="mass").velocity(lambda f: 2j * np.pi * f * 0.52)
    assert speed.amplitudes == pytest.approx(speed.amplitudes[0])


def test_random_phases_come_from_the_seed_alone() -> None:
    one, same, other = (Multisine.random(BAND, seed=s, rms=1.0) for s in ((5, 1), (5, 1), (5, 2)))
    assert np.array_equal(one.phases, same.phases)
    assert not np.array_equal(one.phases, other.phases)
    assert np.abs(np.mean(np.exp(1j * one.phases))) < 0.2  # all around the circle


@pytest.mark.parametrize("offset", [0.0, 0.5, 0.25])
def test_a_period_is_the_sum_of_cosines_at_its_samples(offset: float) -> None:
    multisine = Multisine.schroeder((3.0, 40.0), 0.5, rms=2.0)
    wanted = multisine.at((np.arange(500) + offset) / 1000.0)
    assert multisine.period(1000.0, offset) == pytest.approx(wanted, abs=1e-12)
    assert multisine.at(0.123) == pytest.approx(multisine.at(0.123 + 3 * 0.5), abs=1e-12)


def test_multisine_fades_in_over_whole_periods() -> None:
    multisine = Multisine.schroeder((3.0, 40.0), 0.5, rms=2.0)
    t = np.linspace(-0.5, 2.0, 2501)
    faded = multisine.ramped(t, 2)
    assert not faded[t <= 0.0].any()
    assert faded[t >= 1.0] == pytest.approx(multisine.at(t[t >= 1.0]))
    assert ramp([0.0, 0.5, 1.0, 7.0], 1.0) == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert ramp([-1.0, 0.0, 1.0], 0.0) == pytest.approx([0.0, 1.0, 1.0])


def test_predicted_motion_is_that_of_the_equation_of_motion() -> None:
    """Inserted into m·x″ + b·x′ + K·x, the predicted position gives the effort again."""
    m, b, k = 0.52, 13.2, 2e4
    multisine = Multisine.schroeder((2.0, 60.0), rms=3.0)
    x = multisine.position(lambda f: 2j * np.pi * f * m + b + k / (2j * np.pi * f))
    t = np.linspace(0, 1, 2_001)[:-1]
    position = x.at(t)
    spectrum, w = np.fft.rfft(position), 2 * np.pi * np.arange(1_001)
    effort = np.fft.irfft((k + 1j * w * b - m * w**2) * spectrum, 2_000)
    assert effort == pytest.approx(multisine.at(t), abs=1e-6)
    v = multisine.velocity(lambda f: 2j * np.pi * f * m + b + k / (2j * np.pi * f))
    assert v.at(t) == pytest.approx(np.fft.irfft(1j * w * spectrum, 2_000), abs=1e-9)


def test_a_plan_gets_numbers_and_limits() -> None:
    m, b, k = 0.52, 13.2, 2e4
    multisine = Multisine.schroeder(BAND, peak=20.0)
    s = 2j * np.pi * multisine.lines_hz
    wall = k / s
    whole = m * s + b + wall
    checks = multisine.check(
        whole, effort_limit=50.0, position_limit=1e-4, speed_limit=2.0, wall=wall, motor_limit=100.0
    )
    by_name = {check.name: check for check in checks}
    assert by_name["peak excitation"].value == pytest.approx(20.0)
    assert by_name["peak excitation"].holds
    assert by_name["peak position"].value == pytest.approx(multisine.position(whole).peak)
    assert not by_name["peak position"].holds  # 20 N move this wall further than 0.1 mm at its resonance
    assert by_name["peak motor effort"].value == pytest.approx(k * multisine.position(whole).peak)
    assert json.loads(json.dumps(plain(checks)))[1]["holds"] is False
    no_wall = multisine.check(m * s + b, channel="motor")
    assert no_wall[-1].value == pytest.approx(20.0)  # all the motor does is excite
    assert all(check.holds for check in no_wall)  # nothing to keep


def test_a_plan_refuses_an_impedance_that_nothing_can_be_divided_by() -> None:
    for impedance in (0.0, np.nan, [1.0, 0.0]):
        with pytest.raises(ConfigError, match="impedance"):
            Multisine.schroeder((1.0, 2.0), rms=1.0).check(impedance, position_limit=1.0)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: Multisine.schroeder((5.0, 1.0), rms=1.0), "band"),
        (lambda: Multisine.schroeder((0.0, 1.0), rms=1.0), "band"),
        (lambda: Multisine.schroeder((1.2, 1.8), rms=1.0), "no spectral line"),
        (lambda: Multisine.schroeder((1.0, 5.0)), "size of the excitation is missing"),
        (lambda: Multisine.schroeder((1.0, 5.0), rms=1.0, peak=1.0), "only one is allowed"),
        (lambda: Multisine.schroeder((1.0, 5.0), rms=-1.0), "size"),
        (lambda: Multisine.schroeder((1.0, 5.0), rms=1.0, spectrum="pink"), "pink"),
        (lambda: Multisine.schroeder((1.0, 5.0), spectrum=[1.0, 2.0]), "2 amplitudes"),
        (lambda: Multisine(1.0, [1.5], [1.0], [0.0]), "multiples"),
        (lambda: Multisine(1.0, [2.0, 1.0], [1.0, 1.0], [0.0, 0.0]), "multiples"),
        (lambda: Multisine(1.0, [1.0], [1.0, 2.0], [0.0]), "amplitudes"),
        (lambda: Multisine(1.0, [np.nan], [1.0], [0.0]), "not a finite number"),
        (lambda: Multisine(0.0, [1.0], [1.0], [0.0]), "period"),
        (lambda: Multisine.schroeder((1.0, 5.0), 0.9, rms=1.0).period(1001.0), "whole number"),
        (lambda: Multisine.schroeder((1.0, 50.0), rms=1.0).period(100.0), "not below half the sampling rate"),
    ],
)
def test_invalid_multisine_is_refused(make: Any, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason) as caught:
        make()
    assert caught.value.remedy
