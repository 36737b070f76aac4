"""An identification over the byte link: its motions stay within limits, and the parameters are correct."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from rig import config
from rig.analysis.identification._interval import Interval
from rig.analysis.identification._quality import IdentificationError
from rig.analysis.identification._signs import check_signs
from rig.cli.identify import _ripple_pairs
from rig.config import controller, presets
from rig.control.motions import make_nudging_law, make_tracing_law
from rig.core.check import Outcome
from rig.core.errors import ConfigError, PlanError
from rig.core.model import Cogging
from rig.core.sample import ROW, Phase
from rig.devices.framed import FramedDevice
from rig.experiments.identification import identify as identifying
from rig.experiments.identification._identified_values import identified_values
from rig.experiments.identification.identified_file import format_identification
from rig.experiments.identification.identify import IdentifyRequest
from rig.experiments.motion import _motion_run as motion_run
from rig.experiments.motion._motion_run import LONGEST_FILLED, MOST_LOST_SHARE, TimingError, trial_rows, whole
from rig.experiments.trials import _identify_motions as motions
from rig.recording.reader import open_recording
from sim_backend.bare.trial import run_trial
from sim_backend.board.hardware import Hardware
from sim_backend.ends.link import MemoryLink
from sim_backend.mechanics.plant import DiscretePlant
from tests.benchmarks.pulses import OnOtherHardware
from tests.conformance.tiers import first_by_default
from tests.rig.analysis.test_identification_cogging import fitted

CHAWDA, RIGID, COMPLIANT = (presets.load(name) for name in ("chawda-linear", "koul-rigid", "koul-compliant"))


def identified(experiment: Any, directory: Any, **options: Any) -> Any:
    given = {"realisations": 2, "seed": 1, **options}
    return rig.identify(experiment, output=directory, **given)


@pytest.fixture(scope="module")
def chawda(tmp_path_factory: pytest.TempPathFactory) -> Any:
    changes = {"rig.encoder.offset": 0.13, "rig.amplifier.current_noise_a": 0.002}
    return identified(CHAWDA, tmp_path_factory.mktemp("chawda"), changes=changes)


VOLTAGE = {"controller.position_rate": 6000, "rig.amplifier.drive": "voltage"}


@pytest.fixture(scope="module")
def compliant(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return identified(COMPLIANT, tmp_path_factory.mktemp("compliant"), period_s=0.25, changes=VOLTAGE)


# ---------------------------------------------------------------------- parameters


def test_chawda_linear_comes_out_within_a_per_cent(chawda: Any) -> None:
    assert re.search(r"Coulomb friction +0\.\d+ ± \S+ N\n.*\n +inertia +0\.5\d* ± \S+ kg", repr(chawda))
    assert chawda.signs.sign == 1
    assert chawda.dynamics.inertia.value == pytest.approx(0.52, rel=0.002)
    assert chawda.sliding.damping.value == pytest.approx(13.2, rel=0.005)
    assert chawda.sliding.up.value == pytest.approx(0.19, rel=0.01)
    assert chawda.sliding.down.value == pytest.approx(0.19, rel=0.01)
    assert chawda.dynamics.delay_s.value == pytest.approx(0.0, abs=2e-6)
    assert chawda.dynamics.mode is None
    assert not chawda.dynamics.band.above
    assert np.median(chawda.dynamics.coherence) > 0.999


@pytest.mark.parametrize(("preset", "inertia"), first_by_default([("compliant", 1.77e-3), ("rigid", 3.2e-4)]))
def test_under_voltage_drive_back_emf_is_separated_from_friction_inertia_and_lag(
    preset: str, inertia: float, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """The measured current is compared throughout: no motion of a sound rig may end the run."""
    if preset == "compliant":
        found, experiment = request.getfixturevalue(preset), COMPLIANT
    else:
        found, experiment = identified(RIGID, tmp_path, period_s=0.25, changes=VOLTAGE), RIGID
    mechanics = experiment.rig.mechanics
    assert found.signs.warnings == ()
    assert found.signs.scale == pytest.approx(1.0, rel=0.3)
    assert found.dynamics.inertia.value == pytest.approx(inertia, rel=0.01)
    assert found.dynamics.delay_s.value == pytest.approx(experiment.rig.amplifier.lag_s, rel=0.1)
    damping = mechanics.motor_damping + mechanics.link_damping
    assert found.sliding.damping.value == pytest.approx(damping, rel=0.05)
    assert "0.0253 of back-EMF as described" in found.sources["rig.mechanics.motor_damping"]
    assert found.experiment.rig.amplifier.back_emf_damping == 0.0253
    if experiment is COMPLIANT:
        after = found.experiment.rig.mechanics.transmission_damping_ratio
        assert after == pytest.approx(mechanics.transmission_damping_ratio, rel=0.15)


# An encoder with few counts, and a wall and push whose rest it can still resolve.
COARSE = {"rig.encoder.counts_per_revolution": 180, "wall.stiffness": 10.0, "trial.effort": 0.3}


@pytest.mark.exhaustive(
    "tests/rig/analysis/test_identification_fits.py::test_lines_beyond_the_band_of_a_coarse_encoder_do_not_enter_the_fit"
)
@pytest.mark.parametrize(
    ("preset", "changes", "ends"),
    [
        ("hapkit", {}, False),
        ("koul-rigid", {"rig.mechanics.link_inertia": 0.01}, True),
        ("koul-compliant", COARSE, True),
        ("koul-compliant", {"rig.mechanics.link_inertia": 0.01}, False),
        ("chawda-linear", {"rig.mechanics.link_inertia": 3.0}, False),
    ],
)
def test_the_band_ends_where_the_motion_does_and_the_parameters_are_right(
    preset: str, changes: Any, ends: bool, tmp_path: Path
) -> None:
    """On heavy, coarse and elastic rigs the band is chosen without a given rate, and intervals contain the truth."""
    x = config.override(presets.load(preset), changes)
    found = identified(x, tmp_path, realisations=3, rate_hz=min(4000, x.controller.position_rate))
    inertia, delay, m = found.dynamics.inertia, found.dynamics.delay_s, x.rig.mechanics
    off = abs(inertia.value - m.motor_inertia - m.link_inertia)
    assert off < 1.5 * inertia.ci95, "a 95 % interval may miss a little in one of twenty"
    assert inertia.ci95 < 0.03 * inertia.value
    amplifier = x.rig.amplifier
    assert abs(delay.value - amplifier.lag_s - amplifier.set_point_delay_s) < 2.0 * delay.ci95 + 1e-5
    assert bool(found.dynamics.band.above) == ends
    if preset == "koul-compliant" and not ends:
        assert found.dynamics.mode.stiffness.value == pytest.approx(m.transmission_stiffness, rel=0.02)
    unseen = m.structure == "two-mass" and found.dynamics.mode is None
    assert any("the first mode lies above the band" in text for text in found.warnings) == unseen


def test_a_value_that_may_be_wrong_by_more_than_its_interval_has_a_warning(compliant: Any) -> None:
    vague = replace(compliant.sliding, damping=Interval(0.003, 0.004))
    found = replace(compliant, sliding=vague)
    assert not list(identifying._doubts(COMPLIANT, compliant, 0.1, 0))
    changed, damping = identifying._doubts(COMPLIANT, found, 0.25, 0)
    assert "changed by 25 % from one period to the next, where 20 %" in changed
    assert "cannot be distinguished from zero" in damping
    rigid = replace(compliant, dynamics=replace(compliant.dynamics, mode=None))
    (hidden,) = identifying._doubts(COMPLIANT, rigid, 0.1, 0)
    assert "the first mode lies above the band" in hidden


def test_a_named_simulated_rig_keeps_its_end_mass_which_is_subtracted(tmp_path: Path) -> None:
    on_board = config.override(RIGID, {"controller.loop": "device"})
    found = identified(on_board, tmp_path, url="sim://koul-rigid", rate_hz=1000)
    assert found.dynamics.inertia.value == pytest.approx(3.2e-4 + 0.07 * 0.1**2, rel=0.02)
    mechanics = found.experiment.rig.mechanics
    assert mechanics.motor_inertia + mechanics.link_inertia == pytest.approx(3.2e-4, rel=0.05)
    assert mechanics.end_mass == 0.07
    # Rate and delay of these motions, by a law on the host, do not enter the configuration of the board.
    assert found.experiment.controller == on_board.controller
    assert "rig.simulation.computation_delay_ticks" not in found.sources


def test_an_excitation_whose_last_samples_are_lost_ends_with_the_periods_before() -> None:
    multisine = motions.excitation(identifying.at_rate(RIGID, 1000, "test"), 0, 0.5, 3.2e-4)
    rate = 1000.0
    n, periods = 500, motions.settle_periods(0.5) + motions.PERIODS
    rows = np.zeros(periods * n, ROW)
    rows["position"] = np.tile(multisine.period(rate), periods)
    for lost in (0, LONGEST_FILLED):
        kept = rows[: len(rows) - lost]
        run = identifying.excited_run_of(kept, rate, multisine, kept["position"])
        assert run.position == pytest.approx(run.excitation)
    with pytest.raises(TimingError, match="the last 4 samples"):
        identifying.excited_run_of(rows[:-4], rate, multisine, rows["position"][:-4])


def test_a_rig_that_another_process_simulates_keeps_its_end_mass_too() -> None:
    """On koul-rigid the end mass doubles the rest: pushes measured 3.1 times the inertia, where 3 is the limit."""
    request = IdentifyRequest(experiment=RIGID, url="serial:///dev/pts/0")
    assert identifying.without_end_mass(request).rig.mechanics.end_mass == 0.0
    assert identifying.without_end_mass(request, served=True).rig.mechanics.end_mass == 0.07


INDEXED = {
    "rig.reference.index": True,
    "rig.reference.limit_switch": "minimum",
    "rig.reference.position": -0.25,
    "rig.reference.travel": 1.2,
}
COGS = {
    "rig.cogging.period": 2.0 * np.pi / 10.0,  # a turn of the motor
    "rig.cogging.orders": [1, 7],
    "rig.cogging.cosine": [0.0, 0.0],
    "rig.cogging.sine": [0.002, 0.01],  # beyond the spring that centres an excited handle
}


RIPPLES = {
    **COGS,
    "rig.cogging.orders": [1, 2],
    "rig.cogging.ripple_cosine": [0.03, 0.0],
    "rig.cogging.ripple_sine": [0.02, -0.05],
}


@pytest.mark.exhaustive(
    "tests/rig/analysis/test_identification_cogging.py::test_true_harmonics_and_no_others_come_out_within_the_interval"
)
def test_effort_ripple_is_measured_by_sweeps_with_a_mass_and_stored_in_the_file(tmp_path: Path) -> None:
    changes = {**INDEXED, **RIPPLES, "controller.position_rate": 6000}
    options = {"period_s": 0.25, "realisations": 2, "cogging": 4, "mass_kg": 0.3, "arm_m": 0.05}
    found = identified(COMPLIANT, tmp_path, changes=changes, **options)
    ripple, true = found.ripple, config.override(COMPLIANT, changes).rig.cogging
    assert found.cogging.friction.holds(0.0067)
    assert found.sliding.coulomb.value == pytest.approx(0.0067, rel=0.03)
    assert found.dynamics.inertia.value == pytest.approx(1.77e-3, rel=0.04)
    assert found.plot().figure.axes
    assert ripple.orders == true.orders
    for at, (c, s) in enumerate(zip(true.ripple_cosine, true.ripple_sine, strict=True)):
        assert ripple.amplitude[at].value == pytest.approx(np.hypot(c, s), abs=2e-4)
        assert ripple.phase[at].value == pytest.approx(np.arctan2(s, c), abs=5e-3)
    assert ripple.load.value == pytest.approx(0.3 * 0.05 * 9.80665, rel=1e-3)
    assert [path.name.split("-")[-2] for path in found.recordings["ripple"]] == ["ripple"]
    (_, first), (_, second) = _ripple_pairs(found)
    assert first.startswith("3.6")
    assert "% of the effort at harmonic 1, phase 0.58" in first
    assert "harmonic 2, phase -1.57" in second
    assert "measure it with a mass" in _ripple_pairs(replace(found, ripple=None))[0][1]
    path = tmp_path / "rig.toml"
    path.write_text(format_identification(found))
    kept = config.load_experiment(path).rig.cogging
    assert kept == found.experiment.rig.cogging
    at = np.linspace(-0.5, 0.5, 64, endpoint=False) * true.period
    assert kept.share(at) == pytest.approx(true.share(at), abs=1e-3)
    bent = true.effort(at) / (1.0 + true.share(at))  # the command that is needed; its mean is a bias
    least = found.cogging.unseen + 5e-5
    assert np.abs(true.effort(at) - bent).max() > 2.0 * least
    assert kept.effort(at) == pytest.approx(bent - bent.mean(), abs=least)


@pytest.mark.parametrize(
    ("experiment", "changes", "options", "message"),
    [
        (CHAWDA, {"controller.position_rate": 100_000}, {}, "device rate"),
        (COMPLIANT, {}, {"cogging": 7}, "position zero: is the position of the handle at the start"),
        (COMPLIANT, INDEXED | {"rig.cogging.period": 0.9}, {"cogging": 7}, "period of cogging"),
        (COMPLIANT, INDEXED, {"cogging": 8, "mass_kg": 0.6, "arm_m": 0.05}, "more than 0.286 N·m"),
        (COMPLIANT,
         INDEXED | {"rig.limits.position_minimum": -0.4, "rig.limits.position_maximum": 0.4, "homing.damping": 0.1},
         {"cogging": 8, "mass_kg": 0.35, "arm_m": 0.05}, "sag"),
    ],
    ids=["rate", "zero", "period", "heavy mass", "sagging mass"],
)  # fmt: skip
def test_an_identification_that_cannot_succeed_is_refused_before_anything_moves(
    experiment: Any, changes: Any, options: Any, message: str, tmp_path: Path
) -> None:
    with pytest.raises(PlanError, match=message):
        identified(experiment, tmp_path, changes=changes, **options)
    assert not list(tmp_path.iterdir())


def test_ripple_that_was_not_looked_for_stays_as_it_was_described(compliant: Any) -> None:
    """Cogging and ripple share their orders in a file, so a new cogging map of other orders must extend both."""
    x = config.override(COMPLIANT, {**INDEXED, **RIPPLES})
    mapped = fitted(Cogging(period=x.rig.cogging.period, orders=(4,), cosine=(0.01,), sine=(0.0,)), most=4)
    values = identified_values(x, compliant.sliding, compliant.dynamics, mapped)
    after = config.override(x, values.values, "test").rig.cogging
    at = np.linspace(-0.3, 0.3, 50)
    assert after.orders == (1, 2, 4)
    assert after.share(at) == pytest.approx(x.rig.cogging.share(at), abs=1e-15)
    assert after.effort(at) == pytest.approx(mapped.cogging.effort(at), abs=1e-15)
    assert not any("ripple" in key for key in values.sources)


def test_a_mass_needs_sweeps_and_on_a_real_rig_a_function_that_asks_the_operator(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a mass is given to measure ripple"):
        IdentifyRequest(experiment=COMPLIANT, mass_kg=0.1)
    with pytest.raises(ConfigError, match="the arm is 0"):
        IdentifyRequest(experiment=COMPLIANT, cogging=4, mass_kg=0.1, arm_m=0.0)
    with pytest.raises(ConfigError, match="no function is given"):
        identified(COMPLIANT, tmp_path, url="usb://1209:0001", cogging=4, mass_kg=0.1)


def test_the_period_of_a_linear_motor_must_be_given(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rig\.cogging\.period is not given"):
        identified(CHAWDA, tmp_path, cogging=7)
    with pytest.raises(ConfigError, match="harmonic 0 is out of range"):
        IdentifyRequest(experiment=CHAWDA, cogging=0)


# ---------------------------------------------------------------------- the file that it leaves


@pytest.mark.parametrize("name", ["chawda", "compliant"])
def test_the_file_is_the_identified_experiment_with_its_sources(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    found = request.getfixturevalue(name)
    path = tmp_path / "rig.toml"
    path.write_text(format_identification(found))
    assert config.as_mapping(config.load_experiment(path)) == config.as_mapping(found.experiment)
    lines = path.read_text().splitlines()
    marked = [line for line in lines if "[identified]" in line and " = " in line]
    assert len(marked) == len(found.sources)
    assert all(".parquet" in line for line in marked)
    (coulomb,) = (line for line in marked if line.startswith("motor_coulomb"))
    assert "±" in coulomb
    assert "up" in coulomb


def test_shares_that_one_sensor_cannot_separate_keep_the_described_proportion(compliant: Any) -> None:
    before, after = COMPLIANT.rig.mechanics, compliant.experiment.rig.mechanics
    for name in ("coulomb", "damping"):
        share, described = (getattr(m, f"motor_{name}") / getattr(m, f"link_{name}") for m in (after, before))
        assert share == pytest.approx(described)
    assert after.end_mass == before.end_mass


def test_every_motion_is_a_recording_with_its_kind_and_law(chawda: Any) -> None:
    assert {name: len(paths) for name, paths in chawda.recordings.items()} == {
        "signs": 1, "sliding": 1, "dynamics": 2,
    }  # fmt: skip
    laws = {"signs": "nudges", "sliding": "traced", "dynamics": "excited"}
    for name, paths in chawda.recordings.items():
        for path in paths:
            recording = open_recording(path)
            assert recording.complete
            assert recording.header["extra"]["identification"] == name
            assert recording.header["initial_state"]["law"]["name"] == laws[name]


# ---------------------------------------------------------------------- limits


def simulate(x: Any, law: Any, start: float, seconds: float) -> Any:
    rate = x.controller.position_rate
    plant = DiscretePlant.build(config.rig_model(x), 1.0 / rate)
    quantum = x.rig.amplifier.current_quantum_a
    control = controller.for_experiment(x, current_quantum_a=quantum, law=law)
    return run_trial(control, plant, start, most_ticks=round(seconds * rate))


@pytest.mark.parametrize("experiment", [CHAWDA, RIGID, COMPLIANT], ids=lambda x: x.rig.name)
def test_motions_stay_far_within_effort_speed_and_window(experiment: Any) -> None:
    """Simulate each motion without a link, with a tenth of the described friction and damping."""
    described = config.override(experiment, {"rig.mechanics.end_mass": 0.0})
    limits = described.rig.limits
    low, high = limits.position_minimum, limits.position_maximum
    multisine = motions.excitation(described, 0, 0.5, described.rig.mechanics.inertia)
    for motion in (
        motions.pushes_motion(described, 0.1 * high),
        motions.strokes_motion(described),
        motions.excitation_motion(described, multisine, described.rig.mechanics.inertia),
    ):
        x = motion.experiment
        slippery = {f"rig.mechanics.{side}_{name}": 0.1 * getattr(x.rig.mechanics, f"{side}_{name}")
                    for side in ("motor", "link") for name in ("coulomb", "damping")}  # fmt: skip
        slick = config.override(x, slippery)
        trace = simulate(slick, motion.law, x.trial.start, x.trial.duration_s + 12.0)
        trial = trace.phases == Phase.TRIAL
        whole = x.trial.duration_s * x.controller.position_rate
        assert trial.sum() == pytest.approx(whole, abs=2), "it came to its end: no guard tripped"
        position, velocity = trace.states[trial, 0], trace.states[trial, 1]
        assert low < position.min()
        assert position.max() < high
        assert np.abs(velocity).max() < 0.7 * limits.speed
        assert np.abs(trace.currents).max() * x.rig.amplifier.effort_quantum <= limits.effort


@pytest.mark.parametrize("experiment", [CHAWDA, RIGID, COMPLIANT], ids=lambda x: x.rig.name)
def test_pushes_raise_no_false_alarm_wherever_zero_lies_between_two_counts(experiment: Any) -> None:
    for offset in np.linspace(0.0, 0.9, 4):
        x = config.override(experiment, {"rig.mechanics.end_mass": 0.0, "rig.encoder.offset": float(offset)})
        motion = motions.pushes_motion(x, 0.0)
        trace = simulate(motion.experiment, motion.law, 0.0, 20.0)
        trial = trace.phases == Phase.TRIAL
        found = check_signs(
            np.arange(trial.sum()) / motion.experiment.controller.position_rate,
            trace.currents[trial] * x.rig.amplifier.effort_quantum,
            trace.counts[trial] * controller.resolution(x),
            resolution=x.rig.encoder.resolution,
            expected_inertia=x.rig.mechanics.inertia,
            rest_s=0.05,
        )
        assert found.ok
        assert found.warnings == ()
        assert 0.9 < found.scale < 1.8


@pytest.mark.parametrize(
    ("part", "wrong", "message", "key"),
    [
        ("encoder", {"sign": -1}, "connected in reverse", "rig.encoder.sign"),
        ("mechanics", {"motor_inertia": 2.6}, "times the described inertia", "rig.mechanics"),
    ],
)
def test_pushes_of_another_rig_move_as_little_and_end_the_run(
    part: str, wrong: Any, message: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    described = config.rig_model(CHAWDA)
    other = replace(described, **{part: replace(getattr(described, part), **wrong)})
    device = OnOtherHardware(described)
    device.stand_before(Hardware(other, 1000, seed=0, initial_position=None))
    link = MemoryLink(device)
    monkeypatch.setattr(identifying.devices, "open_device", lambda url, model: FramedDevice(link))
    with pytest.raises(IdentificationError, match=message) as caught:
        identified(CHAWDA, tmp_path)
    assert key in caught.value.remedy
    (path,) = tmp_path.glob("*.parquet")
    assert 30 <= np.abs(open_recording(path).rows["count"]).max() < 300


def test_the_plan_lists_and_checks_before_anything_moves() -> None:
    request = IdentifyRequest(experiment=RIGID)
    plan = identifying.plan_of(identifying.without_end_mass(request), request)
    assert [step.name for step in plan.steps] == ["pushes", "strokes", "excitation"]
    assert plan.ok
    assert all(check.outcome == Outcome.OK for check in plan.checks)
    weak = config.override(RIGID, {"rig.limits.effort": 0.15})
    checks = {c.name: c for c in identifying.plan_of(weak, request).checks}
    assert checks["excitation over friction"].outcome == Outcome.WARNING


def test_a_rate_at_which_friction_holds_the_strokes_is_refused_with_one_that_works(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"choose `rate` (\d+) or more") as caught:
        identified(RIGID, tmp_path, rate_hz=250)
    works = int(re.findall(r"`rate` (\d+)", str(caught.value))[0])
    assert 250 < works < 1000
    request = IdentifyRequest(experiment=RIGID, rate_hz=works)
    assert identifying.plan_of(identifying.without_end_mass(request), request).ok


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period_s": 0.01}, "period"),
        ({"changes": {"controller.position_rate": 50, "controller.velocity_rate": 50,
                      "controller.parameters.cutoff_hz": 5.0, "verdict.lowpass_hz": 20.0,
                      "verdict.highpass_hz": 5.0}}, "too low"),
        ({"url": "sim://koul-rigid"}, "the device is named koul-rigid"),
    ],
)  # fmt: skip
def test_impossible_options_are_refused(options: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        identified(CHAWDA, tmp_path, **options)


def test_lost_samples_are_filled_in_up_to_a_bound(chawda: Any) -> None:
    recording = open_recording(chawda.recordings["dynamics"][0])
    rows = recording.rows
    middle = len(rows) // 2
    found = trial_rows(replace(recording, rows=np.delete(rows, slice(middle, middle + LONGEST_FILLED))))
    assert len(found) == np.sum(rows["phase"] == Phase.TRIAL)
    assert (np.diff(found["sample_index"]) == 1).all()
    for lost in (slice(middle, middle + LONGEST_FILLED + 1), slice(middle, None, 20)):
        with pytest.raises(TimingError, match=r"% of the samples are missing, up to \d in a row") as caught:
            trial_rows(replace(recording, rows=np.delete(rows, lost)))
        assert re.search(r"`rate` \d+", str(caught.value.remedy))


@pytest.mark.exhaustive("::test_lost_samples_are_filled_in_up_to_a_bound")
@pytest.mark.parametrize("preset", ["koul-compliant", "chawda-linear"])
def test_lost_samples_spoil_no_value(preset: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the allowed share is lost at random in every motion."""
    rng = np.random.default_rng(5)

    def with_losses(recording: Any, rows: Any) -> Any:
        kept = rng.random(len(rows)) >= 0.5 * MOST_LOST_SHARE
        kept[[0, -1]] = True
        return whole(recording, rows[kept])

    monkeypatch.setattr(motion_run, "whole", with_losses)
    found = identified(presets.load(preset), tmp_path, realisations=3, rate_hz=1000)
    m = found.before.rig.mechanics
    inertia = found.dynamics.inertia
    assert abs(inertia.value - m.motor_inertia - m.link_inertia) < inertia.ci95 + 0.005 * inertia.value
    amplifier = found.before.rig.amplifier
    assert found.dynamics.delay_s.value == pytest.approx(amplifier.lag_s, abs=5e-5)
    assert found.sliding.coulomb.value == pytest.approx(m.motor_coulomb + m.link_coulomb, rel=0.05)


