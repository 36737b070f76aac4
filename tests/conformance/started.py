"""Child processes of tests: none outlives its test, and none inherits ignored signals.

A test leaves `started` and `forked` in any case when it ends by itself or by its timeout. If the whole test process is
killed, the kernel kills its children, which are started with `LEASH` or call `die_with_parent`.
"""

import ctypes
import multiprocessing
import signal
import subprocess
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

LEASH = ("setpriv", "--pdeathsig", "KILL")  # before a command
# Timeout of a wait for another process or thread, which may compile first, on a loaded machine. It must end before the
# timeout of pytest.
WAIT_S = 100.0
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


@contextmanager
def started(*command: object, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a program with options of `subprocess.Popen`, and kill it at the end of the block."""
    with subprocess.Popen([*LEASH, *map(str, command)], **options) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def forked(body: Callable[..., None], *arguments: Any) -> Iterator[tuple[BaseProcess, Connection]]:
    """Fork a process that calls `body` with its end of a pipe and `arguments`, and kill it at the end of the block.

    It has the libraries and the compiled code of this process, whose loading takes a program of its own 0.4 s.
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_live, args=(body, theirs, *arguments))
    with ours:
        # Python 3.12 warns of other threads.
        with theirs, warnings.catch_warnings(action="ignore", category=DeprecationWarning):
            process.start()
        try:
            yield process, ours
        finally:
            process.kill()
            process.join()


def _live(body: Callable[..., None], *arguments: Any) -> None:
    die_with_parent()
    body(*arguments)


def is_alive(pid: int) -> bool:
    """Return True if the process exists and has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def die_with_parent() -> None:
    """Let the kernel kill this forked process when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
