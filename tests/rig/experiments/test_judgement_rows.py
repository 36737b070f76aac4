"""Rows of a judgement: each number with its unit, its limit and, in simulation, the truth."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.config import override, presets, verdict_thresholds
from rig.control.verdict import Kind
from rig.core import extras
from rig.core.errors import ConfigError
from rig.core.present import Row, plain
from rig.core.sample import unit_of
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, HitResult, hit
from rig.experiments.trials.judgement import Verdicts, judge, out_of_time, verdicts_of
from rig.experiments.trials.plan import make_plan


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> HitResult:
    experiment = override(presets.load("koul-compliant"), {"trial.duration_s": 0.5})
    (found,) = hit(HitRequest(experiment=experiment, output=tmp_path_factory.mktemp("hits")), admit)
    return found


def rows_of(result: HitResult) -> dict[str, Row]:
    return {row.label: row for row in result.recorded.judgement.rows(result.experiment)}


def test_rows_are_the_numbers_of_the_verdict_in_si_units(result: HitResult) -> None:
    rows, verdict = rows_of(result), result.verdict
    for label, name, quantity in (
        ("peak penetration", "peak_penetration", "position"),
        ("resting penetration", "resting_penetration", "position"),
        ("peak effort", "peak_effort", "effort"),
        ("heard (effort ripple, rms)", "heard", "effort"),
        ("moved (position ripple, p-p)", "moved", "position"),
    ):
        assert rows[label].value == getattr(verdict, name)
        assert rows[label].unit == unit_of(quantity, "rotary")
    assert rows["verdict"].value is verdict.kind is Kind.STABLE


def test_every_threshold_stands_beside_its_number_and_the_truth(result: HitResult) -> None:
    thresholds, rows = verdict_thresholds(result.experiment), rows_of(result)
    limits = {"felt": thresholds.felt_velocity, "heard": thresholds.heard_effort, "moved": thresholds.moved}
    for label, row in rows.items():
        if (name := label.partition(" ")[0]) in limits:
            assert f"limit {limits.pop(name):.3g}, " in row.note
            assert "true " in row.note
    assert not limits
    assert rows["peak effort"].note == f"limit {result.experiment.rig.limits.effort:g}"


def test_a_handle_that_never_settles_has_no_resting_penetration(result: HitResult) -> None:
    judgement = result.recorded.judgement
    never = replace(judgement, verdict=replace(judgement.verdict, settling_s=None))
    assert "resting penetration" not in {row.label for row in never.rows(result.experiment)}


def test_a_ripple_below_a_count_is_not_measurable_and_null_in_json(result: HitResult) -> None:
    assert result.verdict.felt is None
    assert rows_of(result)["felt (velocity ripple, rms)"].value == "not measurable"
    mapping = plain(result)
    assert mapping["verdict"]["felt"] is None
    assert set(mapping["verdict"]) == set(mapping["verdict_true"])
    assert mapping["thresholds"]["felt_velocity"] == verdict_thresholds(result.experiment).felt_velocity


def trailer_with(result: HitResult, **changes: Any) -> dict[str, Any]:
    """Return a trailer whose verdict contradicts the rows."""
    trailer = dict(result.recorded.recording.trailer or {})
    return trailer | {"verdict": trailer["verdict"] | {"kind": "unstable", "growth": "Infinity"} | changes}


def test_a_sealed_recording_keeps_the_verdict_that_the_run_had(result: HitResult) -> None:
    sealed, experiment = result.recorded.recording, result.experiment
    assert plain(verdicts_of(sealed, experiment)) == plain(result.recorded.judgement)
    read = verdicts_of(replace(sealed, trailer=trailer_with(result)), experiment)
    assert (read.verdict.kind, read.verdict.growth) == (Kind.UNSTABLE, float("inf"))
    assert read.verdict_true == result.verdict_true


@pytest.mark.parametrize(
    "changes", [None, {"kind": "calm"}, {"growth": None}, {"ticks": "many"}, {"reasons": 3}], ids=str
)
def test_without_a_verdict_it_is_judged_again(result: HitResult, changes: dict[str, Any] | None) -> None:
    trailer = {"reason": "finished"} if changes is None else trailer_with(result, **changes)
    recording = replace(result.recorded.recording, trailer=trailer)
    found: Verdicts = judge(recording, result.experiment)
    assert plain(verdicts_of(recording, result.experiment)) == plain(found)
    assert found.verdict.kind is Kind.STABLE


@pytest.mark.parametrize("coulomb", [1.0, 0.0])
def test_a_handle_that_friction_held_away_from_its_start_has_a_row(coulomb: float, tmp_path: Path) -> None:
    """Homing ends where the servo no longer overcomes friction, within its tolerance: 0.9 mrad away on koul-rigid."""
    preset = presets.load("koul-rigid")
    names = ("motor_coulomb", "link_coulomb")
    mechanics = {f"rig.mechanics.{name}": coulomb * getattr(preset.rig.mechanics, name) for name in names}
    experiment = override(preset, {"trial.duration_s": 0.05, "verdict.tail_s": 0.02, **mechanics})
    (found,) = hit(HitRequest(experiment=experiment, output=tmp_path), admit)
    rows = rows_of(found)
    if coulomb == 0.0:
        assert "start" not in rows
        return
    assert rows["start"].value == pytest.approx(experiment.trial.start + 0.9e-3, abs=0.1e-3)
    assert "friction held the handle 0.00086 rad from trial.start" in rows["start"].note
    assert plain(found.as_mapping())["began"] == rows["start"].value


@pytest.mark.parametrize(("fault", "expected"), [
    ("TICK_OVERRUN", True), ("LINK_LOST", True), ("DRIVE_SILENT", True), ("OVER_SPEED", False), (None, False),
])  # fmt: skip
def test_a_fault_of_missed_time_is_recognised(fault: str | None, expected: bool, result: HitResult) -> None:
    """The fault of a drive behind a bridge counts too, even if the installation has no bridge."""
    trailer = {"reason": "device_fault", "fault": None if fault is None else {"name": fault}}
    assert out_of_time(replace(result.recorded.recording, trailer=trailer)) is expected


def test_a_wall_that_was_rendered_elsewhere_is_judged_by_its_own_effort_without_the_extra(
    result: HitResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "tables", tuple)
    recording = result.recorded.recording
    rows = recording.rows.copy()
    rows["effort_applied"] *= 0.5
    extra = {**recording.header["extra"], "loop": "device", "arithmetic": "drive"}
    elsewhere = replace(recording, rows=rows, header={**recording.header, "extra": extra})
    found = judge(elsewhere, result.experiment)
    assert found.verdict.peak_effort == pytest.approx(float(np.abs(rows["effort_applied"]).max()))
    assert found.motion is None


def test_a_plan_of_a_wall_that_no_extra_renders_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "tables", tuple)
    changes = {"controller.loop": "device", "controller.arithmetic": "drive"}
    with pytest.raises(ConfigError, match="drive: no installed extra has it"):
        make_plan(override(presets.load("koul-compliant"), changes))