# ---------------------------------------------------------------------- the laws


def test_a_traced_path_is_followed_and_its_last_point_held() -> None:
    law = make_tracing_law(
        [(0.0, 0.1), (1.0, 0.2), (1.5, 0.0)], stiffness=10.0, damping=2.0, limit=100.0, rate_hz=1000.0
    )
    for side in (1, -1):
        prepared = law.prepare({"side": side, "position": 0.05})

        def reaction(position: Any, velocity: Any, ticks: Any, p: Any = prepared, s: Any = side) -> Any:
            return -s * p.law.function(s * (position - 0.05), s * velocity, ticks, p.state, p.parameters)

        assert reaction(0.1, 0.1, 1) == pytest.approx(0.0), "on the path, at its speed"
        assert reaction(0.15, 0.0, 500) == pytest.approx(2.0 * 0.1), "half-way after 500 ticks"
        assert reaction(0.1, -0.4, 750) == pytest.approx(0.0), "on the next line after the first"
        assert reaction(0.01, 0.0, 2000) == pytest.approx(-0.1), "held at the end"
        assert reaction(-100.0, 0.0, 1) == pytest.approx(100.0), "clipped"


def test_a_push_ends_when_the_handle_moves_and_brakes_by_where_it_went() -> None:
    law = make_nudging_law(
        effort_per_s=1.0, most_effort=0.5, moved=1.0, rest_s=0.1, brake=0.01, pulses=3, rate_hz=1000.0
    )
    p = law.prepare({"side": 1})

    def drive(position: Any, velocity: float = 0.0, ticks: int = 1) -> Any:
        return -p.law.function(position, velocity, ticks, p.state, p.parameters)

    assert drive(5.0) == pytest.approx(0.001)
    assert drive(5.5, ticks=99) == pytest.approx(0.1)
    assert drive(3.9, velocity=-2.0) == pytest.approx(-0.02), "the drive is reversed, so is its brake"
    assert p.state[7] == -1.0, "it went against the push: sign reversed, brake reversed"
    assert drive(3.9, velocity=-100.0) == pytest.approx(-0.101), "never more than the push had"
    assert drive(3.9, ticks=100) == 0.0
    assert drive(3.9, ticks=1) > 0.0, "the second push has the same direction"
    assert drive(3.7, ticks=600) == 0.0, "too stiff: it gives up at the most effort"
    drive(3.7, ticks=100)
    assert drive(3.7, ticks=10) < 0.0, "the third the other"
    assert drive(3.7, ticks=600) == 0.0, "no movement seen: no other push adds to the speed"
    assert p.state[2] == 3.0
    with pytest.raises(ValueError, match="small pushes need a wall that is entered upwards"):
        law.prepare({"side": -1})
