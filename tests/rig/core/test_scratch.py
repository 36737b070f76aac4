"""A temporary directory is removed with its process, after a kill by the next start; file locks show who lives."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from rig.core import scratch as module
from rig.core.locks import is_locked, lock, unlock
from rig.core.scratch import OWNER, scratch

HOLD = """
import time
from rig.core.scratch import scratch
with scratch("test") as place:
    print(place, flush=True)
    time.sleep(600)
"""


def test_only_the_directory_of_a_killed_process_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    others = [tmp_path / name for name in ("rig-notes", "else-test")]  # no owner, another name
    for place in others:
        place.mkdir()
    (others[1] / OWNER).touch()
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / OWNER).touch()
    (tmp_path / "rig-link").symlink_to(tmp_path / "kept")
    program = [sys.executable, "-P", "-c", HOLD]
    holders = [subprocess.Popen(program, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    try:
        killed, lives = (Path(holder.stdout.readline().strip()) for holder in holders if holder.stdout)
        holders[0].send_signal(signal.SIGKILL)
        holders[0].wait()
        with scratch("test"):
            assert killed.exists(), "one that is young may not have its lock yet"
        monkeypatch.setattr(module, "YOUNG_S", -1.0)
        with scratch("test") as ours:
            assert not killed.exists()
            assert lives.exists()
            assert ours.exists()
            assert os.path.samefile(ours.parent, tmp_path)
        assert not ours.exists()
        assert all(place.exists() for place in (*others, tmp_path / "kept" / OWNER))
    finally:
        for holder in holders:
            holder.kill()
            holder.communicate()


def test_a_lock_has_one_holder_until_release_or_close(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with open(path, "ab") as first, open(path, "ab") as second:
        assert not is_locked(path)
        assert lock(first.fileno())
        assert is_locked(path)
        assert not lock(second.fileno())
        unlock(first.fileno())
        assert not is_locked(path)
        assert lock(second.fileno())
    assert not is_locked(path)
    assert not is_locked(tmp_path / "none")
