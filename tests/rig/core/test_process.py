"""Helper processes end when they are closed or their parent ends, and do not change the parent."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest

from rig.core.errors import DeviceNotFoundError, RigError
from rig.core.process import start_announced
from tests.conformance.started import is_alive, started

WAIT_S = 50.0


def announce_and_wait(announce: Callable[[Any], None]) -> None:
    """Announce the process, then wait for ever."""
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
