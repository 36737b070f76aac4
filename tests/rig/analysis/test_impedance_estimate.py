"""Impedance estimates of known rigs, against other integrators, other transforms, and noise of known size."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import csd, get_window

from rig.analysis.impedance._estimate import periodic, residual_share
from rig.analysis.impedance._fitting import fit
from rig.analysis.impedance._signals import ExcitedRun, hold
from rig.analysis.impedance._welch import TFESTIMATE, WelchSettings, align_signals, estimate_welch
from rig.control.excitation import Multisine
from rig.core.errors import ConfigError
from rig.core.present import plain

M, B = 0.52, 13.2  # the carriage of Chawda et al.
RATE = 4000.0


def mass_damper(f: Any) -> Any:
    return 2j * np.pi * f * M + B


def excited(
    multisine: Multisine, model: Any = mass_damper, *, periods: int = 1, rate: Any = RATE, **noise: Any
) -> ExcitedRun:
    """Return the steady state of a linear rig, with white noise of the given rms on effort and position."""
    random = np.random.default_rng(noise.get("seed", 1))
    effort, position = multisine.period(rate), multisine.position(model).period(rate)
    n = len(effort)
    played, moved = np.tile(effort, periods), np.tile(position, periods)
    pushed = played + noise.get("effort", 0.0) * random.standard_normal(n * periods)
    moved = moved + noise.get("position", 0.0) * random.standard_normal(n * periods)
    return ExcitedRun(rate, n, periods, played, pushed, moved, multisine.lines_hz)


def test_phase_of_a_mass_damper_from_an_independent_integrator() -> None:
    """90° − atan(b/(m·ω)) within 0.1° (0.001° here) from 5 to 500 Hz, on data from scipy's DOP853."""
    lines = np.array([5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])
    multisine = Multisine(0.2, lines, np.full(7, 2.0), np.linspace(0.0, 5.0, 7))
    t, (size, phase) = np.arange(800) / RATE, (multisine.amplitudes, multisine.phases)
    exact: Any = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-11, "max_step": 5e-4}
    solution = solve_ivp(
        lambda time, y: [y[1], (float(size @ np.cos(2 * np.pi * lines * time + phase)) - B * y[1]) / M],
        (0.0, 1.0), [0.0, 0.0], t_eval=0.8 + t, **exact,  # 20 time constants m/b after the start
    )  # fmt: skip
    run = ExcitedRun(RATE, 800, 1, multisine.at(t), multisine.at(t), solution.y[0], lines)
    found = periodic([run])
    expected = 90.0 - np.degrees(np.arctan(B / (M * 2 * np.pi * lines)))
    assert found.phase_deg == pytest.approx(expected, abs=1e-3)
    assert found.magnitude == pytest.approx(np.abs(mass_damper(lines)), rel=1e-5)
    bare = fit(found)
    assert bare.values["inertia"] == pytest.approx(M, rel=1e-5)
    assert bare.values["damping"] == pytest.approx(B, rel=1e-3)


def test_a_linear_rig_without_noise_is_found_exactly() -> None:
    runs = [excited(Multisine.random((1.0, 300.0), seed=s, rms=3.0), periods=2) for s in range(3)]
    found = periodic(runs)
    assert found.z == pytest.approx(mass_damper(found.lines_hz), rel=1e-9)
    assert found.deviation.max() < 1e-9 * found.magnitude.min()
    assert found.coherence_effort == pytest.approx(1.0)
    assert found.coherence_motion == pytest.approx(1.0)
    assert found.residual < 1e-15
    assert (found.realisations, found.periods, found.variance_from) == (3, 6, "realisations")


