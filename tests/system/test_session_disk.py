"""A session on the simulated rig resumes after it died at any call by which recorder, sealer or log write to disk."""

from contextlib import suppress
from pathlib import Path

import pytest

from rig.core.errors import ConfigError
from rig.recording.files import sha256_of
from rig.recording.reader import open_recording
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import rehearsal_desk, resume_session, run_session
from rig.session.engine._state import SessionState
from tests.rig.session.session_fuse import DeadError, Fuse, fused
from tests.system.session_study import PROTOCOL, comparable

PERSON = Person(thresholds={"hidden-dual": 65.0, "hidden-uniform": 65.0})


def begin(protocol: Path, study: Path) -> None:
    run_session(protocol, "P01", rehearsal_desk(PERSON), runner=DeviceRunner(), study=study, person=PERSON)


def resume(protocol: Path, study: Path) -> None:
    try:
        resume_session(study / "P01", rehearsal_desk(PERSON), runner=DeviceRunner())
    except ConfigError as error:
        if "has ended" not in str(error):
            begin(protocol, study)


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a protocol of one trial without questions."""
    path = tmp_path_factory.mktemp("protocol") / "one.toml"
    text = PROTOCOL[: PROTOCOL.index("[[question]]")]
    path.write_text(text.replace("[order]", "[stop]\ntrials = 1\n[order]"))
    return path


@pytest.fixture(scope="module")
def calm(protocol: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Run the session without interruption; return its directory and the names of its disk calls."""
    study, fuse = tmp_path_factory.mktemp("calm"), Fuse()
    with pytest.MonkeyPatch.context() as patch:
        begin(protocol, study / "warm")  # what is compiled goes to the disk too
        with fused(patch, fuse):
            begin(protocol, study)
    return study / "P01", fuse.names


def test_a_recording_is_on_disk_under_its_name_before_the_log_names_it(calm: tuple[Path, list[str]]) -> None:
    _, calls = calm
    last = max(number for number, name in enumerate(calls) if name == "write draft of t0001.parquet")
    assert calls[last : last + 7] == [
        "write draft of t0001.parquet",
        "fsync draft of t0001.parquet",
        "replace draft of t0001.parquet",
        "fsync trials",
        "unlink t0001.rigcap",  # only now: until here the rows are in the capture, which is on disk
        "write session.log",
        "fsync session.log",
    ]
    first = calls.index("write draft of t0001.parquet")
    assert calls[first - 2 : first] == ["fsync t0001.rigcap", "fsync trials"]
    assert calls[first - 5 : first - 2] == ["create t0001.rigcap"] + ["write t0001.rigcap"] * 2


@pytest.mark.exhaustive(
    "tests/rig/session/test_session_crashes.py::test_death_at_every_write_flush_and_rename"
)
def test_death_at_every_call_of_recorder_and_sealer(
    protocol: Path, calm: tuple[Path, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory, calls = calm
    # Parquet is written in a hundred pieces, of which three are enough.
    pieces = [number for number, name in enumerate(calls) if name == "write draft of t0001.parquet"]
    first = calls.index("create t0001.rigcap")
    places = set(range(first, len(calls))) - set(pieces)
    for place in sorted(places | {pieces[0], pieces[len(pieces) // 2], pieces[-1]}):
        study, fuse = tmp_path / str(place), Fuse(place)
        study.mkdir()
        with fused(monkeypatch, fuse), suppress(DeadError):
            begin(protocol, study)
        assert fuse.dead, calls[place]
        for trial in SessionState.of(
            read(study / "P01" / LOG)
        ).trials:  # each file that the log names is complete
            assert sha256_of(study / "P01" / trial.recording) == trial.sha256
        left = {sha256_of(path) for path in (study / "P01" / "trials").iterdir()}
        resume(protocol, study)
        events = read(study / "P01" / LOG)
        assert comparable(events) == comparable(read(directory / LOG)), calls[place]
        (trial,) = SessionState.of(events).trials
        assert open_recording(study / "P01" / trial.recording).complete
        kept = {trial.recording: trial.sha256} | {
            one["file"]: one["sha256"]
            for event in events
            if event.kind == "resumed"
            for one in event.content["abandoned"]
        }
        there = (path for path in (study / "P01" / "trials").rglob("*") if path.is_file())
        assert {str(path.relative_to(study / "P01")): sha256_of(path) for path in there} == kept
        assert left <= set(kept.values())  # nothing that was recorded is thrown away
