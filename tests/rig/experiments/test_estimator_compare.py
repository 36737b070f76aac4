"""Scoring and tuning estimators: numbers that closed forms predict, optima that a scan confirms."""

import math
import re
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from rig import config
from rig.config import controller, presets
from rig.control import estimators
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.core.sample import ROW, Phase
from rig.experiments.estimation import tuning
from rig.experiments.estimation._signals import SIGNALS, edge_times, sine
from rig.experiments.estimation.cases import recording_case, signal_case
from rig.experiments.estimation.estimators import (
    Variant,
    compare_estimators,
    default_variants,
    errors,
    estimates,
    rest_noise,
    score,
)
from rig.recording.data import Recording
from tests.conformance.tiers import first_by_default

FINE, COARSE = 1e-6, 2e-5


@cache
def hit(rate_hz: float = 2000, resolution: float = FINE) -> Any:
    return signal_case(SIGNALS["wall-bounce"], rate_hz, resolution)


# --- arrays -----------------------------------------------------------------------------------------------


def test_arrays_are_scored_and_tuned_as_the_signal_that_they_come_from() -> None:
    """Where errors are judged, linear interpolation of true velocities is exact; only edge times may add cost."""
    signal = replace(hit(), judged=np.ones(len(hit().counts), np.bool_))
    mine = rig.counts_case(
        signal.counts, 1 / 2000, resolution=FINE, velocity=signal.truth(signal.time_s),
        edge_time=signal.edge_time, motion="linear", name="wall-bounce",
    )  # fmt: skip
    of_both = rig.compare_estimators([signal, mine], ["fdm-butterworth:cutoff_hz=200", "foaw-end"]).scores
    for one, other in zip(of_both[:2], of_both[2:], strict=True):
        assert one.rms == other.rms
        assert one.delay_s == pytest.approx(other.delay_s, abs=1e-5)
    tuned = rig.tune_estimator("fdm-butterworth", mine, free=["cutoff_hz"])
    assert tuned.objective_best < tuned.objective_start
    assert tuned.settings == rig.tune_estimator("fdm-butterworth", signal, free=["cutoff_hz"]).settings


def test_a_narrow_counter_and_lost_samples_are_taken_as_estimate_takes_them() -> None:
    time_s = np.arange(3000) / 1000
    counts, velocity = np.round(400 * np.sin(2 * time_s)).astype(int), 800e-6 * np.cos(2 * time_s)
    kept = np.flatnonzero(np.random.default_rng(1).random(3000) > 0.1)
    case = rig.counts_case(
        (counts % 256)[kept], 1e-3, resolution=1e-6, velocity=velocity[kept], width=8,
        elapsed=np.diff(kept, prepend=-1), settle_s=1.0,
    )  # fmt: skip
    assert case.time_s == pytest.approx(time_s[kept] - time_s[kept[0]])
    (score,) = rig.compare_estimators(case, ["foaw-end"]).scores
    assert score.rms < 0.1 * case.speed_rms
    assert case.judged_time_s[0] == pytest.approx(1.0, abs=2e-2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"velocity": [0.0, 1.0, np.nan]}, r"3 counts, .*shape \(3,\), 2 of them finite"),
        ({"settle_s": 1.0}, "3 samples last 0.003 s, not longer than the settling time of 1 s"),
        ({"counts": [0, 1.5, 2]}, "is not a whole number"),
        ({"resolution": 0.0}, "is not a valid travel for one count"),
        ({"dt": -1.0}, "is not a valid sampling period"),
    ],
)
def test_arrays_that_cannot_be_judged_are_refused(changes: Any, message: str) -> None:
    given = {"counts": [0, 1, 2], "dt": 1e-3, "resolution": 1e-3, "velocity": [1.0, 1.0, 1.0], **changes}
    with pytest.raises(ConfigError, match=message):
        rig.counts_case(given.pop("counts"), given.pop("dt"), **given)


# --- scores -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", first_by_default([1000, 2000, 20_000]))
def test_a_finite_difference_is_half_a_period_late(rate: int) -> None:
    found = score(hit(rate), Variant("fdm"))
    assert found.delay_s == pytest.approx(0.5 / rate, abs=3e-6)


