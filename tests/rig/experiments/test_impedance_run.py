"""Measured impedances: closed forms without friction or quantisation, both exciters, links, rejected requests."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import rig
from rig import config, devices
from rig.analysis import theory
from rig.analysis.impedance._estimate import periodic
from rig.analysis.impedance._ideal import bare, rendered_impedance
from rig.config import presets
from rig.config.schemes import Scheme
from rig.control import bilateral
from rig.core.check import Outcome
from rig.core.errors import ConfigError, GuardError, PlanError, RecordingError
from rig.core.present import plain
from rig.core.sample import Phase
from rig.experiments.hits._on_device import OnDevice
from rig.experiments.mapping import impedance as measuring
from rig.experiments.mapping.impedance import Judging, measure_impedance, measure_on_device, write_results
from rig.experiments.trials import excitation_run
from rig.experiments.trials.judgement import experiment_of
from rig.experiments.trials.plan import make_plan
from rig.experiments.trials.replay import replay
from rig.recording.reader import open_recording
from rig.views.plots.impedance import impedance_figure
from tests.conformance.tiers import first_by_default

CHAWDA = presets.load("chawda-linear")

# Without friction, with an encoder and a current that are fine enough to be none.
LINEAR = {
    "rig.mechanics.motor_coulomb": 0.0, "rig.encoder.quantum": 1e-12, "rig.amplifier.current_quantum_a": 1e-7,
    "rig.amplifier.effort_per_ampere": 100.0, "rig.amplifier.effort_limit": 0.3, "rig.limits.effort": 0.3,
    "rig.limits.nominal_effort": 0.3, "homing.effort": 0.1, "trial.effort": 0.1, "trial.minimum_rest_counts": 0.0,
    "excitation.high_hz": 400.0, "excitation.rms": 0.05, "excitation.realisations": 1,
    "excitation.settle_periods": 6,  # an undamped wall of 20 kN/m rings for seconds
}  # fmt: skip
FAST = {"excitation.settle_periods": 1, "excitation.periods": 2, "excitation.realisations": 2}
OWN_MOTOR = FAST | {"excitation.channel": "motor"}


def linear_rig(scheme: Any, **changes: Any) -> Any:
    """Return the experiment of the rig of Chawda et al. without friction and quantisation, under a scheme."""
    experiment = config.override(CHAWDA, LINEAR | changes)
    return Scheme.parse(scheme).applied(experiment)


def off(measured: Any, exact: Any) -> Any:
    """Return the largest deviations over all lines: of magnitude (%) and of phase (degrees)."""
    ratio = measured / exact
    return 100.0 * np.abs(np.abs(ratio) - 1.0).max(), np.degrees(np.abs(np.angle(ratio))).max()


# ---------------------------------------------------------------------- closed forms


@pytest.mark.parametrize(
    ("scheme", "walls"),
    [
        ("uniform:1k,estimator=fdm", [(0.0, 0.0), (10e3, 30.0), (20e3, 0.0), (20e3, 60.0)]),
        ("uniform:1k,estimator=fdm-butterworth,cutoff_hz=100", [(10e3, 10.0), (2e3, 30.0)]),
        ("uniform:1k,estimator=kalman", [(20e3, 60.0)]),
        ("dual:10k/1k,estimator=fdm", [(20e3, 50.0)]),
        ("dual:4k/2k,estimator=fdm,prediction=extrapolate", [(20e3, 50.0)]),
    ],
)
def test_the_measured_impedance_is_the_closed_form(scheme: str, walls: list[tuple[float, ...]]) -> None:
    """Within 0.3 % and 0.1° up to 400 Hz; the closed form includes wall, hold, estimator and sampling images."""
    x = linear_rig(scheme)
    bench = excitation_run.ExcitedRig(x)
    for wall in walls:
        run = bench.excite(*wall)
        measured = periodic([run.record])
        assert len(measured.lines_hz) == 400
        magnitude, phase = off(measured.z, rendered_impedance(x, *wall, measured.lines_hz))
        assert magnitude < 0.1, wall
        assert phase < 0.05, wall


@pytest.mark.parametrize("wall", [(0.0, 0.0), (20e3, 60.0)])
def test_a_position_seen_at_the_ticks_alone_has_the_images_of_sampling(wall: tuple[float, float]) -> None:
    x = linear_rig("uniform:1k,estimator=fdm")
    measured = periodic([excitation_run.ExcitedRig(x, acquisition_hz=1e3).excite(*wall).record])
    magnitude, phase = off(measured.z, rendered_impedance(x, *wall, measured.lines_hz, seen="samples"))
    assert magnitude < 0.1
    assert phase < 0.05


@pytest.mark.parametrize(
    ("delay", "drive"), first_by_default([(1, "current"), (0, "current"), (1, "voltage")])
)
def test_the_closed_form_holds_with_lag_delay_and_two_masses_on_both_sides(delay: int, drive: str) -> None:
    fine = {
        "rig.amplifier.drive": drive,
        "rig.mechanics.motor_coulomb": 0.0, "rig.mechanics.link_coulomb": 0.0,
        "rig.encoder.counts_per_revolution": 10_000_000, "rig.encoder.ratio": 100.0,
        "rig.amplifier.current_quantum_a": 1.8e-4, "rig.simulation.computation_delay_ticks": delay,
        "controller.estimator": "fdm", "excitation.low_hz": 5.0, "excitation.high_hz": 400.0,
        "excitation.rms": 0.05, "excitation.realisations": 1, "excitation.settle_periods": 4,
    }  # fmt: skip
    mapping = config.as_mapping(presets.load("koul-compliant"))
    mapping["controller"]["parameters"] = {}
    x = config.override(config.experiment_from_mapping(mapping, "test"), fine)
    for wall in ((0.0, 0.0), (150.0, 0.05)):
        for signal, seen in (("count", "sensed"), ("truth", "handle")):
            measured = periodic([excitation_run.ExcitedRig(x, signal=signal).excite(*wall).record])
            magnitude, phase = off(measured.z, rendered_impedance(x, *wall, measured.lines_hz, seen=seen))
            assert magnitude < 0.3
            assert phase < 0.1


@pytest.mark.parametrize("channel", ["external", "motor"])
def test_the_fit_of_a_voltage_driven_rig_is_its_own_damping_and_mass(channel: str) -> None:
    """Back-EMF, nine times the damping, acts behind the lag; the fit subtracts the described one, also in a wall."""
    fine = {
        "rig.mechanics.motor_coulomb": 0.0, "rig.mechanics.end_mass": 0.0, "rig.amplifier.drive": "voltage",
        "rig.encoder.counts_per_revolution": 10_000_000, "rig.encoder.ratio": 100.0,
        "rig.amplifier.current_quantum_a": 1.8e-4, "excitation.low_hz": 5.0, "excitation.high_hz": 400.0,
        "excitation.rms": 0.02, "excitation.realisations": 1, "excitation.channel": channel,
        "wall.stiffness": 0.0, "wall.damping": 0.0,
    }  # fmt: skip
    x = config.override(presets.load("koul-rigid"), fine)
    bench = excitation_run.ExcitedRig(x)
    free = measuring.conclude(x, [bench.excite(0.0, 0.0)])
    assert free.fitted is not None
    assert free.fitted.values["damping"] == pytest.approx(3e-3, rel=0.01)
    assert free.fitted.values["inertia"] == pytest.approx(3.2e-4, rel=1e-3)
    wall = config.override(x, {"wall.stiffness": 50.0})
    fidelity = measuring.conclude(wall, [bench.excite(50.0, 0.0)]).fidelity
    assert fidelity is not None
    assert fidelity.stiffness_percent == pytest.approx(100.0, abs=0.5)
    lag = -50.0 * (0.5 * 5e-5 + x.rig.amplifier.lag_s)  # what hold and lag take off a spring's damping
    assert fidelity.damping == pytest.approx(lag, rel=0.05)


@pytest.mark.parametrize(("wall", "agree"), [((0.0, 0.0), 0.02), ((10e3, 30.0), 0.4)])
def test_on_a_rigid_rig_the_own_motor_measures_as_a_second_one(wall: tuple[float, ...], agree: float) -> None:
    """Each result equals its own closed form; they differ by under 0.4 %, from the sampling images of the hold."""
    scheme = "fdm" if any(wall) else "fdm-butterworth,cutoff_hz=100"
    x = linear_rig(f"uniform:1k,estimator={scheme}", **{"excitation.channel": "motor"})
    own = periodic([excitation_run.ExcitedRig(x, acquisition_hz=1e6).excite(*wall).record])
    magnitude, phase = off(own.z, rendered_impedance(x, *wall, own.lines_hz, channel="motor"))
    assert magnitude < 0.1
    assert phase < 0.05
    second = config.override(x, {"excitation.channel": "external"})
    other = periodic([excitation_run.ExcitedRig(second).excite(*wall).record])
    assert off(own.z, other.z)[0] < agree


def test_lag_and_delay_of_the_own_motor_are_taken_out() -> None:
    """The force F is that on the mass, so a bare rig gives m·s + b whatever lag lies between command and effort."""
    late = {"rig.amplifier.lag_s": 2e-4, "rig.simulation.computation_delay_ticks": 2}
    x = linear_rig("uniform:1k,estimator=fdm", **late, **{"excitation.channel": "motor"})
    measured = periodic([excitation_run.ExcitedRig(x, acquisition_hz=1e6).excite(0.0, 0.0).record])
    magnitude, phase = off(measured.z, bare(x, measured.lines_hz))
    assert magnitude < 0.1
    assert phase < 0.05


def test_samples_at_the_ticks_show_a_free_mass_too_little_motion() -> None:
    """For a free mass the factor is cos x/(sin x/x)³ with x = π·f·T: 3 % at a quarter of the rate."""
    x = linear_rig("uniform:1k,estimator=fdm", **{"rig.mechanics.motor_damping": 0.0})
    f = np.array([1.0, 100.0, 250.0, 400.0])
    half = np.pi * f * 1e-3
    found = excitation_run.seen_at_ticks(config.rig_model(x), 1e-3, f)
    assert found == pytest.approx(np.cos(half) / np.sinc(f * 1e-3) ** 3, rel=1e-6)


# ---------------------------------------------------------------------- results


def test_results_have_verdict_fidelity_and_fit_and_are_json(tmp_path: Path) -> None:
    schemes = [Scheme.parse("uniform:1k,estimator=fdm"), Scheme.parse("uniform:1k,estimator=kalman")]
    calls = []
    results = measure_impedance(
        config.override(CHAWDA, {"excitation.realisations": 2}),
        walls=[(0.0, 0.0), (10e3, 40.0)],
        schemes=schemes,
        judging=Judging(band_hz=(2.0, 100.0)),
        watch=lambda done, total: calls.append((done, total)),
    )
    assert calls[-1] == (8, 8)
    assert [r.wall for r in results] == [(0.0, 0.0), (10e3, 40.0)] * 2
    assert [r.experiment.controller.estimator for r in results] == ["fdm", "fdm", "kalman", "kalman"]
    free, wall = results[:2]
    assert free.bare
    assert free.fitted.values["inertia"] == pytest.approx(0.52, rel=0.03)
    assert free.fidelity.rms == pytest.approx(1.886 * 100.0, rel=0.06)
    assert wall.fitted is None
    assert wall.fidelity.stiffness_percent == pytest.approx(100.0, abs=25.0)
    assert all(r.judgement.passive for r in results)
    assert wall.judgement.passivity.band_hz == (2.0, 100.0)
    assert "K = 10000 N/m" in wall.label
    table, summary = write_results(results, tmp_path / "new")
    documents = json.loads(summary.read_text())["results"]
    assert documents[1]["fidelity"]["band_hz"] == [2.0, 100.0]
    assert documents[1]["impedance"]["z"]["real"] == wall.impedance.z.real.tolist()
    assert documents[1]["excitation"]["rms"] == pytest.approx(2.0)
    read = pq.read_table(table)
    assert read.num_rows == 4 * 250
    assert read.schema.field("real").metadata[b"unit"] == "N·s/m".encode()


def test_the_same_measurement_gives_the_same_bits_and_another_seed_others() -> None:
    short = replace(CHAWDA.excitation, realisations=1)
    one = measure_impedance(CHAWDA, walls=[(5e3, 20.0)], excitation=short)[0].impedance.z
    again = rig.impedance("chawda-linear", [(5e3, 20.0)], excitation={"realisations": 1})[0].impedance.z
    seeded = replace(short, seed=1)
    other = measure_impedance(CHAWDA, walls=[(5e3, 20.0)], excitation=seeded)[0].impedance.z
    assert one.tobytes() == again.tobytes() != other.tobytes()


def test_a_wall_that_throws_the_handle_out_is_a_result_and_not_an_error() -> None:
    far = config.override(CHAWDA, {"rig.limits.speed": 0.2})
    stable, unstable = measure_impedance(
        far, walls=[(10e3, 40.0), (200e3, 0.0)], schemes=[Scheme.parse("uniform:1k,estimator=fdm")]
    )
    assert stable.impedance is not None
    assert unstable.impedance is None
    assert unstable.judgement is None
    assert "limit" in unstable.ended or "window" in unstable.ended
    assert 0.0 < unstable.ended_s < 6.0
    assert json.loads(json.dumps(plain(unstable)))["impedance"] is None


# ---------------------------------------------------------------------- over the byte link


@pytest.fixture(scope="module")
def on_device(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Measure one wall over the byte link in virtual time, with an estimator that forgets its state at rest."""
    scheme = Scheme.parse("uniform:1k,estimator=fdm-butterworth,cutoff_hz=200")
    x = scheme.applied(config.override(CHAWDA, OWN_MOTOR))
    (result,) = rig.impedance(x, [(10e3, 10.0)], url="sim://", output=tmp_path_factory.mktemp("recordings"))
    return x, result


