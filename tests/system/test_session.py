"""Whole sessions on the simulated rig, in virtual time: repeatable, from every template, without kept memory."""

import gc
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rig.config.presets import load as preset
from rig.extras.study import AnalysisOptions, analyse
from rig.extras.study.report import render
from rig.recording.files import sha256_of
from rig.recording.reader import open_recording
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import rehearsal_desk, run_session
from rig.session.engine._state import SessionState
from rig.session.planning._load import load_protocol
from rig.session.planning._template_files import DEFAULT, template_names, write_template
from tests.conformance.firmware import need_compiler
from tests.conformance.tiers import first_by_default
from tests.system.session_study import written

PERSON = Person(thresholds={"hidden-dual": 65.0, "hidden-uniform": 65.0}, lapse_rate=0.05)


def rehearse(protocol: Path, study: Path, code: str = "P01", person: Person = PERSON) -> Path:
    run_session(protocol, code, rehearsal_desk(person), runner=DeviceRunner(), study=study, person=person)
    return study / code


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    place = tmp_path_factory.mktemp("calm")
    protocol = written(place)
    return protocol, rehearse(protocol, place / "study")


def test_recordings_of_a_session_are_hashed_and_have_blind_names(calm: tuple[Path, Path]) -> None:
    _, directory = calm
    state = SessionState.of(read(directory / LOG))
    assert state.ended == "complete"
    assert len(state.trials) == 12
    for trial in state.trials:
        path = directory / trial.recording
        assert path.name == f"t{trial.trial:04d}.parquet"
        assert sha256_of(path) == trial.sha256
        recording = open_recording(path)
        assert recording.experiment["wall"]["stiffness"] == trial.stiffness
        assert recording.experiment["trial"]["kind"] == "human"
        assert recording.trailer is not None
        assert recording.trailer["reason"] == "finished"
        assert trial.automatic != "invalid"
        assert 0.0 < trial.heat < 1.0


@pytest.mark.exhaustive("::test_the_analysis_finds_the_threshold_of_the_simulated_person")
def test_a_newcomers_session_takes_ten_minutes_and_its_intervals_show_the_effect(
    tmp_path: Path,
) -> None:
    """Uses the unchanged template and the program's own verdict: dual-rate is above the uniform slow rate."""
    write_template(DEFAULT, tmp_path / "study.toml")
    events = read(rehearse(tmp_path / "study.toml", tmp_path, person=Person(thresholds={})) / LOG)
    assert events[-1].content["reason"] == "complete"
    assert events[-1].at - events[0].at <= 600.0  # in the simulation's time
    found = analyse([tmp_path])
    assert not any("imprecise" in message for message in found.messages)
    slow, dual = (one for one in found.of_participants if one.measure == "rule")
    if slow.condition.startswith("dual"):
        slow, dual = dual, slow
    for one in (slow, dual):
        assert not one.beyond.count
        assert 0.0 < one.low < one.mean < one.high < 1.5 * one.low
    assert slow.high < dual.low
    page = render(found, {})
    assert f"{slow.low:.4g}" in page


def test_the_analysis_finds_the_threshold_of_the_simulated_person(calm: tuple[Path, Path]) -> None:
    """Each estimate rests on twelve answers, one of them a lapse, over a range of 100 in stiffness."""
    found = analyse([calm[1]], AnalysisOptions(include_marked=True))  # `most` is small: a run ends by it
    estimates = [one for one in found.of_participants if one.measure == "K50 person"]
    assert {one.condition for one in estimates} == {"hidden-dual", "hidden-uniform"}
    for one in estimates:
        assert one.low <= 65.0 <= one.high
        assert one.high - one.low < 90.0


def test_a_trial_leaves_no_memory_to_the_collector(tmp_path: Path) -> None:
    """A session has hundreds of trials, and garbage collection is irregular: no array may be part of a cycle."""
    need_compiler()
    x = preset("koul-rigid")
    x = replace(x, trial=replace(x.trial, kind="human", duration_s=1.0))
    (tmp_path / "trials").mkdir()
    runner = DeviceRunner()
    runner.hit(x, {}, tmp_path / "trials", "t0001", lambda _: None, 0.0)  # what is made once
    gc.collect()
    gc.disable()
    try:
        runner.hit(x, {}, tmp_path / "trials", "t0002", lambda _: None, 0.0)
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        ours = {
            type(one).__name__
            for one in gc.garbage
            if type(one).__module__.startswith(("rig.", "sim_backend."))
        }
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()
    assert not ours


TRIALS = 3


@pytest.mark.exhaustive("tests/rig/session/test_session_check.py::test_every_template_passes_on_its_preset")
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", first_by_default(sorted(template_names(), reverse=True)))
def test_a_template_is_rehearsed_and_reported(name: str, tmp_path: Path, run: Any) -> None:
    path, study = tmp_path / "study.toml", tmp_path / "study"
    assert run("session", "new", path, "--template", name)[0] == 0
    code, planned, err = run("session", "check", path)
    assert code == 0, err
    conditions = load_protocol(path).condition
    for condition in conditions:
        assert f"{condition.name}: fit {condition.fit}" in planned or not condition.fit
    text = path.read_text().replace("[stop]\n", f"[stop]\ntrials = {TRIALS}\n")
    path.write_text(re.sub(r"\[practice\]\nstiffness = \[.*?\]", "[practice]\nstiffness = []", text))
    code, out, err = run("session", "run", path, "P01", "--rehearse", "--study", study, "--json")
    assert code == 0, err
    result = json.loads(out)
    assert (result["ended"], result["counted"], result["invalid"]) == (f"{TRIALS} trials", TRIALS, 0)
    assert run("session", "analyse", study, "--output", tmp_path / "out")[0] == 0
    report = (tmp_path / "out" / "report.html").read_text()
    assert all(condition.name in report and condition.fit in report for condition in conditions)
