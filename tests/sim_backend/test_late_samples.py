"""Late and lost samples in the direct simulation of a trial equal those of a loop over a lossy, delaying link."""

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig import config
from rig.config import controller, presets
from rig.core.sample import Phase, RowFlag
from rig.devices.fault_script import Direction, FaultKind, Faults, FrameFault
from rig.devices.framed import FramedDevice
from rig.experiments.trials import _trial as running_trial
from rig.recording.reader import open_recording
from sim_backend.bare.trial import UNSEEN, run_trial
from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.link import MemoryLink
from sim_backend.mechanics.plant import DiscretePlant
from tests.conformance.late_samples import LOST, ages
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import CURRENTS, trial_on

BRIEF = {"trial.duration_s": 0.15, "trial.release_s": 0.003, "homing.settle_s": 0.003, "verdict.tail_s": 0.05}
SLOW = config.override(config.with_realtime(presets.load("koul-compliant")), BRIEF)
DUAL = config.override(presets.load("koul-rigid"), BRIEF)


def over_bytes(experiment: Any, path: Path, delays: Any, first_frame: int) -> Any:
    """Return the rows of a run over the byte link whose STATE frames from `first_frame` on are lost or late."""
    faults = tuple(
        FrameFault(
            kind=FaultKind.DROP if delay == LOST else FaultKind.DELAY,
            direction=Direction.TO_HOST,
            frame=first_frame + sample,
            ticks=max(0, int(delay)),
        )
        for sample, delay in enumerate(delays)
        if delay != 0
    )
    device = SimulatedDevice(config.rig_model(experiment), initial_position=experiment.trial.start)
    with FramedDevice(MemoryLink(device, Faults(frames=faults))) as framed:
        trial_on(framed, experiment, path, sealed=False)
    return open_recording(path).rows


def without_bytes(experiment: Any, delays: Any) -> Any:
    rate = experiment.controller.position_rate
    law = controller.for_experiment(experiment, current_quantum_a=experiment.rig.amplifier.current_quantum_a)
    plant = DiscretePlant.build(config.rig_model(experiment), 1.0 / rate)
    return run_trial(law, plant, experiment.trial.start, most_ticks=rate, ages=ages(delays))


def first_frame(experiment: Any, directory: Path) -> int:
    """Return the number of the frame with the law's first sample, found by losing one; the dictionary is cached."""
    over_bytes(experiment, directory / "known.rigcap", np.zeros(0, np.int64), 0)
    delays = np.zeros(90, np.int64)
    delays[80] = LOST
    rows = over_bytes(experiment, directory / "one.rigcap", delays, 0)
    after = rows["elapsed_ticks"].argmax()
    assert rows["elapsed_ticks"][after] == 2
    return int(80 - (rows["sample_index"][after] - 1 - rows["sample_index"][0]))


@pytest.mark.parametrize("experiment", first_by_default([SLOW, DUAL]), ids=["1 kHz", "20 kHz, dual-rate"])
def test_a_trial_without_bytes_is_the_one_over_a_link_that_loses_and_delays(
    experiment: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running_trial, "EVERY_NS", 0)  # each frame to the host then is a STATE
    rate = experiment.controller.position_rate
    clean = without_bytes(experiment, np.zeros(0, np.int64))
    begin = int(np.flatnonzero(clean.phases == Phase.TRIAL)[0])
    contact = begin + int(np.flatnonzero(clean.counts[begin:] > 0)[0])
    drawn = np.random.default_rng(1)
    delays = np.zeros(begin + round(0.15 * rate), np.int64)
    delays[begin:][drawn.random(len(delays) - begin) < 0.02] = LOST
    delays[contact : contact + 3] = LOST  # in the impact
    delays[contact + 10 : contact + 20] = 2  # a stretch of late ones
    delays[contact + 30] = 3  # one alone
    expected = without_bytes(experiment, delays)
    rows = over_bytes(experiment, tmp_path / "late.rigcap", delays, first_frame(experiment, tmp_path))
    seen = np.flatnonzero(expected.phases != UNSEEN)
    assert (rows["sample_index"] - rows["sample_index"][0]).tolist() == seen.tolist()
    assert rows["count"].tolist() == expected.counts[seen].tolist()
    assert rows["current_sent"].tolist() == expected.currents[seen].tolist()
    assert (rows["flags"] & ~CURRENTS).tolist() == expected.flags[seen].tolist()
    struck = rows["flags"][rows["phase"] == Phase.TRIAL]
    assert (struck & int(RowFlag.GAP) != 0).sum() > 4
    assert (struck & int(RowFlag.LATE) != 0).sum() >= 8
    assert rows["current_sent"].tolist() != clean.currents[seen].tolist(), "losses change the trajectory"