def measured(directory: Path, *walls: tuple[float, float], agrees: Any = None, **changes: Any) -> list[Any]:
    x = config.override(CHAWDA, {**OWN_MOTOR, "excitation.realisations": 1, **changes})
    asks = {} if agrees is None else {"agrees": agrees}
    return list(measure_on_device(x, OnDevice(url="sim://", recordings=directory), walls=walls, **asks))


def test_over_the_byte_link_the_counts_are_the_same_to_the_last_bit(on_device: Any) -> None:
    x, result = on_device
    assert len(result.recordings) == 2
    excited = config.excited(x)
    model = config.rig_model(excited)
    for number, path in enumerate(result.recordings):
        rows = open_recording(path).rows
        rows = rows[rows["phase"] == Phase.TRIAL]
        bench = excitation_run.ExcitedRig(x, acquisition_hz=1000.0)
        wall = asdict(replace(excited.wall, stiffness=10e3, damping=10.0))
        law = excitation_run.excited_law(excited, number).prepare(wall)
        fresh = replace(bench._template.fresh(wall), law=law)
        excited_plant = devices.excited_simulation()(model, 1e-3, 1000.0, len(rows))
        run = excited_plant.excite(fresh, 0.0, np.zeros(1), 0.0, len(rows))
        assert (rows["count"] == run.counts).all()
        assert (rows["position_true"] == run.position).all()
        assert (rows["velocity_true"] == run.velocity).all()
        assert np.ptp(run.counts) > 100
        played = bilateral.played(fresh.law.parameters, 1, 1e-3, len(rows))
        reaction = 10e3 * rows["penetration"] + 10.0 * rows["velocity"]
        assert rows["effort_wanted"] == pytest.approx(played - reaction, abs=1e-9)


