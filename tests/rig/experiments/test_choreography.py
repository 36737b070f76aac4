"""Phases of a person's trial: free space, a cue after a random time, a contact in time, a hold timed from contact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig import config
from rig.cli._hit_output import ProgressBars
from rig.config import presets
from rig.config._derive import free_s
from rig.control.verdict import Kind
from rig.core.errors import ConfigError
from rig.core.sample import HOLD, Phase, phase_name
from rig.devices.framed import FramedDevice
from rig.experiments.trials.judgement import judge
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.session.engine._baseline import baseline
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.trials import trial_on

HELD = config.override(
    presets.load("koul-compliant"),
    {
        "trial.kind": "human", "rig.limits.human": True, "rig.limits.effort": 0.2, "rig.limits.override_stall": True,
        "operator.press": 1.0, "trial.baseline_s": 0.2, "trial.foreperiod_s": 0.3, "trial.duration_s": 1.2,
        "trial.hold_s": 0.6, "wall.stiffness": 60.0, "wall.damping": 0.1, "controller.position_rate": 2_000,
        "controller.velocity_rate": 2_000, "verdict.tail_s": 0.3, "verdict.lowpass_hz": 400.0,
    },
)  # fmt: skip
RATE = HELD.controller.position_rate


def trial(directory: Path, begins_s: float = 0.0) -> Recording:
    """Run a trial whose simulated person reaches `begins_s` later (negative: earlier) than the experiment assumes."""
    model = config.rig_model(HELD)
    assert model.reach is not None
    hurried = replace(model, reach=replace(model.reach, wait_s=model.reach.wait_s + begins_s))
    path = directory / f"{begins_s:g}.rigcap"
    board, _ = make_device(hurried, None, initial_position=HELD.trial.start)
    with FramedDevice(MemoryLink(board)) as device:
        trial_on(device, HELD, path)
    return open_recording(path.with_suffix(".parquet"))


def phases(recording: Recording) -> list[Phase]:
    found = recording.rows["phase"]
    return [Phase(n) for n in found[np.flatnonzero(np.diff(found, prepend=-1))]]


def test_a_person_who_obeys_the_cue_holds_from_the_contact_on(tmp_path: Path) -> None:
    recording = trial(tmp_path)
    assert phases(recording)[-4:] == [Phase.FREE, Phase.TRIAL, Phase.RELEASE, Phase.DONE]
    rows = recording.rows
    waited = int((rows["phase"] == Phase.FREE).sum())
    assert waited == round(free_s(HELD) * RATE)
    assert 0.2 * RATE <= waited <= 0.5 * RATE
    led = rows[rows["phase"] == Phase.TRIAL]
    contact = int(np.argmax(led["penetration"] > 0.0))
    assert len(led) - contact == round(HELD.trial.hold_s * RATE)
    verdict = judge(recording, HELD).verdict
    assert verdict.kind is Kind.STABLE, verdict.reasons
    assert verdict.contact_s == pytest.approx(contact / RATE)
    free = baseline(recording, HELD)
    assert free is not None
    assert free.duration_s == pytest.approx(waited / RATE)
    assert free.sent_rms == 0.0


def test_a_person_who_anticipates_the_cue_makes_a_false_start_and_meets_no_wall(tmp_path: Path) -> None:
    recording = trial(tmp_path, begins_s=-0.3)
    assert phases(recording)[-2:] == [Phase.FREE, Phase.DONE]
    verdict = judge(recording, HELD).verdict
    assert verdict.kind is Kind.INVALID
    assert verdict.reasons == ("a false start: the handle moved before the cue",)
    assert recording.rows["effort_sent"][-1] == 0.0


def test_a_slow_person_holds_as_long_and_an_absent_one_makes_the_trial_invalid(tmp_path: Path) -> None:
    slow = trial(tmp_path, begins_s=0.7)
    assert judge(slow, HELD).verdict.kind is Kind.STABLE
    led = slow.rows[slow.rows["phase"] == Phase.TRIAL]
    assert (led["penetration"] > 0.0).sum() >= 0.9 * HELD.trial.hold_s * RATE
    absent = trial(tmp_path, begins_s=5.0)
    verdict = judge(absent, HELD).verdict
    assert (verdict.kind, verdict.reasons) == (Kind.INVALID, ("the wall was never touched",))
    assert (absent.rows["phase"] == Phase.TRIAL).sum() == round(HELD.trial.duration_s * RATE)


def test_the_foreperiod_is_the_seeds_and_spreads_over_its_range() -> None:
    waits = [free_s(config.override(HELD, {"trial.seed": seed})) for seed in range(200)]
    assert waits[7] == free_s(config.override(HELD, {"trial.seed": 7}))
    assert 0.2 <= min(waits) < 0.22
    assert 0.48 < max(waits) <= 0.5
    assert np.mean(waits) == pytest.approx(0.35, abs=4.0 * 0.3 / np.sqrt(12 * 200))


@pytest.mark.parametrize("key", ["trial.baseline_s", "trial.foreperiod_s", "trial.hold_s"])
def test_a_motor_keeps_its_clock(key: str) -> None:
    with pytest.raises(ConfigError, match="starts at a fixed time"):
        config.override(presets.load("koul-compliant"), {key: 0.5})


def test_every_phase_of_a_loop_has_a_name_and_a_progress_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    """A progress bar that raises an error would end the hit."""
    monkeypatch.setattr("rig.cli.output.on_terminal", lambda: True)
    shown = (*Phase, HOLD)
    assert len({phase_name(phase) for phase in shown}) == len(shown)
    assert phase_name(HOLD) == "hold"
    with ProgressBars(quiet=False) as bars:
        update = bars.watch(0, HELD)
        assert update is not None
        for phase in shown:
            update(1, int(phase))
