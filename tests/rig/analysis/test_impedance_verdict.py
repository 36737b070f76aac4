"""Passivity, residual, fidelity and fits of an impedance: physical identities, and noise of known size."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.analysis.impedance._estimate import Impedance
from rig.analysis.impedance._fitting import RigidRig, fit
from rig.analysis.impedance._verdict import fidelity, judge, passive
from rig.core.errors import ConfigError

M, B = 0.52, 13.2  # the carriage of Chawda et al.
DEVICE = RigidRig(M, B)
LINES = np.arange(1.0, 401.0)


def rig_with_wall(stiffness: Any, damping: Any, lines: Any = LINES) -> Any:
    return Impedance.exact(lines, DEVICE.impedance(lines) + stiffness / (2j * np.pi * lines) + damping)


def noisy(exact: Impedance, deviation: Any, seed: int = 0) -> Impedance:
    """Return the impedance with circular noise of this standard deviation in real and imaginary part."""
    random = np.random.default_rng(seed)
    n = len(exact.z)
    size = np.broadcast_to(deviation, n)
    noise = size * (random.standard_normal(n) + 1j * random.standard_normal(n))
    return replace(exact, z=exact.z + noise, variance=2.0 * size**2)


@given(
    real=st.floats(-50, 50, allow_subnormal=False),
    imaginary=st.floats(-1000, 1000, allow_subnormal=False),
    deviation=st.floats(0, 30, allow_subnormal=False),
    z_score=st.floats(0, 4, allow_subnormal=False),
)
def test_passive_line_has_a_real_part_of_zero_or_more(
    real: float, imaginary: float, deviation: float, z_score: float
) -> None:
    one = Impedance.exact([5.0], [complex(real, imaginary)])
    one = replace(one, variance=np.array([2.0 * deviation**2]))
    found = passive(one, z_score=z_score)
    assert found.passive is (found.margin >= 0.0)
    if abs(found.margin) > 1e-9:
        assert (found.margin > 0.0) is (found.phase_margin_deg > 0.0)
    if z_score == 0.0 and abs(real) > 1e-9:
        assert found.passive == (abs(np.degrees(np.angle(complex(real, imaginary)))) <= 90.0)


def test_worst_and_failed_lines_are_named() -> None:
    z = rig_with_wall(0.0, 0.0, np.arange(1.0, 11.0)).z
    z[3] -= 15.0
    z[6] -= 20.0
    found = passive(Impedance.exact(np.arange(1.0, 11.0), z))
    assert not found.passive
    assert found.failed_hz == (4.0, 7.0)
    assert found.worst_hz == 7.0
    assert found.margin == found.worst_real == pytest.approx(B - 20.0)
    assert abs(found.worst_phase_deg) > 90.0 > 90.0 + found.phase_margin_deg
    inside = passive(Impedance.exact(np.arange(1.0, 11.0), z), (1.0, 3.0))
    assert inside.passive
    assert inside.tested == 3


def test_the_tolerance_is_that_of_the_noise_and_declared() -> None:
    """At Re Z = 0 noise makes half of the lines active; with a tolerance of two deviations one in 44."""
    at_limit = replace(rig_with_wall(0.0, -B, np.arange(1.0, 2001.0)))
    strict = passive(noisy(at_limit, 3.0), z_score=0.0)
    tolerant = passive(noisy(at_limit, 3.0), z_score=2.0)
    assert len(strict.failed_hz) / 2000 == pytest.approx(0.5, abs=0.04)
    assert len(tolerant.failed_hz) / 2000 == pytest.approx(0.0228, abs=0.01)
    assert (strict.z_score, tolerant.z_score) == (0.0, 2.0)
    assert tolerant.worst_tolerance == pytest.approx(6.0)


def test_fidelity_of_no_wall_is_the_rigs_own_impedance() -> None:
    """It is exactly √mean(b² + (2πmf)²) over the lines."""
    for top in (50, 156, 400):
        lines = np.arange(1.0, top + 1.0)
        found = fidelity(rig_with_wall(0.0, 0.0, lines), 0.0, 0.0)
        assert found.rms == pytest.approx(np.sqrt(np.mean(B**2 + (2 * np.pi * M * lines) ** 2)), rel=1e-12)
        assert np.isnan(found.distortion)
        assert (found.lines, found.band_hz) == (top, (1.0, top))
        assert np.isnan(found.stiffness_percent)


def test_fidelity_compares_magnitudes_and_not_phases() -> None:
    mirrored = replace(rig_with_wall(2e4, 30.0), z=rig_with_wall(2e4, 30.0).z.conj())
    assert fidelity(mirrored, 2e4, 30.0).rms == fidelity(rig_with_wall(2e4, 30.0), 2e4, 30.0).rms
    s = 2j * np.pi * LINES
    perfect = Impedance.exact(LINES, 2e4 / s + 30.0)
    found = fidelity(perfect, 2e4, 30.0)
    assert found.rms == pytest.approx(0.0, abs=1e-9)
    assert found.distortion == pytest.approx(0.0, abs=1e-12)
    assert found.stiffness_percent == pytest.approx(100.0)
    assert found.damping_percent == pytest.approx(100.0)


def test_fidelity_states_its_uncertainty() -> None:
    exact = rig_with_wall(2e4, 60.0)
    values = [fidelity(noisy(exact, 20.0, seed), 2e4, 60.0, (20.0, 200.0)) for seed in range(150)]
    stated = np.mean([v.rms_deviation for v in values])
    # Three standard deviations of one of 150 values.
    assert np.std([v.rms for v in values]) == pytest.approx(stated, rel=0.17)
    assert values[0].noise_rms == pytest.approx(20.0)


def test_an_inertia_left_in_makes_a_wall_seem_soft() -> None:
    with_rig, without, as_lines = (
        fidelity(rig_with_wall(2e4, 60.0), 2e4, 60.0, (10.0, 100.0), device=device)
        for device in (None, DEVICE, DEVICE.impedance(LINES))
    )
    low, high = (2e4 - M * (2 * np.pi * hz) ** 2 for hz in (20.0, 10.0))  # −ω·Im Z of the lines averaged
    assert low < with_rig.stiffness < high
    assert without.stiffness_percent == pytest.approx(100.0)
    assert without.damping_percent == pytest.approx(100.0)
    assert as_lines.stiffness == pytest.approx(without.stiffness)
    assert with_rig.rms == without.rms  # the paper's number keeps the rig


@given(
    delay_s=st.floats(0.0, 1e-3, allow_subnormal=False),
    damping=st.floats(0.0, 100.0, allow_subnormal=False),
    high_hz=st.sampled_from([40.0, 400.0]),
)
def test_effective_numbers_are_those_of_the_low_band(delay_s: float, damping: float, high_hz: float) -> None:
    """With a delay τ, a wall's damping is B − K·τ where ω·τ is small, to the next order of its closed form."""
    lines = np.arange(1.0, high_hz + 1.0)
    s, w = 2j * np.pi * lines, 2 * np.pi * lines[:20]
    delayed = DEVICE.impedance(lines) + (2e4 / s + damping) * np.exp(-s * delay_s)
    found = fidelity(Impedance.exact(lines, delayed), 2e4, damping, device=DEVICE)
    assert (found.effective_band_hz, found.effective_lines) == ((1.0, 20.0), 20)
    shift, most = w[-1] * delay_s, 2e4 * delay_s + damping
    assert found.damping == pytest.approx(damping - 2e4 * delay_s, abs=most * shift**2 + 1e-9)
    stiffness = 2e4 * np.cos(w * delay_s) + w * damping * np.sin(w * delay_s)  # −ω·Im Z, line by line
    assert stiffness.min() - 1e-6 <= found.stiffness <= stiffness.max() + 1e-6