def test_over_the_byte_link_the_impedance_is_that_of_the_run_without_bytes(on_device: Any) -> None:
    """The direct simulation also sees motion between ticks; the recording is corrected for that."""
    x, result = on_device
    (other,) = measure_impedance(x, walls=[(10e3, 10.0)])
    ratio = result.impedance.z / other.impedance.z
    lines = other.impedance.lines_hz
    assert np.abs(ratio[lines < 50.0] - 1.0).max() < 0.01
    assert abs(np.mean(ratio[lines > 150.0]) - 1.0) < 0.01  # there a line moves less than a count
    assert result.fidelity.rms == pytest.approx(other.fidelity.rms, rel=0.02)


def test_a_recording_of_it_is_replayed_and_measured_again(on_device: Any) -> None:
    _, result = on_device
    recording = open_recording(result.recordings[0])
    record = excitation_run.record_of(recording, experiment_of(recording))
    assert record.periods == 2
    assert record.effort_hold_s == 1e-3
    again = rig.read_impedance(map(str, result.recordings))
    assert (again.impedance.z == result.impedance.z).all()
    assert (again.fidelity, again.judgement, again.label) == (result.fidelity, result.judgement, result.label)
    banded = rig.read_impedance([recording], judging=rig.Judging(band_hz=(10.0, 50.0)))
    assert banded.judgement.passivity.band_hz == (10.0, 50.0)
    assert not np.any(replay(recording).rows["effort_sent"] != recording.rows["effort_sent"])
    broken = replace(recording, rows=recording.rows[:-500])
    with pytest.raises(RecordingError, match="incomplete"):
        excitation_run.record_of(broken, experiment_of(broken))