def test_scipys_cross_spectra_agree_with_the_ratio_of_lines() -> None:
    """With one boxcar segment per period, scipy's code computes the same ratio."""
    run = excited(Multisine.schroeder((1.0, 300.0), rms=3.0), periods=5, effort=0.3, position=2e-6)
    settings = {"window": "boxcar", "nperseg": 4000, "noverlap": 0, "detrend": False, "fs": RATE}
    f, rf = csd(run.excitation, run.effort, **settings)
    _, rx = csd(run.excitation, run.position, **settings)
    _, rr = csd(run.excitation, run.excitation, **settings)
    _, ff = csd(run.effort, run.effort, **settings)
    lines = run.lines_hz.astype(int)
    found = periodic([run])
    assert found.z == pytest.approx(rf[lines] / (2j * np.pi * f * rx)[lines], rel=1e-3)
    level = replace(run, position=run.level_position())  # the drift that noise pretends is all that differs
    _, rx = csd(level.excitation, level.position, **settings)
    assert found.z == pytest.approx(rf[lines] / (2j * np.pi * f * rx)[lines], rel=1e-9)
    assert found.coherence_effort == pytest.approx((np.abs(rf[lines]) ** 2 / (rr * ff).real[lines]), rel=1e-9)


def test_the_stated_variance_is_the_scatter_of_repeated_measurements() -> None:
    """With noise in both channels, the chi-square of 80 estimates of 20 lines has its expected mean."""
    excites = [Multisine.random((10.0, 200.0), seed=s, rms=3.0, spacing_lines=10) for s in range(4)]
    score, parts = [], []
    for trial in range(80):
        runs = [
            excited(s, rate=500.0, effort=0.5, position=2e-6, seed=(trial, i)) for i, s in enumerate(excites)
        ]
        found = periodic(runs)
        error = found.z - mass_damper(found.lines_hz)
        score.append(np.mean(np.abs(error) ** 2 / found.variance))
        parts.append((np.mean(error.real**2), np.mean(error.imag**2)))
    # With three complex degrees of freedom |error|²/variance has the mean ν/(ν − 1) of F(2, 2ν), ν = 3, and the
    # variance 27/4: three standard deviations of the mean of 1600.
    assert np.mean(score) == pytest.approx(1.5, abs=3.0 * np.sqrt(6.75 / 1600))
    real, imaginary = np.mean(parts, axis=0)
    assert real == pytest.approx(imaginary, rel=0.12)  # circular, as `deviation` takes it


def test_student_keeps_the_promise_of_a_z_score_with_few_realisations() -> None:
    excites = [Multisine.random((10.0, 200.0), seed=s, rms=3.0, spacing_lines=10) for s in range(3)]
    beyond = []
    for trial in range(80):
        runs = [excited(s, rate=500.0, effort=0.5, seed=(trial, i)) for i, s in enumerate(excites)]
        found = periodic(runs)
        beyond.append((found.z - mass_damper(found.lines_hz)).real < -found.spread(2.0))
    # The one-sided 2σ share of a normal variable, within three standard deviations of a count of 1600.
    assert np.mean(beyond) == pytest.approx(0.0228, abs=3.0 * np.sqrt(0.0228 / 1600))


def test_one_period_of_one_realisation_has_no_variance() -> None:
    found = periodic([excited(Multisine.schroeder((1.0, 50.0), rms=1.0))])
    assert np.isnan(found.variance).all()
    assert np.isnan(found.coherence_motion).all()
    assert np.isnan(found.residual)  # all bins of the band are lines
    assert found.variance_from == "nothing"


@pytest.mark.parametrize("late", [0.25e-3, -0.1e-3])
def test_channels_are_aligned_by_the_delays_that_they_declare(late: float) -> None:
    multisine = Multisine.schroeder((1.0, 400.0), rms=1.0)
    plain = excited(multisine)
    t = np.arange(4000) / RATE
    effort, position = multisine.at(t - late), multisine.position(mass_damper).at(t - 3 * late)
    delays = {"effort_delay_s": late, "position_delay_s": 3 * late}
    skewed = replace(plain, effort=effort, position=position, **delays)
    assert periodic([skewed]).z == pytest.approx(periodic([plain]).z, rel=1e-9)
    wrong = periodic([replace(skewed, position_delay_s=0.0)])
    turned = np.degrees(np.angle(wrong.z / mass_damper(wrong.lines_hz)))
    assert turned[99] == pytest.approx(360.0 * 100.0 * 3 * late, abs=1e-6)
    f, v = align_signals(skewed)[1:]
    assert f == pytest.approx(plain.effort, abs=1e-9)
    assert v == pytest.approx(multisine.velocity(mass_damper).period(RATE), abs=1e-9)