@pytest.mark.parametrize(
    ("rate", "cutoff_hz"), first_by_default([(2000, 200.0), (20_000, 200.0), (20_000, 1000.0)])
)
def test_a_butterworth_filter_adds_its_delay_to_that(rate: int, cutoff_hz: float) -> None:
    """PHYSICS 2i (A) 4: √2·T/(2·tan(π·fc·T)) at zero frequency, 1.088 ms for 200 Hz at 2 kHz."""
    slow = signal_case(sine(amplitude=0.05, frequency_hz=2.0), rate, FINE)
    found = score(slow, Variant("fdm-butterworth", {"cutoff_hz": cutoff_hz}))
    closed = 0.5 / rate + math.sqrt(2) / (2 * rate * math.tan(math.pi * cutoff_hz / rate))
    assert found.delay_s == pytest.approx(closed, rel=2e-3, abs=2e-6)


def test_a_known_shift_is_found_to_microseconds() -> None:
    case = hit(20_000)
    for shift in (-1.2345e-3, 0.0, 17.7e-3):
        rms, delay_s, left = errors(case, case.truth(case.time_s - shift))
        assert delay_s == pytest.approx(shift, abs=1e-7)
        assert left < 1e-5 * case.speed_rms
        assert rms >= left - 1e-6 * case.speed_rms


def test_a_delay_that_the_signal_does_not_show_is_nan() -> None:
    steady = signal_case(SIGNALS["ramp"], 2000, FINE)
    rms, delay_s, left = errors(steady, estimates(steady, Variant("fdm")))
    assert math.isnan(delay_s)
    assert left == rms
    slow = signal_case(SIGNALS["slow-reversal"], 50_000, COARSE)
    assert math.isnan(score(slow, Variant("fdm")).delay_s), "noise of a hundred times the speed"


def test_the_reference_hit_gives_the_errors_of_the_reference_study() -> None:
    """PHYSICS 2i (C): true rms errors in m/s of the finite difference, with and without the filter."""
    for resolution, rate, fdm, filtered in (
        (1e-6, 1000, 0.0024, 0.0233),
        (2e-5, 20_000, 0.097, 0.0133),
    ):
        case = hit(rate, resolution)
        assert score(case, Variant("fdm")).rms == pytest.approx(fdm, rel=0.1)
        found = score(case, Variant("fdm-butterworth", {"cutoff_hz": 0.05 * rate}))
        assert found.rms == pytest.approx(filtered, rel=0.06)


def test_at_rest_a_resting_count_is_silent_and_a_toggling_one_is_not() -> None:
    """A count that toggles at random gives a finite difference of rms Δ/(√2·T)."""
    rest, toggling = rest_noise(Variant("fdm"), 1e-4, FINE)
    assert rest == 0.0
    assert toggling == pytest.approx(FINE / (math.sqrt(2) * 1e-4), rel=0.05)
    rest, filtered = rest_noise(Variant("fdm-butterworth"), 1e-4, FINE)
    assert rest == 0.0
    assert filtered < 0.1 * toggling


def test_an_estimator_that_needs_edge_times_receives_the_true_ones() -> None:
    case = hit()
    moving = np.diff(case.counts, prepend=case.counts[0]) != 0
    age = case.arrays[1]
    assert (age[moving] < case.dt).all()
    assert np.ptp(age[moving]) > 0.5 * case.dt, "not all at the sample"


def test_every_estimator_is_scored_on_every_case_in_order() -> None:
    cases = [signal_case(s, 2000, COARSE) for s in SIGNALS.values()]
    found = compare_estimators(cases, default_variants(), timed=False)
    expected = [(case.name, name) for case in cases for name in estimators.names()]
    assert [(s.case, s.estimator) for s in found.scores] == expected
    for each in found.scores:
        if each.refused is None:
            assert math.isfinite(each.rms)
            assert each.rms_without_delay <= each.rms * (1 + 1e-9)
            assert each.rest_rms <= each.toggling_rms or each.rest_rms < 1e-3
            assert math.isnan(each.ns_per_sample)
    assert len(plain(found)["scores"]) == len(found.scores)
    assert plain(found)["cases"][0]["reference"] == "closed form"


def test_settings_that_a_rate_does_not_allow_are_reported_not_raised() -> None:
    (found,) = compare_estimators([hit(1000)], [Variant("fdm-butterworth", {"cutoff_hz": 700.0})]).scores
    assert "Nyquist" in found.refused
    assert math.isnan(found.rms)
    with pytest.raises(ConfigError, match="unknown estimator 'fmd'"):
        compare_estimators([hit(1000)], [Variant("fmd")])