def test_results_of_other_bands_are_not_drawn_together(on_device: Any) -> None:
    """Friction moves the effective damping with the band."""
    _, one = on_device
    other = replace(one, experiment=config.override(one.experiment, {"excitation.high_hz": 100.0}))
    with pytest.raises(ConfigError, match="1 to 250 Hz with 2 N rms; 1 to 100 Hz with 2 N rms"):
        impedance_figure([one, other])


def test_recordings_of_no_wall_or_of_two_are_no_measurement(on_device: Any, tmp_path: Path) -> None:
    x, result = on_device
    with pytest.raises(ConfigError, match="of 0 walls or schemes; recordings of one wall with"):
        rig.read_impedance([])
    once = {"realisations": 1, "seed": 5}
    (other,) = rig.impedance(x, [(5e3, 10.0)], url="sim://", output=tmp_path, excitation=once)
    with pytest.raises(ConfigError, match="of 2 walls or schemes; recordings of one wall with"):
        rig.read_impedance([*result.recordings, *other.recordings])
    with pytest.raises(ConfigError, match="signal = 'truth' cannot be used with a device"):
        rig.impedance(x, url="sim://", signal="truth")


def test_a_trial_where_nothing_excites_has_no_record(on_device: Any) -> None:
    _, result = on_device
    recording = open_recording(result.recordings[0])
    header = json.loads(json.dumps(recording.header))
    header["initial_state"]["law"]["name"] = "spring-damper"
    with pytest.raises(RecordingError, match="contains no excitation"):
        excitation_run.record_of(replace(recording, header=header), experiment_of(recording))