def test_an_effort_held_over_its_sample_is_taken_for_what_it_is() -> None:
    """An effort held at 4 kHz but treated as sampled leads by 4.5° at 100 Hz (see REPRODUCTION)."""
    multisine = Multisine.schroeder((1.0, 400.0), rms=1.0)
    # What a staircase has of itself at the lines.
    acting = multisine.through(hold(multisine.lines_hz, 1 / RATE))
    run = replace(excited(multisine), position=acting.position(mass_damper).period(RATE))
    exact = mass_damper(multisine.lines_hz)
    assert periodic([replace(run, effort_hold_s=1 / RATE)]).z == pytest.approx(exact, rel=1e-9)
    bias = np.degrees(np.angle(periodic([run]).z / exact))
    assert bias[[49, 99, 249]] == pytest.approx([2.25, 4.5, 11.25], abs=1e-6)


def test_the_drift_of_a_free_rig_is_taken_out_and_nothing_else() -> None:
    run = excited(Multisine.schroeder((1.0, 100.0), rms=1.0), periods=3)
    away = replace(run, position=run.position + 0.3 + 0.01 * np.arange(12_000) / RATE)
    assert periodic([away]).z == pytest.approx(periodic([run]).z, rel=1e-6)
    assert run.level_position() == pytest.approx(run.position - run.position.mean(), abs=1e-15)


def test_residual_is_the_share_of_velocity_power_off_the_lines() -> None:
    run = excited(Multisine.schroeder((5.0, 100.0), rms=1.0), periods=4)
    speed = align_signals(run)[2]
    t = np.arange(16_000) / RATE
    w = 2 * np.pi * 60.25  # between two lines
    chatter = np.sqrt(2.0 * np.mean(speed**2))  # velocity amplitude with as much power again
    for size, share in ((1.0, 0.5), (0.5, 0.2)):
        chattering = replace(run, position=run.position + size * chatter / w * np.sin(w * t))
        assert periodic([chattering]).residual == pytest.approx(share, rel=1e-4)
        assert residual_share([chattering], (5.0, 50.0)) == pytest.approx(0.0, abs=1e-3)
        assert periodic([chattering, run]).residual == pytest.approx(size**2 / (2.0 + size**2), rel=1e-4)


@pytest.mark.exhaustive("::test_the_stated_variance_is_the_scatter_of_repeated_measurements")
def test_the_instrument_is_not_biased_by_noise_of_the_motion_and_h1_is() -> None:
    """H1 estimates |H|·S_vv/(S_vv + S_nn); segments are whole periods, so leakage adds nothing."""
    settings = WelchSettings(window="boxcar", segment_s=1.0, overlap=0.0, transform_samples=1000)
    multisine = Multisine.random((10.0, 400.0), seed=3, rms=3.0)
    run = excited(multisine, rate=1000.0, periods=400, position=1.5e-6)
    lines = multisine.lines_hz
    signal = multisine.velocity(mass_damper).amplitudes ** 2 / 2
    noise = (2 * np.pi * lines * 1.5e-6) ** 2 * 2 / 1000  # power of white noise in a bin of one period
    h1 = estimate_welch([run], settings)
    found = estimate_welch([run], replace(settings, estimator="instrument"))
    truth = np.abs(mass_damper(lines))
    assert noise[-1] > 0.3 * signal[-1]
    assert found.magnitude / truth == pytest.approx(1.0, abs=0.15)
    assert np.mean(found.magnitude / truth) == pytest.approx(1.0, abs=0.01)
    assert h1.magnitude / truth == pytest.approx(signal / (signal + noise), abs=0.15)
    assert found.z == pytest.approx(periodic([run]).z, rel=1e-2)
    assert (h1.method, found.method) == ("welch-h1", "welch")