# --- recordings -------------------------------------------------------------------------------------------

SWING = sine(amplitude=0.5, frequency_hz=5.0)  # of a lever, in rad
EXPERIMENT = presets.load("koul-rigid")
RATE = EXPERIMENT.controller.position_rate
TRUE_ROW = np.dtype([*ROW.descr, ("position_true", "<f8"), ("velocity_true", "<f8")])


def record_signal(signal: Any = SIGNALS["sine"], *, keep: Any = slice(None), truth: bool = True) -> Recording:
    """Return a recording of a signal (rad) on the experiment's rig; its first 0.1 s precede the trial."""
    delta, times = controller.resolution(EXPERIMENT), np.arange(round(signal.end_s * RATE)) / RATE
    rows = np.zeros(len(times), TRUE_ROW if truth else ROW)
    rows["sample_index"] = 1000 + np.arange(len(times))
    rows["count"] = estimators.quantise(signal(times).position, delta)
    edges = edge_times(signal, times, delta)
    rows["edge_age"] = np.round(1e9 * np.minimum(times - edges, 134.0))
    rows["effort_applied"] = np.arange(len(times))
    rows["phase"] = np.where(times < 0.1, Phase.HOMING, Phase.TRIAL)
    if truth:
        rows["position_true"], rows["velocity_true"], _ = signal(times)
    header = {"experiment": config.as_mapping(EXPERIMENT), "motion": EXPERIMENT.rig.motion}
    return Recording(header, rows[keep])


def test_a_recording_is_judged_over_its_trial_against_the_simulations_truth() -> None:
    case = recording_case(record_signal(SWING), 2000)
    assert (case.reference, case.motion) == ("the simulation's truth", "rotary")
    assert case.dt == pytest.approx(1 / 2000)
    assert case.judged_time_s[0] == pytest.approx(0.1)
    found = score(case, Variant("fdm-butterworth"))
    assert found.delay_s == pytest.approx(0.00025 + 0.001088, rel=0.01)
    assert found.rms_without_delay < 0.05 * case.speed_rms
    assert recording_case(record_signal()).rate_hz == EXPERIMENT.controller.velocity_rate


def test_a_recording_gives_the_estimates_of_the_signal_it_came_from() -> None:
    signal, delta = SIGNALS["sine"], controller.resolution(EXPERIMENT)
    case = recording_case(record_signal(), 2000)
    assert case.effort is not None
    # A mean over the ten ticks of a velocity period, of an effort that rises by one a tick.
    assert np.diff(case.effort[1:]) == pytest.approx(10.0)
    assert case.effort[5] == pytest.approx(50.0 - 4.5)
    direct = replace(signal_case(signal, 2000, delta), effort=case.effort, rig=case.rig)
    assert case.counts.tolist() == direct.counts.tolist()
    for name in sorted(set(estimators.names()) - {"disturbance-two-mass"}):  # the rig is rigid
        expected = estimates(direct, Variant(name))
        ours = estimates(case, Variant(name))
        assert ours == pytest.approx(expected, abs=0.02 * case.speed_rms), name  # edge ages are whole ns


def test_a_real_recording_is_judged_against_a_named_zero_phase_reference() -> None:
    case = recording_case(record_signal(SWING, truth=False), 2000)
    assert case.reference == "zero-phase Butterworth of order 4 at 200 Hz"
    assert case.judged_time_s[-1] < 0.58, "the ends of the reference are guesses"
    assert case.true_velocity == pytest.approx(SWING(case.judged_time_s).velocity, abs=0.05)
    assert score(case, Variant("fdm-butterworth")).delay_s == pytest.approx(0.00134, rel=0.05)


