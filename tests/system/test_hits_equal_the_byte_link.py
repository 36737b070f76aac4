"""A directly simulated hit equals the hit over the byte link, to the last bit of every number in a map."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import presets
from rig.control.judging import meter, recorded_signals, true_signals
from rig.core.sample import Phase
from rig.devices.device import DeviceUrl
from rig.devices.framed import FramedDevice
from rig.experiments.hits.hit_simulator import HitSimulator
from rig.recording.reader import open_recording
from sim_backend.ends.link import open_link
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import CURRENTS, trial_on

SHORT = {"trial.duration_s": 0.4, "verdict.tail_s": 0.1, "homing.settle_s": 0.02}
HELD = {"trial.kind": "human", "rig.limits.human": False, "operator.begin_s": 0.0, "operator.reach_s": 0.2}
COGS = {
    "rig.cogging.period": 0.02,
    "rig.cogging.orders": [1, 3],
    "rig.cogging.cosine": [0.01, 0.0],
    "rig.cogging.sine": [0.0, -0.02],
    "rig.cogging.ripple_cosine": [0.05, 0.0],
    "rig.cogging.ripple_sine": [0.0, -0.03],
}


@pytest.mark.parametrize(
    ("name", "changes"),
    first_by_default(
        [
            ("koul-compliant", {}),
            ("chawda-linear", HELD | COGS),
            ("koul-rigid", {"controller.velocity_rate": 20000, "controller.estimator": "disturbance"}),
            ("koul-compliant", HELD),
            ("koul-compliant", COGS),
            ("koul-rigid", HELD | {"rig.encoder.sign": -1, "wall.stiffness": 600.0}),
            ("chawda-linear", {"rig.simulation.computation_delay_ticks": 2}),
        ],
        3,
    ),
)
def test_every_number_of_a_hit_without_bytes_is_that_of_the_recording(
    name: str, changes: Any, tmp_path: Path
) -> None:
    experiment = config.override(presets.load(name), {**SHORT, **changes, "trial.seed": 5})
    simulator = HitSimulator(experiment)
    without_bytes = simulator.hit(experiment.wall.stiffness, experiment.wall.damping)

    placed = config.override(experiment, {"rig.simulation.initial_position": simulator.start})
    with FramedDevice(open_link(DeviceUrl.parse("sim://"), config.rig_model(placed))) as device:
        rows = open_recording(
            trial_on(device, placed, tmp_path / "hit.rigcap", seed=placed.trial.seed).recording
        ).rows

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