def test_welch_is_scipys_with_the_settings_of_tfestimate() -> None:
    run = excited(Multisine.schroeder((1.0, 300.0), rms=3.0), periods=4, effort=0.2)
    length = int(16_000 / 4.5)
    assert TFESTIMATE.segment(16_000, RATE) == length == 3555
    assert TFESTIMATE.transform(length) == 4096
    assert TFESTIMATE.transform(100) == 256
    velocity = np.tile(Multisine.schroeder((1.0, 300.0), rms=3.0).velocity(mass_damper).period(RATE), 4)
    window = get_window("hamming", length, fftbins=False)
    own = {"fs": RATE, "window": window, "noverlap": length // 2, "nfft": 4096, "detrend": False}
    f, vf = csd(velocity, run.effort, **own)
    _, vv = csd(velocity, velocity, **own)
    inside = (f >= 1.0) & (f <= 300.0)
    found = estimate_welch([run])
    assert found.lines_hz == pytest.approx(f[inside])
    assert found.z == pytest.approx((vf / vv)[inside], rel=1e-6)


@pytest.mark.exhaustive("::test_welch_is_scipys_with_the_settings_of_tfestimate")
def test_welchs_variance_is_the_scatter_over_records_of_noise() -> None:
    """White noise through a resistor with its own noise: z = 2, n segments of known weight."""
    random = np.random.default_rng(4)
    lines = np.arange(10.0, 100.0)
    for estimator in ("h1", "instrument"):
        settings = WelchSettings(segment_s=0.25, estimator=estimator)
        estimates = []
        for _ in range(30):
            r = random.standard_normal(4000)
            position = np.fft.irfft(np.fft.rfft(r) / np.maximum(0.5j * np.pi * np.arange(2001), 1j), 4000)
            effort = 2.0 * r + random.standard_normal(4000)
            run = ExcitedRun(1000.0, 4000, 1, r, effort, position, lines)
            estimates.append(estimate_welch([run], settings))
        scatter = np.mean([np.abs(e.z - 2.0) ** 2 for e in estimates])
        assert np.mean([e.variance for e in estimates]) == pytest.approx(scatter, rel=0.14)


def test_a_rig_that_does_not_move_gives_no_number_and_no_exception() -> None:
    run = replace(excited(Multisine.schroeder((1.0, 20.0), rms=1.0), periods=2), position=np.zeros(8000))
    found = periodic([run, run])
    assert not np.isfinite(found.z).any()
    assert found.coherence_motion == pytest.approx(0.0)
    assert json.loads(json.dumps(plain(found), allow_nan=False))["z"]["real"][0] is None
    assert not np.isfinite(estimate_welch([run]).z).any()


def test_runs_that_do_not_belong_together_are_refused() -> None:
    run = excited(Multisine.schroeder((1.0, 20.0), rms=1.0))
    other = excited(Multisine.schroeder((1.0, 21.0), rms=1.0))
    with pytest.raises(ConfigError, match="no runs"):
        periodic([])
    with pytest.raises(ConfigError, match="the runs differ in"):
        periodic([run, other])
    for message, changes in (
        ("shape", {"periods": 2}), ("contains NaN or infinity", {"position": np.full(4000, np.nan)}),
        ("lines", {"lines_hz": np.array([1.5])}), ("lines", {"lines_hz": np.array([2000.0])}),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=message):
            replace(run, **changes)
    with pytest.raises(ConfigError, match="no excited frequency"):
        periodic([run]).within((30.0, 40.0))
    with pytest.raises(ConfigError, match="overlap"):
        estimate_welch([run], WelchSettings(overlap=1.0))
    with pytest.raises(ConfigError, match="no frequency"):
        estimate_welch([replace(run, lines_hz=np.array([1.0]))], WelchSettings(segment_s=0.1))
