"""A session that dies at any write, flush or rename, or by a power cut, resumes: nothing is lost or happens twice."""

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from rig.core.errors import ConfigError, RecordingError
from rig.recording.files import make_directories, sha256_of
from rig.session.engine._directory import LOG, PROTOCOL, TRIALS, Session, resume
from rig.session.engine._log import Event, SessionLog, read
from rig.session.engine._rehearsal import Day, Person
from rig.session.engine._state import SessionState
from rig.session.planning._protocol import Protocol
from tests.conformance.tiers import first_by_default
from tests.rig.session.session_fakes import (
    SHORT_SEARCH,
    TEXT,
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


# A power cut. The test's file system stands for the page cache, beside a model of the disk: file contents and directory
# entries as of their last sync. After a power cut each file and directory is as last synced or, since the kernel may
# have written it back on its own, as it is now.

DIRECTORY = Path("sessions", "fakes", "P01")
CHANCES = (0.0, 0.5)  # that the kernel wrote something back unasked

Tree = dict[str, Any]  # names; a file is its bytes


class Disk:
    """A model of what a power cut leaves of a directory, all of which is on the disk at the start."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._files: dict[int, bytes] = {}
        self._names: dict[int, dict[str, int]] = {}
        self._directories: set[int] = set()
        self._kept: list[int] = []  # open, so that no inode becomes another's
        for path in (root, *root.rglob("*")):
            self.sync(path)

    def sync(self, path: Path) -> None:
        """Copy the current content of a file or directory to the modelled disk."""
        inode = self._inode(path)
        if inode in self._directories:
            self._names[inode] = {child.name: self._inode(child) for child in path.iterdir()}
        else:
            self._files[inode] = path.read_bytes()

    def _inode(self, path: Path) -> int:
        self._kept.append(os.open(path, os.O_RDONLY))
        inode = os.fstat(self._kept[-1]).st_ino
        if path.is_dir():
            self._directories.add(inode)
        return inode

    def left(self, drawn: random.Random, chance: float) -> Tree:
        """Return a tree that may remain if the power fails now; `chance` is that of an early write-back."""
        now = {self._inode(path): path for path in (self._root, *self._root.rglob("*"))}

        def files(inode: int) -> bytes:
            kept = self._files.get(inode, b"")
            if inode in now and drawn.random() < chance:
                content = now[inode].read_bytes()
                return content[: drawn.randint(min(len(kept), len(content)), len(content))]
            return kept

        def tree(inode: int) -> Tree:
            names = self._names.get(inode, {})
            if inode in now and drawn.random() < chance:
                names = {child.name: self._inode(child) for child in now[inode].iterdir()}
            return {
                name: tree(one) if one in self._directories else files(one) for name, one in names.items()
            }

        return tree(self._inode(self._root))

    def close(self) -> None:
        for descriptor in self._kept:
            os.close(descriptor)


def write_tree(tree: Tree, place: Path) -> Path:
    place.mkdir(parents=True)
    for name, content in tree.items():
        if isinstance(content, bytes):
            (place / name).write_bytes(content)
        else:
            write_tree(content, place / name)
    return place


@contextmanager
def cut_anywhere(root: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, float, Tree]]]:
    """Yield a list that collects, at each flush and event, acknowledged events, chance and the tree after a cut."""
    disk, drawn, acknowledged = Disk(root), random.Random(1), 0
    found: list[tuple[int, float, Tree]] = []

    def cut() -> None:
        found.extend((acknowledged, chance, disk.left(drawn, chance)) for chance in CHANCES)

    def fsync(descriptor: int) -> None:
        cut()
        disk.sync(Path(os.readlink(f"/proc/self/fd/{descriptor}")))
        cut()

    append = SessionLog.append

    def appended(log: SessionLog, kind: str, **content: Any) -> Event:
        nonlocal acknowledged
        event = append(log, kind, **content)
        acknowledged = event.number + 1
        cut()
        return event

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        patch.setattr(SessionLog, "append", appended)
        try:
            yield found
        finally:
            disk.close()


def check_kept(directory: Path, acknowledged: int) -> None:
    """Check that every acknowledged event is in the log, and that every file named by an event exists."""
    events = read(directory / LOG)
    assert len(events) >= acknowledged
    assert (directory / PROTOCOL).read_bytes() == TEXT
    for event in events:
        if event.kind == "trial":
            assert sha256_of(directory / event.content["recording"]) == event.content["sha256"]
        for one in event.content["abandoned"] if event.kind == "resumed" else ():
            assert sha256_of(directory / one["file"]) == one["sha256"]


def test_directories_are_made_and_not_in_the_place_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (Path("a"), Path("a/b/c"), tmp_path / "a/b/c"):
        make_directories(path)
        assert path.is_dir()
    Path("file").touch()
    for path in (Path("file"), Path("file/below")):
        with pytest.raises(RecordingError, match=f"cannot make {path}"):
            make_directories(path)


def test_a_first_participant_survives_a_power_cut_at_any_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The directories of the study do not exist before this session."""
    root = tmp_path / "cache"
    root.mkdir()
    with cut_anywhere(root, monkeypatch) as cuts:
        finish(started(root / DIRECTORY, protocol_of(search=SHORT_SEARCH)))
    whole = read(root / DIRECTORY / LOG)
    calm = decisions(whole)
    assert sum(event.kind == "trial" for event in whole) == 2
    assert cuts[-1][0] == len(whole)
    # Of cuts that leave the same, the last one has the most events to keep.
    different = {(cut[1], repr(cut[2])): cut for cut in cuts if cut[0] > 0}
    for number, (acknowledged, chance, tree) in enumerate(different.values()):
        directory = write_tree(tree, tmp_path / str(number)) / DIRECTORY
        check_kept(directory, acknowledged)
        if chance == 0.0 and read(directory / LOG)[-1].kind != "ended":
            finish(resume(directory, clock=Day()))
            assert decisions(read(directory / LOG)) == calm


def test_a_recording_without_a_log_entry_survives_a_power_cut_while_it_is_set_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "cache"
    directory = root / DIRECTORY
    finish(started(directory, protocol_of(search=SHORT_SEARCH)))
    lines = (directory / LOG).read_bytes().splitlines(keepends=True)
    last = max(event.number for event in read(directory / LOG) if event.kind == "trial")
    # It died with the recording whole, and no word of it.
    (directory / LOG).write_bytes(b"".join(lines[:last]))
    (loose,) = {path.name for path in (directory / TRIALS).iterdir()} - {
        Path(event.content["recording"]).name for event in read(directory / LOG) if event.kind == "trial"
    }
    content = (directory / TRIALS / loose).read_bytes()
    with cut_anywhere(root, monkeypatch) as cuts:
        resume(directory, clock=Day()).close()
    for number, (acknowledged, chance, tree) in enumerate(cuts):
        if chance:
            continue  # which half of a rename comes first is the file system's; with a journal they come as one
        found = write_tree(tree, tmp_path / str(number)) / DIRECTORY
        check_kept(found, acknowledged)
        assert content in [path.read_bytes() for path in (found / TRIALS).rglob("*") if path.is_file()]
