"""A trial over the byte link, and each number of a hit in a map, equal the direct simulation to the last bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import controller, presets
from rig.control.judging import meter, recorded_signals, true_signals
from rig.core.sample import Phase
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.recording.header import repeatable
from rig.recording.reader import open_recording
from sim_backend.bare import trial as bare
from sim_backend.ends.link import open_link
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import CURRENTS, trial_on

SHORT = {"trial.duration_s": 0.15, "trial.release_s": 0.02, "verdict.tail_s": 0.05, "homing.settle_s": 0.02}
HELD = {
    "trial.kind": "human",
    "rig.limits.human": False,  # hard presses on stiff walls
    "trial.duration_s": 0.25,
    "operator.begin_s": 0.06,
    "operator.reach_s": 0.1,
}
LONGER = {"trial.duration_s": 0.4, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
PUSHED = {"trial.kind": "human", "rig.limits.human": False, "operator.begin_s": 0.0, "operator.reach_s": 0.2}
COGS = {
    "rig.cogging.period": 0.02,
    "rig.cogging.orders": [1, 3],
    "rig.cogging.cosine": [0.01, 0.0],
    "rig.cogging.sine": [0.0, -0.02],
    "rig.cogging.ripple_cosine": [0.05, 0.0],
    "rig.cogging.ripple_sine": [0.0, -0.03],
}


def over_the_wire(experiment: Any, path: Any, url: str = "sim://") -> Any:
    link = open_link(DeviceUrl.parse(url), config.rig_model(experiment))
    with FramedDevice(link) as device:
        return open_recording(trial_on(device, experiment, path, seed=experiment.trial.seed).recording)


@pytest.mark.parametrize("name", first_by_default(presets.names(), 2))
@pytest.mark.parametrize(
    "changes",
    [{}, {"controller.estimator": "disturbance"}, HELD, {**HELD, "operator.grip": "firm", "trial.seed": 3}],
    ids=["filtered", "effort known", "held", "held firmly"],
)
def test_the_trajectory_over_the_byte_link_is_that_of_a_trial_without_bytes(
    name: Any, changes: Any, tmp_path: Path
) -> None:
    preset = presets.load(name)
    # The preset's own press is what its motor can bear.
    press = {"operator.press": preset.operator.press} if "operator.grip" in changes else {}
    experiment = config.override(preset, {**SHORT, **changes, **press})
    recording = over_the_wire(experiment, tmp_path / "hit.rigcap")
    rows = recording.rows

    quantum = experiment.rig.amplifier.current_quantum_a
    law = controller.for_experiment(experiment, current_quantum_a=quantum)
    model, tick_s = config.rig_model(experiment), 1.0 / experiment.controller.position_rate
    plant, script = DiscretePlant.build(model, tick_s), OperatorScript.of(model, tick_s, 0.0)
    start = int(rows["device_time"][0] * 16 // 1000)
    trace = bare.run_trial(law, plant, 0.0, most_ticks=len(rows) + 10, start_units=start, script=script)

    assert len(trace.counts) == len(rows)
    assert set(trace.phases) >= {Phase.TRIAL, Phase.RELEASE, Phase.DONE}
    if experiment.trial.kind == "human":
        assert trace.states[:, plant.handle_position].max() > experiment.wall.position, "the hand must hit"
    np.testing.assert_array_equal(trace.counts, rows["count"])
    np.testing.assert_array_equal(trace.currents, rows["current_sent"])
    np.testing.assert_array_equal(trace.phases, rows["phase"])
    np.testing.assert_array_equal(trace.flags, rows["flags"] & ~CURRENTS)
    for column, index in (
        ("position_true", plant.sensed_position),
        ("velocity_true", plant.sensed_position + 1),
        ("effort_true", plant.effort),
        ("handle_position_true", plant.handle_position),
    ):
        assert trace.states[:, index].tobytes() == rows[column].tobytes(), column


@pytest.mark.exhaustive("::test_the_trajectory_over_the_byte_link_is_that_of_a_trial_without_bytes")
def test_the_same_seed_gives_the_same_recording_bit_for_bit(tmp_path: Path) -> None:
    experiment = config.override(
        presets.load("koul-compliant"), {**SHORT, "rig.amplifier.current_noise_a": 0.01}
    )
    first, second = (over_the_wire(experiment, tmp_path / f"{n}.rigcap", "sim://?seed=7") for n in (1, 2))
    other = over_the_wire(experiment, tmp_path / "3.rigcap", "sim://?seed=8")

    assert first.rows.tobytes() == second.rows.tobytes()
    assert repeatable(first.header) == repeatable(second.header)
    assert first.trailer == second.trailer
    assert first.rows["current_measured"].tobytes() != other.rows["current_measured"].tobytes()
    assert first.rows["count"].tobytes() == other.rows["count"].tobytes(), (
        "sensor noise of the current is not felt"
    )


def test_a_second_trial_in_the_same_hand_begins_where_the_first_one_left_the_handle(tmp_path: Path) -> None:
    """The simulated tremor differs in each trial, so repeats are independent; homing works while the hand holds on."""
    experiment = config.override(presets.load("koul-compliant"), {**SHORT, **HELD})
    link = open_link(DeviceUrl.parse("sim://"), config.rig_model(experiment))
    counts = []
    with FramedDevice(link) as device:
        for repeat in (1, 2):
            rows = open_recording(trial_on(device, experiment, tmp_path / f"{repeat}.rigcap").recording).rows
            pushed = rows["count"][rows["phase"] == Phase.TRIAL]
            assert pushed[0] < 0 < pushed.max()
            counts.append(pushed)
    assert counts[0].tobytes() != counts[1].tobytes()


@pytest.mark.parametrize(
    ("name", "changes"),
    first_by_default(
        [
            ("koul-compliant", {}),
            ("chawda-linear", PUSHED | COGS),
            ("koul-rigid", {"controller.velocity_rate": 20000, "controller.estimator": "disturbance"}),
            ("koul-compliant", PUSHED),
            ("koul-compliant", COGS),
            ("koul-rigid", PUSHED | {"rig.encoder.sign": -1, "wall.stiffness": 600.0}),
            ("chawda-linear", {"rig.simulation.computation_delay_ticks": 2}),
        ],
        3,
    ),
)
def test_a_hit_without_bytes_has_the_numbers_of_a_recording(name: str, changes: Any, tmp_path: Path) -> None:
    experiment = config.override(presets.load(name), {**LONGER, **changes, "trial.seed": 5})
    simulator = HitSimulator(experiment)
    without_bytes = simulator.hit(experiment.wall.stiffness, experiment.wall.damping)

    placed = config.override(experiment, {"rig.simulation.initial_position": simulator.start})
    rows = over_the_wire(placed, tmp_path / "hit.rigcap").rows

    tick_s, resolution = 1.0 / placed.controller.position_rate, placed.rig.encoder.resolution
    measuring = meter(simulator.limits, tick_s, resolution)
    recorded = recorded_signals(rows, tick_s, resolution)
    for signals, measured in (
        (recorded, without_bytes.recorded),
        (true_signals(rows, recorded, placed.wall.position, placed.wall.side), without_bytes.true),
    ):
        again = measuring.true if signals.velocity is not None else measuring.recorded
        arrays = [signals.position, signals.effort, signals.penetration]
        if signals.velocity is not None:
            arrays.insert(1, signals.velocity)
        flags = rows["flags"][rows["phase"] == Phase.TRIAL].astype(np.int64) & ~CURRENTS
        numbers = again(*arrays, flags)
        assert numbers.tobytes() == measured.numbers.tobytes()
    assert without_bytes.true.numbers["contact_s"] > 0.0
