"""A session that dies at any write, flush or rename resumes completely: nothing is lost, nothing happens twice."""

from contextlib import suppress
from pathlib import Path

import pytest

from rig.core.errors import ConfigError, RecordingError
from rig.recording.files import sha256_of
from rig.session.engine._directory import LOG, Session, resume
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Day, Person
from rig.session.engine._state import SessionState
from rig.session.planning._protocol import Protocol
from tests.conformance.tiers import first_by_default
from tests.rig.session.session_fakes import (
    SHORT_SEARCH,
    FakeRunner,
    decisions,
    protocol_of,
    rehearsed,
    started,
)
from tests.rig.session.session_fuse import DeadError, FullDisk, Fuse, fused

PERSON = Person(thresholds={"dual-hidden": 330.0, "uniform-hidden": 330.0}, lapse_rate=0.1)


def short_protocol() -> Protocol:
    """Return a protocol with every kind of write in few events: two runs of one trial, a question, a rest."""
    return protocol_of(
        search=SHORT_SEARCH,
        rest={"every": 1, "seconds": 5.0},
        question=[{"name": "tired", "text": "How tired?", "when": "block"}],
    )


def finish(session: Session) -> SessionState:
    return rehearsed(session, FakeRunner(), PERSON)


def continue_session(directory: Path) -> SessionState:
    """Resume a session after a crash, or start it again if nothing can be resumed."""
    try:
        session = resume(directory, clock=Day())
    except ConfigError as error:
        if "has ended" in str(error):
            return SessionState.of(read(directory / LOG))
        session = started(directory, short_protocol())
    return finish(session)


def check_equal(directory: Path, undisturbed: Path) -> None:
    """Check that decisions and results equal an uninterrupted session's, and each recording exists once, unchanged."""
    events = read(directory / LOG)
    assert decisions(events) == decisions(read(undisturbed / LOG))
    state = SessionState.of(events)
    assert state.ended == "complete"
    for trial in state.trials:
        assert sha256_of(directory / trial.recording) == trial.sha256
    named = {trial.recording for trial in state.trials}
    aside = {
        one["file"]: one["sha256"]
        for event in events
        if event.kind == "resumed"
        for one in event.content["abandoned"]
    }
    there = {str(path.relative_to(directory)) for path in (directory / "trials").rglob("*") if path.is_file()}
    assert there == named | set(aside)
    for name, digest in aside.items():
        assert sha256_of(directory / name) == digest


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("calm") / "P01"
    finish(started(directory, short_protocol()))
    return directory


@pytest.mark.parametrize("after", first_by_default([False, True]))
def test_death_at_every_write_flush_and_rename(
    tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch, after: bool
) -> None:
    whole = Fuse()
    with fused(monkeypatch, whole):
        finish(started(tmp_path / "counted" / "P01", short_protocol()))
    assert whole.calls > 35
    for place in range(whole.calls):
        directory = tmp_path / str(place) / "P01"
        fuse = Fuse(place, after=after)
        with fused(monkeypatch, fuse), suppress(DeadError):
            finish(started(directory, short_protocol()))
        assert fuse.dead
        continue_session(directory)
        check_equal(directory, undisturbed)


def test_a_disk_that_is_full_at_any_write_ends_the_session_in_order(
    tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The session reports the full disk, ends, and can be resumed once there is space again."""
    whole = Fuse()
    with fused(monkeypatch, whole):
        finish(started(tmp_path / "counted" / "P01", short_protocol()))
    for place in range(0, whole.calls - 1, 3):  # the very last call is a flush
        directory = tmp_path / str(place) / "P01"
        with fused(monkeypatch, FullDisk(place)), pytest.raises(RecordingError, match="No space left"):
            finish(started(directory, short_protocol()))
        continue_session(directory)
        check_equal(directory, undisturbed)


def test_death_in_the_middle_of_coming_back(
    tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On resuming, recordings are moved aside, listed and logged; the process may die after any of these steps."""
    for place in range(12):
        directory = tmp_path / str(place) / "P01"
        with fused(monkeypatch, Fuse(28)), suppress(DeadError):  # at the write of the second recording
            finish(started(directory, short_protocol()))
        with fused(monkeypatch, Fuse(place)), suppress(DeadError):
            continue_session(directory)
        continue_session(directory)
        check_equal(directory, undisturbed)