def test_too_few_low_lines_state_nothing() -> None:
    found = fidelity(rig_with_wall(2e4, 60.0), 2e4, 60.0, (19.0, 100.0), device=DEVICE)
    assert found.effective_lines == 2
    assert np.isnan([found.stiffness, found.damping, found.stiffness_deviation, found.damping_percent]).all()


def test_misfit_of_the_model_widens_the_interval() -> None:
    """The wall's stiffness halves by 20 Hz: lines are known to 0.1 N·s/m, but its mean stiffness is not."""
    low = 2e4 / (2j * np.pi * LINES) / (1.0 + (LINES / 20.0) ** 2)
    measured = noisy(Impedance.exact(LINES, DEVICE.impedance(LINES) + low), 0.1)
    found = fidelity(measured, 2e4, 0.0, device=DEVICE)
    plain_fit, exact = (
        fit(one, ("stiffness", "damping"), band=(1.0, 20.0), subtract=DEVICE)
        for one in (measured, noisy(rig_with_wall(2e4, 0.0), 0.1))
    )
    assert plain_fit.misfit > 10.0
    assert found.stiffness_deviation == plain_fit.deviations["stiffness"]
    ratio = plain_fit.deviations["stiffness"] / exact.deviations["stiffness"]
    assert ratio == pytest.approx(plain_fit.misfit / max(1.0, exact.misfit), rel=1e-6)


