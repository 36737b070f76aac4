"""Processes that a test starts: none outlives it, whatever becomes of it, and none ignores the signals that it ignores.

A test leaves `started` in any case when it ends by itself or by its timeout. Where it is killed with its whole
process, the kernel kills what hangs on a leash.
"""

from __future__ import annotations

import ctypes
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

LEASH = ("setpriv", "--pdeathsig", "KILL")  # before a command
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


@contextmanager
def started(*command: object, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Start a program, with options of `subprocess.Popen`; it is killed when the block is left."""
    with subprocess.Popen([*LEASH, *map(str, command)], **options) as process:
        try:
            yield process
        finally:
            process.kill()


def die_with_parent() -> None:
    """The same leash, for a process that was forked."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
