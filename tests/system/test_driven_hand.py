"""The hand of a simulated rig is moved in real time from another process, and the wall stops it."""

from pathlib import Path
from typing import Any

import pytest

from rig.config import override, presets
from rig.core.sample import Phase
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.realtime.hand import SharedHand
from tests.conformance.firmware import need_compiler

DRIVEN = override(
    presets.load("koul-rigid"),
    {
        "trial.kind": "human", "trial.baseline_s": 0.2, "trial.duration_s": 0.8, "trial.release_s": 0.05,
        "trial.start": -0.01, "verdict.tail_s": 0.2, "homing.settle_s": 0.05, "homing.speed": 0.5,
        "operator.begin_s": 0.2, "operator.reach_s": 0.2, "rig.simulation.initial_position": -0.01,
    },
)  # fmt: skip
SOFT = {"wall.stiffness": 12.0, "wall.damping": 0.1}  # holds at 1 kHz behind a port, in a hand
AHEAD, PRESS = 0.02, 2.0  # into the wall (rad, N)


@pytest.mark.parametrize("firmware", [False, True], ids=["readable", "firmware"])
@pytest.mark.quiet
def test_the_hand_follows_the_shared_memory(firmware: bool, tmp_path: Path) -> None:
    if firmware:
        need_compiler()
    seen, moved = [], {}
    with SharedHand.create(tmp_path / "hand") as hand:

        def watch(repeat: Any, experiment: Any) -> Any:
            def progress(ticks: Any, phase: Any) -> None:  # some fifty times a second, like a mouse
                seen.append(phase)
                # Read now: the memory has ended before a busy machine has sealed the recording.
                moved.update((motion.device_time_ns, motion) for motion in hand.motions())
                waits = seen.count(Phase.TRIAL) * 0.02 < experiment.trial.baseline_s + 0.1
                if phase == Phase.TRIAL and not waits:
                    hand.move(AHEAD, PRESS)
                else:
                    hand.move(experiment.trial.start, 0.0)

            return progress

        url = f"sim://?hand={hand.path}" + ("&firmware=1" if firmware else "")
        request = HitRequest(experiment=DRIVEN, url=url, realtime=True, output=tmp_path, changes=SOFT)
        (result,) = hit(request, admit, watch)
    rows = result.recording.rows
    same = [row for row in rows if int(row["device_time"]) in moved]
    assert same, "what the hand did is in the recording"
    for row in same:  # at the sample's own time, within one count
        assert abs(moved[int(row["device_time"])].handle - row["position"]) <= DRIVEN.rig.encoder.resolution
    trial = rows[rows["phase"] == Phase.TRIAL]
    free = trial[: len(trial) // 10]
    assert (free["penetration"] <= 0.0).all()
    assert (trial["penetration"][-len(trial) // 10 :] > 0.0).all(), "it was driven into the wall, and stays"
    assert result.verdict.contact_s > DRIVEN.trial.baseline_s
    push = trial["effort_sent"][-len(trial) // 10 :].mean()
    operator, radius = DRIVEN.operator, DRIVEN.rig.mechanics.handle_radius
    most = (PRESS + operator.hand_stiffness * AHEAD * radius) * radius
    assert -1.2 * most < push < -0.5 * most, "as hard as the hand presses there"
