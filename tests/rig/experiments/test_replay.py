"""Replay: recorded inputs through the same law give the recorded outputs exactly, however the run ended."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.connection import State
from rig import config
from rig.config import controller, presets
from rig.control.law import Law
from rig.core.errors import ConfigError, LawError, RecordingError, RigError
from rig.core.present import plain
from rig.core.sample import Phase, RowFlag
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.trials.replay import COMPUTED, replay
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.realtime.ring import Ring
from rig.recording.reader import open_recording
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

START = -0.015
SHORT = config.override(
    config.with_realtime(presets.load("koul-compliant")),
    {"trial.duration_s": 0.15, "trial.release_s": 0.003, "homing.settle_s": 0.003, "verdict.tail_s": 0.05},
)


def new_link(experiment: Any = SHORT, faults: Any = None) -> Any:
    return MemoryLink(make_device(config.rig_model(experiment), None, initial_position=START)[0], faults)


def record_trial(
    directory: Any, experiment: Any = SHORT, *, faults: Any = None, law: Any = None, error: Any = None
) -> Any:
    path = directory / "trial.rigcap"
    caught = None
    with FramedDevice(new_link(experiment, faults)) as device:
        try:
            trial_on(device, experiment, path, law=law, sealed=False)
        except RigError as raised:
            caught = raised
    assert (caught is None) if error is None else isinstance(caught, error), caught
    return open_recording(path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return record_trial(tmp_path_factory.mktemp("finished"))


def assert_exact(result: Any) -> None:
    for name in (*COMPUTED, "flags"):
        assert result.rows[name].tobytes() == result.recorded[name].tobytes(), name
    assert result.exact
    differences = (result.velocity_difference, result.effort_difference)
    assert differences == (0.0, 0.0) or np.isnan(differences[0])


# ---------------------------------------------------------------------- the same law


def test_a_run_whose_estimator_knows_the_effort_replays_exactly_over_gaps(tmp_path: Path) -> None:
    dropped = {"kind": FaultKind.DROP, "direction": Direction.TO_HOST}
    # In the trial, whether the host reads the dictionary first or knows it.
    faults = Faults(frames=tuple(FrameFault(**dropped, frame=frame) for frame in range(150, 180, 7)))
    x = config.override(SHORT, {"controller.estimator": "disturbance"})
    recording = record_trial(tmp_path, x, faults=faults)
    assert (recording.rows["flags"] & int(RowFlag.GAP)).any()
    assert_exact(replay(recording))


@pytest.mark.parametrize("name", first_by_default(presets.names(), 3))
def test_every_preset_replays_exactly(name: Any, tmp_path: Path) -> None:
    experiment = config.override(
        presets.load(name),
        {"trial.duration_s": 0.1, "trial.release_s": 0.02, "homing.settle_s": 0.01, "verdict.tail_s": 0.05},
    )
    assert_exact(replay(record_trial(tmp_path, experiment)))


def test_an_encoder_that_counts_down_replays_exactly(tmp_path: Path) -> None:
    down = config.override(SHORT, {"rig.encoder.sign": -1})
    recording = record_trial(tmp_path, down)
    assert recording.rows["count"].max() > 0
    assert_exact(replay(recording))


def test_a_fault_state_without_a_code_counts_as_an_end_too(finished: Any) -> None:
    """The loop ends on the state or the code; a device may report the FAULT state before its code."""
    half = finished.rows[: len(finished) // 2].copy()
    assert half["current_sent"][-1] != 0
    half["device_state"][-1] = State.FAULT
    half["current_sent"][-1] = 0
    half["effort_sent"][-1] = 0.0
    assert_exact(replay(replace(finished, rows=half)))


def test_a_run_that_ends_while_the_slew_limit_still_lowers_the_effort_replays_exactly(tmp_path: Path) -> None:
    """The loop sets zero in the last tick, where the guard alone would still be lowering the effort."""
    slow = config.override(SHORT, {"homing.slew": 4.0, "trial.duration_s": 0.02, "verdict.tail_s": 0.01})
    recording = record_trial(tmp_path, slow)
    assert recording.rows["phase"][-1] == Phase.DONE
    assert abs(recording.rows["current_sent"][-2]) > 5
    assert recording.rows["current_sent"][-1] == 0
    assert_exact(replay(recording))


@kernel(LAW_SIGNATURE)
def gives_nan(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    return np.nan if state[1] > 15.0 else 0.01 * state[1]


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > parameters[0]:
        raise ValueError("too deep for me")
    return 0.0


NAN_LAW = Law("nan", "for this test", gives_nan, 2, lambda wall: [])
RAISING_LAW = Law("raising", "for this test", raises, 2, lambda wall: [15.0])


@pytest.mark.parametrize("law", [NAN_LAW, RAISING_LAW])
def test_a_run_that_its_law_ended_replays_exactly(law: Law, tmp_path: Path) -> None:
    recording = record_trial(tmp_path, law=law, error=LawError)
    assert len(recording) > 15
    assert np.isnan(recording.rows["effort_wanted"][-1]) == (law is NAN_LAW)
    assert_exact(replay(recording, law=law))


def test_a_law_that_raises_in_a_replay_is_a_law_error(finished: Any) -> None:
    with pytest.raises(LawError, match="too deep for me"):
        replay(finished, {"wall.stiffness": 10.0}, law=RAISING_LAW)


# ---------------------------------------------------------------------- recordings that are not whole


def test_an_empty_recording_replays_to_nothing(finished: Any) -> None:
    result = replay(replace(finished, rows=finished.rows[:0]))
    assert len(result.rows) == 0
    assert result.exact
    assert (result.velocity_difference, result.effort_difference) == (0.0, 0.0)
    json.dumps(plain(result), allow_nan=False)


def test_a_lost_beginning_or_middle_is_refused(finished: Any) -> None:
    with pytest.raises(RecordingError, match="begins at tick 5"):
        replay(replace(finished, rows=finished.rows[5:]))
    with pytest.raises(RecordingError, match="missing in the middle"):
        replay(replace(finished, rows=np.delete(finished.rows, 20)))


def test_the_law_of_the_recording_must_be_installed(tmp_path: Path) -> None:
    recording = record_trial(tmp_path, law=NAN_LAW, error=LawError)
    with pytest.raises(ConfigError, match="unknown law 'nan'"):
        replay(recording)


# ---------------------------------------------------------------------- another law


def test_another_estimator_receives_the_same_motion(finished: Any) -> None:
    result = replay(finished, {"controller.estimator": "fdm"})
    assert result.estimator == "fdm"
    assert not result.exact
    for name in ("count", "position", "penetration", "edge_age", "elapsed_ticks", "tick"):
        np.testing.assert_array_equal(result.rows[name], finished.rows[name])
    delta, tick_s = SHORT.rig.encoder.resolution, 1 / SHORT.controller.position_rate
    raw = np.diff(finished.rows["count"]) * delta / tick_s  # at one estimate a tick
    np.testing.assert_allclose(result.rows["velocity"][1:], raw, atol=1e-9)
    difference = result.rows["velocity"] - finished.rows["velocity"]
    assert result.velocity_difference == pytest.approx(np.sqrt(np.mean(difference**2)))


def test_another_stiffness_changes_the_wall_alone(finished: Any) -> None:
    before = finished.rows.tobytes()
    result = replay(finished, {"wall.stiffness": 30.0, "wall.damping": 0.0})
    assert finished.rows.tobytes() == before
    np.testing.assert_array_equal(result.rows["velocity"], finished.rows["velocity"])
    assert result.velocity_difference == 0.0
    trial = finished.rows["phase"] == Phase.TRIAL
    depth = np.maximum(finished.rows["penetration"][trial], 0.0)
    np.testing.assert_allclose(result.rows["effort_wall"][trial], 30.0 * depth, atol=1e-12)
    assert result.effort_difference > 0.0


def test_changes_that_change_nothing_are_exact(finished: Any) -> None:
    """With changes the controller is rebuilt from the experiment instead of the header; both must be equal."""
    assert_exact(replay(finished, {"wall.stiffness": SHORT.wall.stiffness}))


# ---------------------------------------------------------------------- parameters that changed on the way


def test_a_wall_that_changed_during_the_run_changes_in_the_replay_at_the_same_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop accepts two changes between ticks while the handle approaches; the trailer stores them."""
    rings = []
    allocate = Ring.allocate
    monkeypatch.setattr(
        Ring, "allocate", lambda *given, **more: rings.append(allocate(*given, **more)) or rings[-1]
    )
    base = controller.for_experiment(SHORT, current_quantum_a=0.001)

    def posting(share: Any) -> Any:
        values = np.concatenate([[0.0], base.law.parameters])
        values[1] *= share
        return lambda device: rings[0].post(values)

    happenings = Faults(device=(Happening(60, posting(0.5)), Happening(64, posting(0.25))))
    recording = record_trial(tmp_path, faults=happenings)
    sets = recording.trailer["parameter_sets"]
    assert [one["number"] for one in sets] == [1, 2]
    active = recording.rows["parameter_set"]
    assert [int(active[one["tick"]]) for one in sets] == [1, 2]
    assert (np.diff(active) >= 0).all()
    result = replay(recording)
    assert_exact(result)
    inside = (recording.rows["penetration"] > 0.0) & (active == 2)
    assert inside.any(), "and the softer wall was touched"
    asked = replay(recording, {"wall.stiffness": SHORT.wall.stiffness})
    assert not asked.exact, "a wall asked for replaces them"