def test_the_delay_between_command_and_current_is_read_off_the_recording() -> None:
    sent = np.random.default_rng(1).integers(-99, 99, 500)
    for late in range(4):
        applied = np.concatenate([np.zeros(1 + late, np.int64), sent])[:500]
        assert excitation_run.late_ticks(sent, applied) == late


def test_on_a_device_the_wall_that_throws_the_handle_out_is_a_result_too(tmp_path: Path) -> None:
    fdm = {"controller.estimator": "fdm", "controller.parameters": {}}
    (result,) = measured(tmp_path, (200e3, 0.0), **{"rig.limits.speed": 0.2, **fdm})
    assert result.impedance is None
    assert result.ended
    assert len(result.recordings) == 1
    assert result.recordings[0].exists()


def test_a_realisation_with_lost_samples_is_measured_again_and_both_recordings_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures = iter([RecordingError("not whole", remedy="again")])

    def holed(recording: Any, experiment: Any) -> Any:
        for failure in failures:
            raise failure
        return excitation_run.record_of(recording, experiment)

    monkeypatch.setattr(measuring, "record_of", holed)
    (result,) = measured(tmp_path, (10e3, 10.0))
    assert result.impedance is not None
    assert len(result.recordings) == len(set(result.recordings)) == 2
    assert (rig.read_impedance(result.recordings).impedance.z == result.impedance.z).all(), "of the whole one"

    def always(recording: Any, experiment: Any) -> None:
        raise RecordingError("not whole", remedy="again")

    monkeypatch.setattr(measuring, "record_of", always)
    with pytest.raises(RecordingError) as caught:
        measured(tmp_path, (10e3, 10.0))
    assert caught.value.recording.exists()