def test_lost_samples_become_elapsed_periods() -> None:
    keep = np.ones(round(SIGNALS["sine"].end_s * RATE), dtype=bool)
    keep[6005:6047] = False
    case = recording_case(record_signal(keep=keep), RATE // 10)
    assert case.elapsed.max() == 4
    assert case.elapsed.sum() == math.ceil(len(keep) / 10)
    assert (np.diff(case.time_s) > 0).all()
    velocity = estimates(case, Variant("fdm"))
    assert np.abs(velocity - case.truth(case.time_s))[1:].max() < 1.1 * abs(case.resolution) / case.dt


def test_a_rate_that_does_not_divide_the_recordings_is_refused_with_one_that_does() -> None:
    with pytest.raises(ConfigError, match=rf"3000 Hz is not a whole fraction.*{RATE} Hz.*choose"):
        recording_case(record_signal(), 3000)
    with pytest.raises(ConfigError, match="has 0 samples"):
        recording_case(record_signal(keep=slice(0)), 2000)


# --- tuning -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("objective", first_by_default(tuning.OBJECTIVES))
def test_the_optimum_is_what_a_fine_scan_finds(objective: Any) -> None:
    case = hit(5000, COARSE)
    found = tuning.tune_estimator("fdm-butterworth", case, objective=objective, free=["cutoff_hz"])
    scan = np.geomspace(20.0, 2400.0, 150)
    variants = [Variant("fdm-butterworth", {"cutoff_hz": f}) for f in scan]
    values = [tuning.OBJECTIVES[objective](case, estimates(case, one)) for one in variants]
    assert found.objective_best <= 1.002 * min(values)
    (within,) = found.ranges
    inside = scan[np.array(values) <= (1 + tuning.WITHIN) * found.objective_best]
    assert within.low == pytest.approx(inside[0], rel=0.1)
    assert within.high == pytest.approx(inside[-1], rel=0.1)
    assert within.low <= within.value <= within.high
    assert not within.open_below
    assert not within.open_above


def test_whole_numbers_are_tuned_as_whole_numbers() -> None:
    found = tuning.tune_estimator("fdm-butterworth", hit(resolution=COARSE), free=["order"])
    assert found.settings["order"] == round(found.settings["order"]) != 2.0


def test_a_setting_that_makes_no_difference_stays_where_it_was() -> None:
    """The window limit ends each chord before the band does, so the band has no effect and stays at 1."""
    found = tuning.tune_estimator("foaw-end", hit(5000, COARSE))
    assert list(found.settings) == ["window_limit"]
    ranges = {one.setting: one for one in found.ranges}
    assert (ranges["band"].value, ranges["band"].open_above) == (1.0, True)
    assert re.search("or more|anything from", tuning.shown_range(ranges["band"]))
    assert "or " not in tuning.shown_range(replace(ranges["band"], open_above=False, open_below=False))


def test_given_settings_are_kept_and_only_free_ones_move() -> None:
    found = tuning.tune_estimator("fdm-butterworth", hit(), settings={"order": 1.0}, free=["cutoff_hz"])
    assert found.settings["order"] == 1.0
    assert [r.setting for r in found.ranges] == ["cutoff_hz"]


def test_a_property_of_the_rig_is_tuned_only_if_it_is_named_and_around_its_value() -> None:
    case = recording_case(record_signal(SWING), 2000)
    usual = tuning.tune_estimator("disturbance", case)
    assert [one.setting for one in usual.ranges] == ["frequency_hz"]
    (within,) = tuning.tune_estimator("disturbance", case, free=["inertia"]).ranges
    reach = 10.0**tuning.DECADES
    assert case.rig["inertia"] / reach <= within.value <= case.rig["inertia"] * reach


def test_the_fragment_is_an_experiment_that_runs_with_these_settings(tmp_path: Path) -> None:
    found = tuning.tune_estimator("fdm-butterworth", hit(), objective="delay-corrected-rms")
    assert tomllib.loads(found.toml())["controller"]["estimator"] == "fdm-butterworth"
    file = tmp_path / "tuned.toml"
    file.write_text('preset = "koul-compliant"\n\n' + found.toml(), encoding="utf-8")
    experiment = config.load_experiment(file)
    assert experiment.controller.parameters["cutoff_hz"] == found.settings["cutoff_hz"]
    config.check_plugins(experiment, "tuned.toml")


@pytest.mark.parametrize(
    ("name", "changes", "text"),
    [
        ("fmd", {}, "unknown estimator 'fmd'"),
        ("fdm-butterworth", {"free": ["cutof"]}, "no numeric setting 'cutof'.*cutoff_hz"),
        ("fdm-butterworth", {"settings": {"cutoff_hz": 5000.0}}, "Nyquist"),
    ],
)
def test_an_impossible_tuning_is_refused(name: str, changes: Any, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        tuning.tune_estimator(name, hit(), **changes)
