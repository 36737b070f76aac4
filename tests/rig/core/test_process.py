"""Helper processes end with their context or parent; programs start from where they are installed."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from rig.core.child import find_program
from rig.core.errors import DeviceNotFoundError, RigError
from rig.core.process import start_announced
from rig.realtime._c_library import CLibrary
from tests.conformance.started import WAIT_S, is_alive, started


def announce_and_wait(announce: Callable[[Any], None]) -> None:
    announce(os.getpid())
    threading.Event().wait()


def refuse(announce: Callable[[Any], None]) -> None:
    raise RigError("not today", remedy="tomorrow")


def until_dead(pid: int) -> None:
    deadline = time.monotonic() + WAIT_S
    while is_alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def serving(name: str = "waits") -> Any:
    return start_announced(announce_and_wait, name=name, by_hand="no command")


def test_a_process_outlives_the_thread_that_started_it_and_ends_with_its_context() -> None:
    with ExitStack() as stack:
        found: list[int] = []
        thread = threading.Thread(target=lambda: found.append(stack.enter_context(serving())))
        thread.start()
        thread.join()
        (pid,) = found
        time.sleep(0.05)
        assert is_alive(pid)
    assert not is_alive(pid)


PARENT = """
import os, sys, threading
from tests.rig.core.test_process import serving
with serving() as pid:
    child = os.fork()  # it has a copy of every descriptor
    if child == 0:
        threading.Event().wait()
    print(pid, child, flush=True)
    threading.Event().wait()
"""


@pytest.mark.signals
def test_a_process_ends_with_a_killed_parent() -> None:
    with started(sys.executable, "-c", PARENT, stdout=subprocess.PIPE, text=True) as parent:
        pid, forked = map(int, parent.stdout.readline().split())
        try:
            assert is_alive(pid)
            parent.kill()
            until_dead(pid)
            assert is_alive(forked)
        finally:
            os.kill(forked, signal.SIGKILL)


def test_an_error_in_the_process_is_raised_here_and_an_early_end_is_named() -> None:
    with pytest.raises(RigError, match="not today"), start_announced(refuse, name="refuses", by_hand="none"):
        pass
    with (
        pytest.raises(DeviceNotFoundError, match="the process ends did not start"),
        start_announced(os._exit, name="ends", by_hand="rig ends"),
    ):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="a script is no program there")
@pytest.mark.parametrize("entry", ["", ".", "inside"])
def test_a_program_of_the_working_directory_is_not_found_by_its_name(
    entry: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "inside").mkdir()
    for program in (place / name for place in (tmp_path, tmp_path / "inside") for name in ("sh", "cc-here")):
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    installed = shutil.which("sh")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join([entry, os.environ["PATH"]]))
    assert shutil.which("cc-here") is not None
    assert find_program("cc-here") is None
    assert find_program("sh") == installed
    assert find_program("./cc-here") == "./cc-here"  # a path is used as it is
    monkeypatch.setenv("PATH", entry)
    assert find_program("sh") is None


@pytest.mark.skipif(
    sys.platform == "win32" or shutil.which("cc") is None, reason="a script as linker of a cc"
)
def test_a_compiler_runs_no_linker_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cc", "gcc", "clang", "as", "ld", "collect2"):
        (tmp_path / name).write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "one.c").write_text("int one(void) { return 1; }\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", os.environ["PATH"]]))
    made = CLibrary(name="one", root=tmp_path, parts=("sources",), purpose="for a test").compiled(tmp_path)
    assert made.exists()
    assert not (tmp_path / "ran").exists()
