"""Systems other than Linux: the memory of a running loop as files, the C library by Python functions, the cache."""

import ctypes
import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rig.core.errors import ConfigError, RigError
from rig.realtime import _named_memory as named_memory
from rig.realtime import _stand_ins as stand_ins
from rig.realtime import _user_cache as user_cache
from rig.realtime import memories, ring, running
from rig.realtime.control_words import STOP
from rig.realtime.ring import Ring
from rig.realtime.system import EAGAIN
from tests.conformance.running_loop import loop_process
from tests.conformance.started import WAIT_S


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """Simulate a system whose loop memories are files, in a cache directory of the test."""
    for module in (memories, ring, running):
        monkeypatch.setattr(module, "place", named_memory)
    monkeypatch.setattr(named_memory, "user_cache", lambda: str(tmp_path))
    monkeypatch.setattr(named_memory, "_alive", {})
    yield tmp_path / "haptic-rig" / "loops"
    for lock in named_memory._alive.values():
        lock.close()


def test_other_process_finds_changes_and_stops_a_loop(elsewhere: Path) -> None:
    with loop_process({"url": "serial://COM3"}) as process:
        loop = running.the_loop()
        assert (loop.pid, loop.info["url"], loop.stopping) == (process.pid, "serial://COM3", False)
        with running.open_loop(loop) as block:
            assert [block.post([1.0]), block.post([2.0])] == [1, 2]
        assert [one.ended for one in running.stop(process.pid, patience_s=WAIT_S)] == [True]
        assert running.running() == []
        assert [one.pid for one in running.running(done=True)] == [process.pid]
        process.kill()
        process.join()
        assert running.running(done=True) == []
        assert (elsewhere / str(process.pid)).exists()  # the killed process could not remove it
    with Ring.allocate(10, shared=True) as mine:
        assert sorted(os.listdir(elsewhere)) == sorted([str(os.getpid()), "lock"])
        assert [loop.pid for loop in running.running()] == [os.getpid()]
        assert running.ask_to_stop(os.getpid()) == 1
        assert mine.peek(STOP) == -os.getpid()
    assert os.listdir(elsewhere / str(os.getpid())) == [named_memory.ALIVE]
    with pytest.raises(ConfigError, match="no process"):
        running.stop(process.pid)


def test_foreign_memory_and_a_full_disk_are_refused(
    elsewhere: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "1"
    other.write_bytes(bytes(4096))
    with pytest.raises(RigError, match="not the memory of a running loop"):
        Ring.attach(str(other))

    def full(descriptor: int, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(named_memory.os, "write", full)
    with pytest.raises(RigError, match="No space left"):
        Ring.allocate(10, shared=True)
    assert os.listdir(elsewhere / str(os.getpid())) == [named_memory.ALIVE]


def test_a_start_beside_one_that_hangs_waits_for_it_briefly(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere.mkdir(parents=True)
    now_s = 0.0

    def sleep(duration_s: float) -> None:
        nonlocal now_s
        now_s += duration_s
        assert now_s < 10.0

    with open(elsewhere / "lock", "ab") as held:
        assert named_memory.locks.lock(held.fileno())
        monkeypatch.setattr(named_memory, "time", SimpleNamespace(monotonic=lambda: now_s, sleep=sleep))
        Ring.allocate(10, shared=True).close()
    assert now_s > 1.0


HOME = os.path.expanduser("~")


@pytest.mark.parametrize(
    ("platform", "environment", "place"),
    [
        ("win32", {"LOCALAPPDATA": "/data/local"}, "/data/local"),
        ("win32", {}, f"{HOME}/AppData/Local"),
        ("darwin", {"LOCALAPPDATA": "/data/local", "XDG_CACHE_HOME": "/cache"}, f"{HOME}/Library/Caches"),
        ("linux", {"XDG_CACHE_HOME": "/cache"}, "/cache"),
        ("linux", {}, f"{HOME}/.cache"),
    ],
)
def test_each_system_has_its_place(
    platform: str, environment: dict[str, str], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LOCALAPPDATA", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(user_cache, "sys", SimpleNamespace(platform=platform))
    assert user_cache.user_cache() == place


BILLION = 1_000_000_000


def last_error() -> int:
    return ctypes.c_int32.from_address(stand_ins._errno_location()).value


def test_written_bytes_arrive_and_a_failure_sets_errno(tmp_path: Path) -> None:
    data = np.frombuffer(b"one\ntwo\r\n", np.uint8).copy()
    with open(tmp_path / "file", "wb") as file:
        assert stand_ins._write(file.fileno(), data.ctypes.data, len(data)) == len(data)
        assert stand_ins._sync(file.fileno()) == 0
        closed = file.fileno()
    assert (tmp_path / "file").read_bytes() == data.tobytes()
    assert stand_ins._write(-1, data.ctypes.data, 1) == -1
    assert last_error() == errno.EBADF
    assert stand_ins._sync(closed) == -1
    with open("/dev/full", "wb") as full:
        assert stand_ins._write(full.fileno(), data.ctypes.data, 1) == -1
    assert last_error() == errno.ENOSPC


def test_full_line_reports_the_errno_of_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise BlockingIOError(errno.EAGAIN, "full")

    with monkeypatch.context() as patched:
        patched.setattr(errno, "EAGAIN", 35)  # of macOS
        patched.setattr(os, "write", full)
        assert stand_ins._write(1, 0, 0) == -1
    assert last_error() == EAGAIN == 11


def test_time_is_that_of_the_links_clock_and_a_sleep_ends_at_its_deadline() -> None:
    timespec = np.zeros(2, np.int64)
    before = time.perf_counter_ns()
    assert stand_ins._now(1, timespec.ctypes.data) == 0
    now = int(timespec[0] * BILLION + timespec[1])
    assert before <= now <= time.perf_counter_ns()
    timespec[:] = divmod(now + 3_000_000, BILLION)
    assert stand_ins._sleep(1, 1, timespec.ctypes.data, 0) == 0
    assert time.perf_counter_ns() >= now + 3_000_000


def test_every_name_of_the_compiled_loop_has_one() -> None:
    from rig.realtime import system  # noqa: PLC0415

    assert set(system._NAMES) == set(stand_ins._CALLS)