def test_an_end_that_the_wall_did_not_cause_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(GuardError, match="did not reach the start"):
        measured(tmp_path, (10e3, 10.0), **{"homing.timeout_s": 0.05})


def test_a_person_may_decline_and_keeps_what_was_measured(tmp_path: Path) -> None:
    answers = iter([True, False])
    results = measured(tmp_path, (10e3, 10.0), (5e3, 10.0), agrees=lambda experiment: next(answers))
    assert [r.wall for r in results] == [(10e3, 10.0)]


def test_a_device_has_no_second_actuator(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="second actuator"):
        measured(tmp_path, **{"excitation.channel": "external"})


# ---------------------------------------------------------------------- what is refused, and the plan


def checks_of(experiment: Any) -> Any:
    return {check.name: check for check in make_plan(experiment).checks}


def test_the_plan_predicts_peaks_by_the_closed_form() -> None:
    x = config.override(CHAWDA, {"trial.kind": "excitation", "wall.stiffness": 10e3, "wall.damping": 10.0})
    plan = make_plan(x)
    assert plan.ok
    assert [step.name for step in plan.steps] == ["configure", "home", "excite", "estimate"]
    assert plan.repeats == 4
    assert plan.steps[2].duration_s == 6.0
    checks = checks_of(x)
    still = config.override(x, {"rig.mechanics.motor_coulomb": 0.0, "excitation.rms": 2.0})
    bench = excitation_run.ExcitedRig(still, signal="truth")
    peak = max(np.abs(bench.excite(10e3, 10.0, n).record.position).max() for n in range(4))
    assert float(checks["peak position"].text.split()[0]) == pytest.approx(peak, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"excitation.rms": 17.0, "wall.stiffness": 0.0, "wall.damping": 0.0}, "peak position"),
        ({"excitation.rms": 50.0, "excitation.channel": "motor", "wall.stiffness": 5e3}, "peak excitation"),
        ({"rig.limits.speed": 0.051, "homing.speed": 0.05, "excitation.rms": 8.0}, "peak speed"),
    ],
)
def test_an_excitation_beyond_a_limit_is_refused_before_anything_moves(changes: Any, name: str) -> None:
    x = config.override(CHAWDA, {"trial.kind": "excitation", "wall.damping": 40.0, **changes})
    assert checks_of(x)[name].outcome is Outcome.REFUSED
    with pytest.raises(PlanError, match=name):
        measure_impedance(x)


def test_a_wall_whose_effort_will_be_clipped_is_warned_of_and_measured() -> None:
    limits = {"rig.limits.effort": 10.0, "rig.limits.nominal_effort": 10.0}
    wall = {"wall.damping": 20.0, "wall.stiffness": 10e3}
    x = config.override(CHAWDA, {**limits, **wall, "trial.kind": "excitation", "excitation.rms": 9.0})
    assert checks_of(x)["peak motor effort"].outcome is Outcome.WARNING
    (result,) = measure_impedance(x, schemes=[Scheme.parse("uniform:1k,estimator=fdm")])
    assert result.saturated > 0.0


