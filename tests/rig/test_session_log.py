"""The session log: what was said stays said, wherever the process dies, and nothing can be taken out unseen."""

from __future__ import annotations

import errno
import io
import multiprocessing
import os
import signal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import RecordingError
from rig.recording import lines
from rig.session.log import SessionLog, read

SAID = [
    ("trial", {"k": 40.0}),
    ("verdict", {"stable": True, "note": "ä \n"}),
    ("pause", {}),
    ("end", {"x": [1, None]}),
]


def written(path, said=SAID):
    with SessionLog(path, clock=lambda: 12.5) as log:
        for kind, content in said:
            log.append(kind, **content)
    return path


def told(path):
    return [(event.kind, dict(event.content)) for event in read(path)]


def test_what_was_said_is_read_back_in_order_and_with_its_time(tmp_path):
    path = written(tmp_path / "log")
    assert told(path) == SAID
    assert [event.number for event in read(path)] == [0, 1, 2, 3]
    assert {event.at for event in read(path)} == {12.5}


def test_torn_at_every_byte_it_goes_on_as_if_nothing_had_happened(tmp_path):
    """Whatever part of the last line reached the disk: it is there as a whole, or it never was; the end is the same."""
    whole = written(tmp_path / "whole").read_bytes()
    start = whole.rindex(b"\n", 0, -1) + 1
    for length in range(start, len(whole) + 1):
        path = tmp_path / "torn"
        path.write_bytes(whole[:length])
        survived = told(path)
        assert survived == (SAID if length == len(whole) else SAID[:-1])
        written(path, SAID[len(survived) :])
        assert path.read_bytes() == whole


@pytest.mark.parametrize("place", range(4))
def test_a_line_taken_out_or_changed_is_noticed(tmp_path, place):
    path = written(tmp_path / "log")
    kept = path.read_bytes().splitlines(keepends=True)
    forged = lines.line_of(f'{{"n": {place}, "after": 0, "at": 1, "kind": "forged"}}')
    taken_out, replaced = [*kept[:place], *kept[place + 1 :]], [*kept[:place], forged, *kept[place + 1 :]]
    if place == 3:  # the last line gone is a session that ended earlier: no chain can tell
        path.write_bytes(b"".join(taken_out))
        assert told(path) == SAID[:3]
    else:
        _assert_refused(path, taken_out, place + 1)
    # A first line with a good CRC may be anything: the second one tells that it is another.
    _assert_refused(path, replaced, max(place + 1, 2))


def _assert_refused(path, changed, number):
    path.write_bytes(b"".join(changed))
    for reader in (SessionLog, read):
        with pytest.raises(RecordingError, match=f"line {number}") as refused:
            reader(path)
        assert "restore" in refused.value.remedy
    assert path.read_bytes() == b"".join(changed)  # nothing is overwritten


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_one_flipped_bit_is_never_taken_for_an_event(tmp_path_factory, data):
    path = written(tmp_path_factory.mktemp("bit") / "log")
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    try:
        found = told(path)
    except RecordingError:
        return
    assert found == SAID[: len(found)]  # only what was the newline of the last line can go unseen
    assert len(found) >= 3


def test_two_processes_never_write_the_same_session(tmp_path):
    with SessionLog(tmp_path / "log") as log:
        log.append("begun")
        with pytest.raises(RecordingError, match="another process") as refused:
            SessionLog(tmp_path / "log")
        assert refused.value.remedy
        assert told(tmp_path / "log") == [("begun", {})]  # reading is free
    SessionLog(tmp_path / "log").close()


@pytest.mark.parametrize("room", range(0, 240, 7))
def test_on_a_full_disk_it_says_so_and_what_was_said_before_is_good(tmp_path, monkeypatch, room):
    class Full(io.FileIO):
        left = room

        def write(self, data):
            if self.left <= 0:
                raise OSError(errno.ENOSPC, "")
            written = super().write(data[: min(len(data), self.left, 50)])
            self.left -= written
            return written

    path, done = tmp_path / "log", 0
    monkeypatch.setattr(lines, "FileIO", Full)
    with SessionLog(path, clock=lambda: 12.5) as log:
        for kind, content in SAID * 4:
            try:
                log.append(kind, **content)
            except RecordingError as error:
                assert "No space left" in str(error)  # noqa: PT017
                break
            done += 1
        assert done < 16
        log._file._file.left = 1000  # somebody frees some space
        for kind, content in (SAID * 4)[done : done + 1]:
            log.append(kind, **content)
            done += 1
    monkeypatch.undo()
    assert told(path) == (SAID * 4)[:done]
    assert told(written(path, (SAID * 4)[done:])) == SAID * 4


def _append_for_ever(path):
    with SessionLog(path) as log:
        while True:
            log.append("tick", number=len(log.events))


def test_kill_minus_nine_at_any_moment_leaves_a_log_that_goes_on(tmp_path):
    path = tmp_path / "log"
    for _ in range(5):
        before = len(read(path)) if path.exists() else 0
        child = multiprocessing.get_context("fork").Process(target=_append_for_ever, args=(path,))
        child.start()
        while not path.exists() or len(_whole(path)) < before + 20:
            assert child.is_alive()
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        assert [event.content["number"] for event in read(path)] == list(range(len(read(path))))


def _whole(path):
    return [line for line in path.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]


def test_an_event_is_on_the_disk_before_append_returns(tmp_path, monkeypatch):
    order = []
    fsync = os.fsync
    monkeypatch.setattr(lines.os, "fsync", lambda descriptor: (order.append("synced"), fsync(descriptor)))
    with SessionLog(tmp_path / "log") as log:
        order.clear()
        log.append("verdict")
        order.append("returned")
    assert order[:2] == ["synced", "returned"]


def test_the_logs_own_words_are_not_the_callers(tmp_path):
    with SessionLog(tmp_path / "log") as log, pytest.raises(ValueError, match="after"):
        log.append("x", after=1)


def test_no_log_is_said_plainly(tmp_path):
    with pytest.raises(RecordingError, match="no session log"):
        read(tmp_path / "none")
