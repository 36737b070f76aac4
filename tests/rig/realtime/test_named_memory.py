"""The memory of a running loop on systems other than Linux, as files: found, stopped, written by others, removed."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.core.errors import ConfigError, RigError
from rig.realtime import _named_memory as named_memory
from rig.realtime import memories, ring, running
from rig.realtime.control_words import STOP
from rig.realtime.ring import Ring
from tests.conformance.running_loop import loop_process

WAIT_S = 30.0


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


def test_two_starts_at_once_wait_for_each_other_briefly(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(named_memory, "_PATIENCE_S", 0.05)
    elsewhere.mkdir(parents=True)
    with open(elsewhere / "lock", "ab") as held:
        assert named_memory.locks.lock(held.fileno())
        begun = time.monotonic()
        Ring.allocate(10, shared=True).close()
        assert time.monotonic() - begun >= 0.05