def test_distortion_weighs_relative_errors() -> None:
    s = 2j * np.pi * LINES
    wall = 2e4 / s + 30.0
    tenth = Impedance.exact(LINES, 1.1 * wall)
    assert fidelity(tenth, 2e4, 30.0).distortion == pytest.approx(0.1)
    assert fidelity(tenth, 2e4, 30.0, weight=lambda f: (f <= 100.0) * 1.0).distortion == pytest.approx(0.025)


def test_fits_give_numbers_and_honest_intervals() -> None:
    deviation = 5.0 + 0.1 * LINES
    exact = rig_with_wall(2e4, 60.0)
    terms = ("inertia", "damping", "stiffness")
    fits = [fit(noisy(exact, deviation, seed), terms) for seed in range(150)]
    for name, truth in zip(terms, (M, B + 60.0, 2e4), strict=True):
        values = np.array([f.values[name] for f in fits])
        stated = fits[0].deviations[name]
        assert values.mean() == pytest.approx(truth, abs=4 * stated / np.sqrt(150))
        assert values.std() == pytest.approx(stated, rel=0.17)
    assert np.mean([f.misfit for f in fits]) == pytest.approx(1.0, abs=0.02)
    wrong = fit(noisy(exact, deviation), ("inertia", "damping"))
    assert wrong.misfit > 5.0  # a model without a wall


def test_a_fit_without_variances_reads_them_off_the_misfit() -> None:
    unknown = replace(noisy(rig_with_wall(0.0, 0.0), 5.0), variance=np.full(400, np.nan))
    found = fit(unknown)
    assert found.deviations["damping"] == pytest.approx(5.0 / np.sqrt(400), rel=0.1)
    assert np.isnan(found.misfit)
    assert fit(rig_with_wall(0.0, 0.0)).values == pytest.approx({"inertia": M, "damping": B})


def test_fit_ignores_lines_without_information() -> None:
    one = rig_with_wall(2e4, 60.0)
    z, variance = one.z.copy(), np.ones(400)
    z[5], variance[7] = complex(np.inf, np.nan), np.inf
    z[7] = 1e9
    found = fit(replace(one, z=z, variance=variance), ("stiffness", "damping"), subtract=DEVICE)
    assert found.values["stiffness"] == pytest.approx(2e4)


def test_a_judgement_gives_every_reason() -> None:
    good = rig_with_wall(2e4, 60.0)
    assert judge(good).passive
    assert judge(good).reasons == ()
    bad = rig_with_wall(2e4, -100.0)
    incoherent = np.ones(400)
    incoherent[9] = 0.2
    found = judge(replace(bad, residual=0.4, coherence_motion=incoherent))
    assert not found.passive
    real, residual, coherence = found.reasons
    assert "Re Z is -86.8" in real
    assert "40%" in residual
    assert "0.20 at 10 Hz" in coherence
    assert not judge(replace(good, residual=0.4)).passive
    assert judge(replace(good, residual=0.4), residual_threshold=0.5).passive
    unknown = replace(good, residual=np.nan, coherence_motion=np.full(400, np.nan))
    assert judge(unknown).passive
    assert np.isnan(judge(unknown).least_coherence)


def test_a_rig_that_does_not_move_is_not_passive() -> None:
    stuck = replace(rig_with_wall(0.0, 0.0), z=np.full(400, complex(np.inf, np.nan)))
    found = passive(replace(stuck, variance=np.full(400, np.nan)))
    assert not found.passive
    assert found.phase_margin_deg < 0.0


def test_invalid_bands_and_terms_are_refused() -> None:
    with pytest.raises(ConfigError, match="no excited frequency"):
        passive(rig_with_wall(0.0, 0.0), (500.0, 600.0))
    with pytest.raises(ConfigError, match="parameters to fit"):
        fit(rig_with_wall(0.0, 0.0), ())
    with pytest.raises(ConfigError, match="only 1 frequencies are usable to fit 3"):
        fit(rig_with_wall(0.0, 0.0), ("inertia", "damping", "stiffness"), band=(5.0, 5.0))
    with pytest.raises(ConfigError, match="subtract"):
        fit(rig_with_wall(0.0, 0.0), subtract=np.zeros(3))
