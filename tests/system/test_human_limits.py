"""The limits for people apply to a person's trial however its kind or limits were set, and whatever fails in it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import controller, presets
from rig.config._sections import OSCILLATIONS
from rig.core.check import Check, Outcome
from rig.core.errors import ConfigError, PlanError
from rig.devices.fault_script import Faults, Happening
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.trials.plan import make_plan
from sim_backend.board.make_device import make_device
from tests.conformance.claimed import claim_to_be_real
from tests.conformance.struck import InMemory, StruckTrial
from tests.conformance.tiers import first_by_default

HELD = {"trial.kind": "human"}
SHORT = {
    "homing.settle_s": 0.02,
    "trial.duration_s": 0.6,
    "trial.release_s": 0.05,
    "verdict.tail_s": 0.1,
    "operator.begin_s": 0.0,
    "operator.reach_s": 0.2,
}


def held_rig(preset: str, **changes: Any) -> config.Experiment:
    return config.override(presets.load(preset), {**SHORT, **HELD, **changes})


def limits_of(experiment: config.Experiment) -> tuple[bool, float, int]:
    limits = experiment.rig.limits
    return limits.human, limits.effort / limits.nominal_effort, controller.oscillation_limit(experiment)


def human_limits(experiment: config.Experiment) -> Check:
    return next(check for check in make_plan(experiment).checks if check.name == "human limits")


# The motor of the preset "smartknob" is too weak for a hand.
@pytest.mark.parametrize("preset", [name for name in presets.names() if name != "smartknob"])
def test_a_persons_trial_on_a_preset_for_automated_trials_has_the_limits_for_people(
    preset: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f'preset = "{preset}"\n[trial]\nkind = "human"\n[operator]\npress = 1.0\n')
    x = presets.load(preset)
    press = {"operator.press": 1.0}
    whole = config.as_mapping(x)
    whole["realtime"] = {"trial.kind": "human", "operator.press": 1.0}
    for way in (
        config.load_experiment(file),
        config.override(x, {**HELD, **press}),
        config.override(config.override(x, {"rig.limits.effort": x.rig.limits.effort}), {**HELD, **press}),
        config.with_realtime(config.experiment_from_mapping(whole, "its [realtime]")),
    ):
        assert limits_of(way) == (
            True,
            min(x.rig.limits.effort / x.rig.limits.nominal_effort, 1.0),
            OSCILLATIONS,
        )
        assert human_limits(way).outcome is Outcome.OK
        assert config.experiment_from_mapping(config.as_mapping(way), "its recording") == way
    assert limits_of(x)[0] is False, "an automated trial keeps what the preset says"


def test_more_effort_than_a_person_may_meet_is_refused_wherever_it_is_written() -> None:
    with pytest.raises(ConfigError, match=r"must be at most rig\.limits\.nominal_effort, 0\.286"):
        held_rig("koul-rigid", **{"rig.limits.effort": 1.0})
    with pytest.raises(ConfigError, match=r"must be at most rig\.limits\.nominal_effort, 0\.286"):
        config.override(held_rig("koul-rigid"), {"rig.limits.effort": 1.0})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rig.limits.human": False}, "human = false, rig.limits.effort = 1.3 (at most 0.286 for people)"),
        (
            {"rig.limits.human": False, "rig.limits.effort": 0.28, "operator.press": 1.0},
            "and rig.limits.human = false; a real rig",
        ),
        (
            {"rig.limits.human": False, "rig.limits.override_stall": True},
            "and rig.limits.human = false; a real",
        ),
        ({"rig.limits.oscillations": 0}, "rig.limits.oscillations = 0 (1 to 10 for people)"),
        ({"rig.limits.oscillations": 11}, "rig.limits.oscillations = 11 (1 to 10 for people)"),
    ],
)
def test_other_limits_in_a_file_are_reported_and_refused_on_a_real_rig(
    changes: dict[str, Any], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = held_rig("koul-rigid", **{"wall.damping": 0.05, **changes})
    check = human_limits(experiment)
    assert (check.outcome, text in check.text) == (Outcome.WARNING, True), check.text
    claim_to_be_real(monkeypatch)
    with pytest.raises(PlanError, match="human limits: a person holds the handle"):
        next(hit(HitRequest(experiment=experiment, output=tmp_path, verified=True), admit))


def test_a_simulated_trial_with_other_limits_reports_them_in_its_result_and_recording(tmp_path: Path) -> None:
    experiment = held_rig("koul-rigid", **{"wall.damping": 0.05, "rig.limits.human": False})
    (result,) = hit(HitRequest(experiment=experiment, output=tmp_path), admit)
    text = human_limits(experiment).text
    for message in (
        result.messages[0],
        result.as_mapping()["messages"][0],
        result.recording.header["extra"]["warnings"][0],
    ):
        assert text in message


def test_an_override_for_stall_is_allowed_and_seen(tmp_path: Path) -> None:
    experiment = held_rig("koul-rigid", **{"rig.limits.override_stall": True, "rig.limits.effort": 1.3})
    assert limits_of(experiment) == (True, pytest.approx(1.3 / 0.286), OSCILLATIONS)
    assert "4.55 times the nominal effort" in human_limits(experiment).text
    assert human_limits(experiment).outcome is Outcome.WARNING


@pytest.mark.parametrize("preset", first_by_default(["hapkit", "koul-rigid", "koul-compliant"]))
def test_swapped_leads_in_a_persons_trial_give_no_more_than_the_nominal_effort(
    preset: str, tmp_path: Path
) -> None:
    """A bug once allowed 1.3 N·m on koul-rigid, 4.5 times nominal: a person got the limits of automated trials."""
    experiment = held_rig(preset, **{"operator.press": 1.0, "wall.damping": 0.05})
    tick = round(0.5 * experiment.controller.position_rate)

    def swap(device: Any) -> None:
        device.hardware.drive = device.hardware.gain = -1.0

    device, _ = make_device(config.rig_model(experiment), None, initial_position=experiment.trial.start)
    end = InMemory(device, Faults(device=(Happening(tick, swap),)), rest_s=0.1)
    rows = StruckTrial(end, tmp_path, experiment).rows
    effort = rows["effort_sent"][rows["sample_index"] >= tick]
    assert np.abs(effort).max() <= experiment.rig.limits.nominal_effort * (1.0 + 1e-9)
    assert effort[-1] == 0.0
