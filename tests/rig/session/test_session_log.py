"""The session log: events survive a death of the process at any point, and none can be removed unnoticed."""

import errno
import io
import json
import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.errors import RecordingError
from rig.recording import files, lines
from rig.session.engine import _log as log_module
from rig.session.engine._log import (
    VERSION,
    DamagedLineError,
    SessionLog,
    read,
    set_aside,
    set_damaged_line_aside,
)

EVENTS = [
    ("trial", {"k": 40.0}),
    ("verdict", {"stable": True, "note": "ä \n"}),
    ("pause", {}),
    ("end", {"x": [1, None]}),
]


def write_log(path: Any, events: Any = EVENTS) -> Any:
    with SessionLog(path, clock=lambda: 12.5) as log:
        for kind, content in events:
            log.append(kind, **content)
    return path


def read_events(path: Any) -> Any:
    return [(event.kind, dict(event.content)) for event in read(path)]


def test_events_are_read_back_in_order_and_with_their_time(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    assert read_events(path) == EVENTS
    assert [event.number for event in read(path)] == [0, 1, 2, 3]
    assert {event.at for event in read(path)} == {12.5}


def test_a_log_torn_at_any_byte_is_continued_without_a_trace_and_counts_it(tmp_path: Path) -> None:
    """However much of the last line reached the disk, the event is there completely or not at all."""
    whole = write_log(tmp_path / "whole").read_bytes()
    start = whole.rindex(b"\n", 0, -1) + 1
    for length in range(start, len(whole) + 1):
        path = tmp_path / "torn"
        path.write_bytes(whole[:length])
        survived = read_events(path)
        assert survived == (EVENTS if length == len(whole) else EVENTS[:-1])
        for torn in (0 if length == len(whole) else length - start, 0):
            with SessionLog(path) as log:
                assert log.torn == torn
        write_log(path, EVENTS[len(survived) :])
        assert path.read_bytes() == whole


def test_a_damaged_last_line_can_be_set_aside_and_its_bytes_stay(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    whole = path.read_bytes()
    start = whole.rindex(b"\n", 0, -1) + 1
    damaged = whole[start : start + 20] + b"?" + whole[start + 21 :]
    path.write_bytes(whole[:start] + damaged)
    with pytest.raises(DamagedLineError, match="line 4, the last one: damaged") as caught:
        read(path)
    assert [(event.kind, dict(event.content)) for event in caught.value.events] == EVENTS[:-1]
    kept = set_damaged_line_aside(path)
    assert kept.read_bytes() == damaged
    assert read_events(path) == EVENTS[:-1]
    assert set_damaged_line_aside(path) is None
    path.write_bytes(path.read_bytes() + b"00000000 {}\n")  # another time, another file
    assert set_damaged_line_aside(path) != kept
    assert len(set_aside(path)) == 2
    assert kept.read_bytes() == damaged


def test_a_damaged_line_that_something_followed_is_not_set_aside(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    changed = path.read_bytes().replace(b"stable", b"stabel")
    path.write_bytes(changed)
    with pytest.raises(DamagedLineError, match="line 2: damaged") as caught:
        set_damaged_line_aside(path)
    assert "later lines depend on" in caught.value.remedy
    assert (path.read_bytes(), set_aside(path)) == (changed, [])


def test_line_ends_that_an_editor_or_git_changed_are_named_and_changed_back(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"\n", b"\r\n"))
    for opened in (read, SessionLog, set_damaged_line_aside):
        with pytest.raises(RecordingError, match="CR LF instead of LF") as caught:
            opened(path)
    remedy = re.search(r"sed .*(?= ; transfer)", caught.value.remedy)
    assert remedy is not None
    subprocess.run(remedy[0], shell=True, check=True)
    assert path.read_bytes() == whole


@pytest.mark.parametrize("place", range(4))
def test_a_line_taken_out_or_changed_is_noticed(tmp_path: Path, place: int) -> None:
    path = write_log(tmp_path / "log")
    kept = path.read_bytes().splitlines(keepends=True)
    forged = lines.line_of(f'{{"n": {place}, "after": 0, "at": 1, "kind": "forged", "log": {VERSION}}}')
    taken_out, replaced = [*kept[:place], *kept[place + 1 :]], [*kept[:place], forged, *kept[place + 1 :]]
    if place == 3:  # the last line gone is a session that ended earlier: no chain can tell
        path.write_bytes(b"".join(taken_out))
        assert read_events(path) == EVENTS[:3]
    else:
        _assert_refused(path, taken_out, place + 1)
    # A first line with a good CRC may be anything: the second one shows that it is another.
    _assert_refused(path, replaced, max(place + 1, 2))


def test_a_log_of_another_format_version_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log")
    first = lines.object_of(path.read_bytes().splitlines(keepends=True)[0])
    assert first["log"] == VERSION
    path.write_bytes(lines.line_of(json.dumps({**first, "log": VERSION + 1})))
    for reader in (SessionLog, read):
        with pytest.raises(RecordingError, match=f"format version {VERSION + 1}.*reads version {VERSION}"):
            reader(path)


def _assert_refused(path: Any, changed: Any, number: Any) -> None:
    path.write_bytes(b"".join(changed))
    for reader in (SessionLog, read):
        with pytest.raises(RecordingError, match=f"line {number}") as refused:
            reader(path)
        assert "restore" in refused.value.remedy
    assert path.read_bytes() == b"".join(changed)  # nothing is overwritten


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_one_flipped_bit_is_never_taken_for_an_event(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = write_log(tmp_path_factory.mktemp("bit") / "log")
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    try:
        found = read_events(path)
    except RecordingError:
        return
    assert found == EVENTS[: len(found)]  # only what was the newline of the last line can go unseen
    assert len(found) >= 3


def test_two_processes_never_write_the_same_session(tmp_path: Path) -> None:
    with SessionLog(tmp_path / "log") as log:
        log.append("begun")
        with pytest.raises(RecordingError, match="another process") as refused:
            SessionLog(tmp_path / "log")
        assert refused.value.remedy
        assert read_events(tmp_path / "log") == [("begun", {})]  # reading is free
    SessionLog(tmp_path / "log").close()


class Failing(io.FileIO):
    fails: set[str]

    def write(self, data: Any) -> Any:
        if "write" not in self.fails:
            return super().write(data)
        super().write(data[: len(data) // 2])
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def truncate(self, size: Any = None) -> Any:
        if "truncate" in self.fails:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return super().truncate(size)


@pytest.mark.parametrize("other", ["truncate", "nothing"])
@pytest.mark.parametrize("first", ["write", "sync"])
def test_after_an_append_that_failed_nothing_comes_upon_what_it_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: str, other: str
) -> None:
    """If a partial line cannot be cut off, it stays the last one until the log is opened again."""
    path, fsync = write_log(tmp_path / "log"), os.fsync

    def sync(descriptor: Any) -> None:
        if "sync" in file.fails:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        fsync(descriptor)

    file = type("File", (Failing,), {"fails": set()})
    monkeypatch.setattr(lines, "FileIO", file)
    monkeypatch.setattr(lines.os, "fsync", sync)
    with SessionLog(path, clock=lambda: 12.5) as log:
        file.fails.update({first, other})
        with pytest.raises(RecordingError, match="Input/output error"):
            log.append("lost", text="x" * 40)
        file.fails.clear()
        if other == "truncate":
            with pytest.raises(RecordingError, match="failed") as refused:
                log.append("stopped")
            assert "resume" in refused.value.remedy
        else:
            log.append("stopped")
    before = read_events(path)
    assert before[:4] == EVENTS
    assert [kind for kind, _ in before[4:]] == (
        ["stopped"] if other == "nothing" else ["lost"] if first == "sync" else []
    )
    assert read_events(write_log(path, [("resumed", {})])) == [*before, ("resumed", {})]


@pytest.mark.parametrize("place", range(60))
def test_interrupted_anywhere_in_an_append_the_log_stays_one(tmp_path: Path, place: int) -> None:
    """Ctrl-C may come between any two program lines; the stop event that follows must not damage the log."""
    path, left = write_log(tmp_path / "log"), place
    traced = [module.__file__ for module in (log_module, lines, files)]
    with SessionLog(path, clock=lambda: 12.5) as log:

        def trace(frame: Any, event: Any, argument: Any) -> Any:
            nonlocal left
            if event == "line":
                if left == 0:
                    left = -1
                    raise KeyboardInterrupt
                left -= 1
            return trace

        def tracing(frame: Any, event: Any, argument: Any) -> Any:
            return trace if frame.f_code.co_filename in traced else None

        before = sys.gettrace()
        sys.settrace(tracing)
        try:
            log.append("asked", text="x" * 40)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(before)
        with suppress(RecordingError):
            log.append("stopped")
    found = read_events(path)
    assert found[:4] == EVENTS
    assert [kind for kind, _ in found[4:]] in (["asked"], ["stopped"], ["asked", "stopped"], [])
    assert read_events(write_log(path, [("resumed", {})])) == [*found, ("resumed", {})]
    if left >= 0:
        assert [kind for kind, _ in found[4:]] == [
            "asked",
            "stopped",
        ]  # there was nothing to interrupt any more


@pytest.mark.parametrize(
    ("value", "kept"), [(float("nan"), None), ((1.0, {"x": float("inf")}), [1.0, {"x": None}])]
)
def test_a_number_that_json_lacks_is_null_in_the_file_and_in_the_event(
    tmp_path: Path, value: Any, kept: Any
) -> None:
    with SessionLog(tmp_path / "log") as log:
        assert log.append("trial", felt=value).content == {"felt": kept}
    assert json.loads((tmp_path / "log").read_text()[9:], parse_constant=pytest.fail)["felt"] == kept
