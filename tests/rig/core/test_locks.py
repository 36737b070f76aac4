"""File locks between openings and between processes."""

import subprocess
import sys
from pathlib import Path

from rig.core.locks import is_locked, lock, unlock

CHILD = """
import sys
from rig.core.locks import lock
file = open(sys.argv[1], "a")
print(lock(file.fileno()), flush=True)
input()
"""


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


def test_a_process_that_dies_holds_nothing(tmp_path: Path) -> None:
    path = tmp_path / "file"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", CHILD, str(path)], **pipes) as child:  # type: ignore[call-overload]
        assert child.stdout.readline().strip() == "True"
        assert is_locked(path)
        with open(path, "rb") as file:
            assert not lock(file.fileno())
        child.kill()
    assert not is_locked(path)
