"""Child processes of tests: none outlives its test, and none inherits ignored signals.

A test leaves `started` in any case when it ends by itself or by its timeout. If the whole test process is killed, the
kernel kills its children, which are started with `LEASH`.
"""

import ctypes
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LEASH = ("setpriv", "--pdeathsig", "KILL")  # before a command
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


@contextmanager
def started(*command: object, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a program with options of `subprocess.Popen`, and kill it at the end of the block."""
    with subprocess.Popen([*LEASH, *map(str, command)], **options) as process:
        try:
            yield process
        finally:
            process.kill()


def is_alive(pid: int) -> bool:
    """Return True if the process exists and has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def die_with_parent() -> None:
    """Let the kernel kill this forked process when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
