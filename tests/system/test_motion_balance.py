"""A change of encoder scale in a trial spoils the verdict if effort and motion show it; drift is not detected."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import presets
from rig.control.verdict import Kind
from rig.core.sample import Phase
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.trials.judgement import Judgement, judge
from rig.recording.reader import open_recording
from sim_backend.board.make_device import make_device
from sim_backend.ends.link import MemoryLink
from tests.conformance.tiers import first_by_default
from tests.conformance.trials import trial_on

SHORT = {"trial.duration_s": 0.4, "verdict.tail_s": 0.15}


def walls_on(preset: str, changes: dict[str, Any]) -> config.Experiment:
    return config.override(presets.load(preset), {**SHORT, **changes})


def judged(x: config.Experiment, path: Path, *happenings: Happening) -> tuple[Judgement, Any]:
    """Run a trial with scheduled faults of the device; return its judgement and its rows."""
    device, _ = make_device(config.rig_model(x), None, seed=x.trial.seed, initial_position=x.trial.start)
    path.unlink(missing_ok=True)
    with FramedDevice(MemoryLink(device, Faults(device=happenings))) as framed:
        trial_on(framed, x, path, seed=x.trial.seed, sealed=False)
    recording = open_recording(path)
    return judge(recording, x), recording.rows


def scaled(scale: float, first: int, ticks: int) -> list[Happening]:
    """Return faults that make the encoder show `scale` times the true motion, by a new count offset each tick."""
    begin: list[int] = []

    def slip(device: Any) -> None:
        true = device.hardware.count - device.hardware.slip
        begin[:] = begin or [true]
        device.hardware.slip = round((scale - 1.0) * (true - begin[0]))

    return [Happening(tick, slip) for tick in range(first, first + ticks)]


def drifting(counts_per_s: float, first: int, rate: int) -> list[Happening]:
    """Return faults that add one count at regular times, so that the count drifts."""

    def step(device: Any) -> None:
        device.hardware.slip += 1

    return [Happening(first + round(n * rate / counts_per_s), step) for n in range(round(counts_per_s))]


def contact_of(rows: Any) -> int:
    """Return the tick of the device at the first contact."""
    return int(rows["sample_index"][(rows["phase"] == Phase.TRIAL) & (rows["penetration"] > 0.0)][0])


@pytest.mark.parametrize("preset", first_by_default(presets.names()))
def test_a_changed_encoder_scale_is_detected_and_a_sound_encoder_is_not_reported(
    preset: str, tmp_path: Path
) -> None:
    """A few of the 200 sound and 288 changed trials in the table of rig/docs/explanation/verdicts.md."""
    path = tmp_path / "trial.rigcap"
    x = walls_on(preset, {"trial.seed": 7, "rig.encoder.offset": 0.37})
    sound, rows = judged(x, path)
    assert sound.motion is not None
    assert sound.motion.ratio == pytest.approx(1.0, abs=0.2)
    assert not sound.motion.changed
    contact = contact_of(rows)
    m, recording = x.rig.mechanics, open_recording(path)
    for inertia, friction in ((0.5, 1.0), (2.0, 1.0), (1.0, 0.0), (1.0, 2.0)):
        wrong = replace(
            m,
            motor_inertia=inertia * m.motor_inertia,
            link_inertia=inertia * m.link_inertia,
            motor_coulomb=friction * m.motor_coulomb,
            link_coulomb=friction * m.link_coulomb,
        )
        misread = judge(recording, replace(x, rig=replace(x.rig, mechanics=wrong))).motion
        assert misread is not None
        assert not misread.changed, (inertia, friction)
    if preset == "smartknob":  # its device ends the trial then: the current is not the one that was set
        return
    for scale in (0.5, 2.0):
        found, _ = judged(x, path, *scaled(scale, contact, len(rows)))
        assert found.verdict.kind is Kind.INVALID
        assert "the encoder's scale changed in the trial" in found.verdict.reasons[0]
        assert found.motion is not None
        assert found.motion.ratio == pytest.approx(scale, rel=0.2)
        assert found.early is not None, "a map on a rig repeats such a hit"


@pytest.mark.exhaustive("::test_a_changed_encoder_scale_is_detected_and_a_sound_encoder_is_not_reported")
def test_a_changed_scale_at_rest_is_not_detected_and_its_effect_is_small(tmp_path: Path) -> None:
    """Scale ½ or 2, or drift of 100 counts/s, once the handle rests: the verdict stays stable, as FMEA.md says."""
    x, path = walls_on("koul-compliant", {}), tmp_path / "trial.rigcap"
    rate = x.controller.position_rate
    _, rows = judged(x, path)
    rest = contact_of(rows) + round(0.15 * rate)
    for faults in (scaled(0.5, rest, len(rows)), scaled(2.0, rest, len(rows)), drifting(100.0, rest, rate)):
        found, rows = judged(x, path, *faults)
        assert found.verdict.kind is Kind.STABLE
        assert found.motion is None or not found.motion.changed
        tail = rows[rows["phase"] == Phase.TRIAL][-round(0.15 * rate) :]
        friction = x.rig.mechanics.motor_coulomb + x.rig.mechanics.link_coulomb
        assert abs(tail["effort_applied"].mean()) <= 1.1 * friction, "no more than friction moves the handle"


def test_without_known_effort_or_friction_the_encoder_scale_is_not_judged(tmp_path: Path) -> None:
    x = walls_on("chawda-linear", {})
    judged(x, tmp_path / "trial.rigcap")
    recording = open_recording(tmp_path / "trial.rigcap")
    for unknown in (
        replace(x, trial=replace(x.trial, kind="human")),
        config.override(x, {"rig.amplifier.lag_s": 0.003}),
        config.override(
            x,
            {"rig.cogging.period": 0.1, "rig.cogging.orders": [1], "rig.cogging.cosine": [0.01],
             "rig.cogging.sine": [0.0]},
        ),
    ):  # fmt: skip
        assert judge(recording, unknown).motion is None
    rows = [row for row in judge(recording, unknown).rows(unknown) if row.label == "encoder scale"]
    assert "not checked" in str(rows[0].value)
