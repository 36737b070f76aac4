"""What a violent wall may do to a participant: the caps of a protocol end the hit, and only then is anybody asked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.experiments import trial as one_trial
from rig.recording.data import Recording
from rig.recording.reader import open_recording
from rig.session.desk import Desk, Question, Reply
from rig.session.hits import DeviceRunner
from rig.session.log import read
from rig.session.protocol import Protocol
from rig.session.rehearsal import Day, Person, RehearsalDesk
from rig.session.run import run_session
from rig.session.runner import TrialRunner

PERSON = Person(thresholds={})
STRONG, OSCILLATES = (
    1.2,
    0,
)  # N·m, more than any of these caps but one; oscillations that the rig allows: 0 for any number

PROTOCOL = """
[study]
title = "caps"
preset = "koul-compliant"
seed = 11
[study.changes]
"controller.position_rate" = 4000
"controller.velocity_rate" = 4000
"operator.press" = 2.0
"operator.begin_s" = 0.02
"operator.reach_s" = {reach_s}
"homing.settle_s" = 0.02
"homing.speed" = 0.3
"verdict.tail_s" = 0.1
"verdict.lowpass_hz" = 400.0
"trial.minimum_rest_counts" = 0.0
"trial.release_s" = 0.02
"rig.limits.override_stall" = true
"rig.limits.effort" = 1.2
{oscillations}
[trial]
duration_s = 0.5
[caps]
{cap}
[stop]
aborts = 2
[search]
rule = "grid"
lowest = 1200
highest = 1400
step = 100
settings = {{ repeats = 1 }}
[order]
kind = "fixed"
[[condition]]
name = "one"
damping = [0.5]
"""


class Asked(RehearsalDesk):
    """Remembers what recordings there were when it was asked for a verdict."""

    def __init__(self, directory: Path) -> None:
        super().__init__(PERSON, Day())
        self.directory = directory
        self.found: list[Recording] = []

    def ask(self, question: Question) -> Reply:
        if question.kind == "verdict":
            self.found.append(open_recording(self.directory / f"t{question.trial:04d}.parquet"))
        return super().ask(question)


@pytest.mark.parametrize(
    ("cap", "oscillations", "aborted"),
    [
        ("effort = 0.5", None, "violent"),
        ("energy = 0.004", OSCILLATES, "energy"),
        ("speed = 0.7", OSCILLATES, "out_of_window"),
    ],
)
def test_a_cap_ends_a_violent_hit_before_anybody_is_asked_and_then_the_session(
    cap: str, oscillations: int | None, aborted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, study = tmp_path / "caps.toml", tmp_path / "study"
    path.write_text(
        PROTOCOL.format(
            cap=cap,
            # Slowly enough that the hand by itself stays well below the speed.
            reach_s=0.3 if aborted == "out_of_window" else 0.1,
            oscillations="" if oscillations is None else f'"rig.limits.oscillations" = {oscillations}',
        )
    )
    currents: list[int] = []
    conclude = one_trial._conclude

    def witness(device: Any, *rest: Any) -> Any:
        currents.append(device.link.device.current)
        return conclude(device, *rest)

    monkeypatch.setattr(one_trial, "_conclude", witness)
    desk = Asked(study / "P01" / "trials")

    def at_desk(protocol: Protocol, experiment: Mapping[str, Any], runner: TrialRunner) -> Desk:
        return desk

    result = run_session(path, "P01", at_desk, runner=DeviceRunner(), study=study, person=PERSON)
    assert result.ended == "2 hits in a row cut off for safety"
    assert (result.trials, result.counted, result.aborted) == (2, 2, 2)
    assert currents == [0, 0]  # the device's own, once the loop had returned
    trials = [event.content for event in read(study / "P01" / "session.log") if event.kind == "trial"]
    assert [(one["aborted"], one["ended"], one["automatic"]) for one in trials] == [
        (aborted, aborted, "unstable")
    ] * 2
    for recording in desk.found:
        rows, watched = recording.rows, (recording.trailer or {})["watched"]
        assert recording.complete
        assert rows["effort_sent"][-1] == 0.0
        efforts, limit = np.abs(rows["effort_sent"]), 0.5 if aborted == "violent" else STRONG
        assert 0.6 * limit < efforts.max() <= limit
        if aborted == "energy":
            assert 0.004 < watched["energy"] < 0.006
        elif aborted == "out_of_window":
            assert np.abs(rows["velocity"][:-1]).max() <= 0.7 < abs(rows["velocity"][-1])
    assert len(desk.found) == 2
