"""A control law that runs on the device, from configuration to recording, against the compiled firmware."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.config._derive import free_s
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.core.sample import Phase
from rig.experiments.hits._on_device import OnDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.mapping import impedance
from rig.experiments.trials import _trial as trial
from rig.experiments.trials import live
from rig.experiments.trials.plan import make_plan
from rig.experiments.trials.replay import replay
from rig.recording.reader import open_recording
from rig.testing import Hits, assert_stable
from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default

EXAMPLE = Path(__file__).parents[2] / "firmware_protocol/firmware/boards/rp2040/example.toml"
SHORT = {
    "trial.duration_s": 0.3,
    "trial.release_s": 0.02,
    "homing.settle_s": 0.01,
    "verdict.tail_s": 0.1,
    "rig.simulation.initial_position": -0.015,
}
BOARD = config.override(config.load_experiment(EXAMPLE), SHORT)
FLOAT = config.override(
    presets.load("koul-rigid"),
    {**SHORT, "controller.loop": "device", "wall.stiffness": 150.0, "wall.damping": 0.1},
)


@pytest.mark.parametrize(("experiment", "quanta"), [(BOARD, 1), (FLOAT, 2)], ids=["integers", "float32"])
def test_a_hit_on_the_device_is_the_hit_of_the_host(experiment: Any, quanta: int, rig_hit: Hits) -> None:
    there, here = rig_hit(experiment), rig_hit(experiment, {"controller.loop": "host"})
    recording = there.recording
    assert [hit.recording.header["extra"]["loop"] for hit in (there, here)] == ["device", "host"]
    for ours, theirs in ((there.verdict, here.verdict), (there.verdict_true, here.verdict_true)):
        assert ours.kind == theirs.kind
        for number in ("peak_penetration", "impact_velocity", "contact_s"):
            assert getattr(ours, number) == pytest.approx(getattr(theirs, number), rel=0.01), number
    rows = recording.rows
    assert (rows["elapsed_ticks"] == 1).all()
    assert set(rows["phase"].tolist()) == set(Phase) - {Phase.WAIT, Phase.FREE}
    moved = rows["current_applied"][1:] - rows["current_sent"][:-1]
    assert np.abs(moved[rows["phase"][:-1] < Phase.DONE]).max() <= quanta
    agreement = recording.trailer["device_host_agreement"]
    assert agreement["holds"]
    assert agreement["greatest_quanta"] <= quanta


def test_a_wall_that_changes_while_the_device_runs_it_replays_at_its_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rings = []
    own = trial._ring
    monkeypatch.setattr(trial, "_ring", lambda *given: rings.append(own(*given)) or rings[-1])
    posted = []

    def watch(repeat: Any, experiment: Any) -> Any:
        def progress(ticks: Any, phase: Any) -> None:
            if not posted:
                posted.append(live._post(rings[0], {"wall.stiffness": 90.0, "wall.damping": 0.05}))
                with pytest.raises(PlanError, match="cannot change while"):
                    live._post(rings[0], {"wall.damping_on": "entry"})

        return progress

    patient = config.override(BOARD, {"homing.settle_s": 4.0})
    (result,) = hit(HitRequest(experiment=patient, output=tmp_path), admit, watch)
    assert [number for number, _ in posted] == [1]
    recording = result.recording
    (taken,) = recording.trailer["parameter_sets"]
    sets = recording.rows["parameter_set"]
    assert set(sets.tolist()) == {0, 1}
    assert recording.rows["penetration"][np.flatnonzero(sets)[0]] <= 0.0
    assert recording.trailer["device_host_agreement"]["holds"]
    assert taken["parameters"][0] == 90.0
    assert replay(recording).exact


def test_an_impedance_excited_by_the_device_is_that_of_the_host(tmp_path: Path) -> None:
    changes = {
        "excitation.channel": "motor",
        "excitation.low_hz": 20.0,
        "excitation.high_hz": 200.0,
        "excitation.period_s": 0.05,
        "excitation.periods": 4,
        "excitation.settle_periods": 4,
        "excitation.realisations": 1,
        "excitation.kind": "schroeder",
        "wall.stiffness": 100.0,
        "wall.damping": 0.05,
    }
    x = config.override(BOARD, changes)

    def measured(experiment: Any) -> Any:
        where = OnDevice(url="sim://", recordings=tmp_path)
        (result,) = impedance.measure_on_device(experiment, where)
        assert result.ended is None
        return result

    there, here = measured(x), measured(config.override(x, {"controller.loop": "host"}))
    assert plain(there)["loop"] == "device"
    assert there.note is None
    size = np.abs(here.impedance.z)
    assert (np.abs(there.impedance.z - here.impedance.z) < 0.05 * size).all()
    recording = open_recording(there.recordings[0])
    assert recording.header["identity"]["parameters"]["excitation_lines"] == 10
    assert recording.trailer["device_host_agreement"]["holds"]
    assert replay(recording).exact


def test_a_map_of_a_device_is_hit_by_its_own_law(run: Any, tmp_path: Path) -> None:
    need_compiler()
    sets = [f"--set={key}={value}" for key, value in SHORT.items()]
    narrow = ["--scheme", "dual:20k/2k", "--damping", "0.1", "--search", "bisection", "-K", "100:120"]
    code, out, _ = run(
        "zwidth", EXAMPLE, "--url", "sim://", *sets, *narrow, "--no-plot", "--json", "-o", tmp_path
    )
    assert code == 0
    found = json.loads(out)
    assert found["hits"] == 2
    assert found["note"] is None
    recordings = [open_recording(path) for path in tmp_path.rglob("*.parquet") if path.name != "hits.parquet"]
    assert [one.header["extra"]["loop"] for one in recordings] == ["device", "device"]


def test_a_map_in_simulation_names_the_device_that_it_represents(run: Any, tmp_path: Path) -> None:
    narrow = ["--scheme", "dual:20k/2k", "--damping", "0.1", "--offsets", "0.1", "-K", "100:120"]
    code, out, _ = run("zwidth", EXAMPLE, *narrow, "--no-plot", "-o", tmp_path)
    assert code == 0
    assert "it represents that of the device" in out


def test_a_device_without_a_law_is_refused_before_anything_moves(run: Any, tmp_path: Path) -> None:
    code, _, err = run("hit", EXAMPLE, "--url", "sim://koul-rigid?firmware=0", "--no-plot", "-o", tmp_path)
    assert code == PlanError.exit_code
    assert "cannot run the law itself" in err
    assert "firmware=1" in err
    assert not list(tmp_path.glob("*.rigcap"))


@pytest.mark.parametrize("loop", first_by_default(["host", "device"]))
def test_a_planned_run_is_the_one_that_runs(loop: str, tmp_path: Path) -> None:
    experiment = config.override(presets.load("koul-rigid"), {"controller.loop": loop})
    run = make_plan(experiment).run
    assert run is not None
    (result,) = hit(HitRequest(experiment=experiment, output=tmp_path), admit)
    header = result.recording.header
    assert header["initial_state"] == json.loads(json.dumps(run.controller.as_mapping()))
    active, planned = header["identity"]["parameters"], {**run.parameters, "verified": 1}
    # The wire carries float32.
    assert {name: active[name] for name in planned} == pytest.approx(planned, rel=2.0**-24)


@pytest.mark.parametrize("loop", first_by_default(["device", "host"]))
def test_a_person_waits_for_the_cue_and_holds_alike_on_either_side(loop: str, rig_hit: Hits) -> None:
    held = {
        "trial.kind": "human",
        "trial.baseline_s": 0.1,
        "trial.foreperiod_s": 0.2,
        "trial.duration_s": 1.0,
        "trial.hold_s": 0.5,
        "verdict.tail_s": 0.2,
        "controller.loop": loop,
    }
    experiment = config.override(BOARD, held)
    hit = rig_hit(experiment)
    rows = hit.recording.rows
    rate = experiment.controller.position_rate
    assert (rows["phase"] == Phase.FREE).sum() == round(free_s(experiment) * rate)
    led = rows[rows["phase"] == Phase.TRIAL]
    assert len(led) - np.argmax(led["penetration"] > 0.0) == round(0.5 * rate)
    assert_stable(hit)