def test_the_closed_form_of_an_unstable_wall_refuses_nothing() -> None:
    """Friction may stabilise the wall, and the steady motion that linear theory computes for it does not exist."""
    x = config.override(CHAWDA, {"trial.kind": "excitation", "wall.stiffness": 26.6e3, "wall.damping": 0.0})
    x = Scheme.parse("uniform:1k,estimator=fdm").applied(config.override(x, {"rig.limits.speed": 0.0501}))
    checks = checks_of(x)
    assert checks["stability"].outcome is Outcome.WARNING
    assert checks["peak speed"].outcome is Outcome.WARNING


@pytest.mark.parametrize("estimator", ["levant", "foaw-best"])
def test_an_estimator_that_is_not_linear_has_a_plan_but_no_closed_form(estimator: str) -> None:
    x = Scheme.parse(f"uniform:1k,estimator={estimator}").applied(CHAWDA)
    x = config.excited(config.override(x, {"wall.damping": 20.0}))
    assert make_plan(x).ok
    assert f"with fdm-butterworth in place of {estimator}" in checks_of(x)["stability"].text
    assert measuring.expected(x, np.array([1.0, 10.0])) is None


def test_the_stability_of_a_wall_with_an_observer_of_the_effort_is_its_own() -> None:
    """A bug replaced it by a finite difference, although only its frequency response is unknown."""
    x = Scheme.parse("uniform:1k,estimator=disturbance").applied(CHAWDA)
    x = config.excited(config.override(x, {"wall.stiffness": 10e3, "wall.damping": 20.0}))
    radius = theory.spectral_radius(x, None, 10e3, 20.0)
    assert checks_of(x)["stability"].text.startswith(f"spectral radius {radius:.4f} by linear theory, both")


def test_a_wall_below_zero_is_refused() -> None:
    with pytest.raises(ConfigError, match="not negative"):
        measure_impedance(CHAWDA, walls=[(-1.0, 0.0)])


# ---------------------------------------------------------------------- the section


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"excitation.low_hz": 300.0}, "excitation.low_hz = 300.0 Hz: must be at most excitation.high_hz, 250 Hz"),
        ({"excitation.low_hz": 1.2, "excitation.high_hz": 1.8}, "must have a line between 1.2 and 1.8 Hz"),
        ({"excitation.rms": 1.0, "excitation.peak": 2.0}, "must be left out when excitation.rms is given"),
        ({"excitation.kind": "schroeder"}, "excitation.realisations = 4: must be 1"),
        ({"trial.kind": "excitation", "excitation.high_hz": 500.0}, "must be below 500 Hz, half of"),
        ({"trial.kind": "excitation", "excitation.period_s": 1.00037}, "whole number of ticks of 1/1000 s"),
        ({"excitation.rms": 200.0}, "excitation.rms = 200.0 N: must be at most rig.limits.effort, 100 N"),
        ({"excitation.periods": 0}, "excitation.periods = 0"),
        ({"excitation.chanel": "motor"}, "channel"),
    ],
)  # fmt: skip
def test_rules_of_the_section(changes: Any, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.override(CHAWDA, changes)
    assert message in str(caught.value)


def test_an_excited_run_starts_at_the_wall_without_a_push_and_lasts_as_long_as_its_periods() -> None:
    x = config.excited(config.override(CHAWDA, {"wall.position": 0.002, "excitation.period_s": 0.5}))
    assert (x.trial.kind, x.trial.start, x.trial.duration_s) == ("excitation", 0.002, 3.0)
    assert config.motor_push(x) == 0.0
    assert config.push_at_rest(x) == 0.0
    assert config.experiment_from_mapping(config.as_mapping(x), "again") == x
    assert excitation_run.ramp_s(x) == 0.5
    assert config.rig_model(x).operator is None
