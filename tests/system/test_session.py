"""Whole sessions on the simulated rig, in virtual time: repeatable from the seed, and identical after any kill -9."""

import json
import os
import random
import signal
import sys
import time
import traceback
from pathlib import Path

import pytest

from rig.extras.study import AnalysisOptions, analyse
from rig.extras.study.report import render
from rig.extras.study.tables import tables
from rig.recording.files import sha256_of
from rig.recording.reader import open_recording
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import rehearsal_desk, resume_session, run_session
from rig.session.engine._state import SessionState
from rig.session.planning._template_files import DEFAULT, write_template
from tests.system.session_study import comparable, written

PERSON = Person(thresholds={"hidden-dual": 65.0, "hidden-uniform": 65.0}, lapse_rate=0.05)


def rehearse(protocol: Path, study: Path, code: str = "P01", person: Person = PERSON) -> Path:
    run_session(protocol, code, rehearsal_desk(person), runner=DeviceRunner(), study=study, person=person)
    return study / code


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    place = tmp_path_factory.mktemp("calm")
    protocol = written(place)
    return protocol, rehearse(protocol, place / "study")


@pytest.mark.exhaustive("::test_recordings_of_a_session_are_hashed_and_have_blind_names")
def test_equal_seeds_give_equal_sessions(calm: tuple[Path, Path], tmp_path: Path) -> None:
    protocol, directory = calm
    again = rehearse(protocol, tmp_path)
    assert comparable(read(again / LOG)) == comparable(read(directory / LOG))


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
def test_the_first_session_of_a_newcomer_ends_in_ten_minutes_with_intervals_that_show_the_effect(
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


def check_files(directory: Path) -> None:
    """Check that the log names every file of a trial with its hash, and that no other file exists."""
    events = read(directory / LOG)
    aside = {
        one["file"]: one["sha256"]
        for event in events
        if event.kind == "resumed"
        for one in event.content["abandoned"]
    }
    named = {trial.recording: trial.sha256 for trial in SessionState.of(events).trials}
    there = (path for path in (directory / "trials").rglob("*") if path.is_file())
    assert {str(path.relative_to(directory)): sha256_of(path) for path in there} == named | aside


def results(directory: Path) -> dict[str, list[list[str]]]:
    """Return all tables of an analysis; time is virtual, so a resumed session also has the same times of day."""
    found = analyse([directory], AnalysisOptions(include_marked=True))
    return {
        table.name: [[str(column.of(row)) for column in table.columns] for row in table.rows]
        for table in tables(found)
    }


def _kill_repeatedly(protocol: Path, study: Path, most: int, seed: int) -> None:
    """Kill and resume a session at random times; each attempt is a fork of this process, which has no threads."""
    drawn, kills = random.Random(seed), 0
    # What the session needs is loaded and compiled before the first fork, by a session of one trial.
    short = study / "warm.toml"
    short.write_text(protocol.read_text().replace("[order]", "[stop]\ntrials = 1\n[order]"))
    rehearse(short, study / "warm")
    while True:
        child = os.fork()
        if child == 0:
            _child(protocol, study)
        if kills < most:
            kills += _kill(child, study / "P01" / LOG, drawn.randrange(1, 5), drawn.uniform(0.0, 0.03))
        _, status = os.waitpid(child, 0)
        if os.WIFEXITED(status):
            break
    print(json.dumps({"kills": kills, "status": os.WEXITSTATUS(status)}))
    sys.exit(os.WEXITSTATUS(status))


def _child(protocol: Path, study: Path) -> None:
    code = 1
    try:
        log = study / "P01" / LOG
        events = read(log) if log.exists() else []
        if events and SessionState.of(events).ended:
            code = 0  # it was killed behind its last word
        elif events:
            resume_session(study / "P01", rehearsal_desk(PERSON), runner=DeviceRunner())
            code = 0
        else:
            rehearse(protocol, study)
            code = 0
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(code)


def _kill(child: int, log: Path, lines: int, after_s: float) -> int:
    """Kill a child `after_s` after it has logged so many lines; return 1 if killed, 0 if it ended before."""
    before = _lines(log)
    at = None
    while os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        if at is None and _lines(log) >= before + lines:
            at = time.monotonic() + after_s
        if at is not None and time.monotonic() >= at:
            os.kill(child, signal.SIGKILL)
            return 1
        time.sleep(0.001)
    return 0


def _lines(log: Path) -> int:
    return log.read_bytes().count(b"\n") if log.exists() else 0


if __name__ == "__main__":
    _kill_repeatedly(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
