"""Memory of a running loop on Linux: an anonymous file, found among the open files of its process.

It lives as long as a process has it open or mapped, so nothing is left behind. It must not become resizable.
"""

from __future__ import annotations

import errno
import fcntl
import os
import sys
from collections.abc import Iterator

assert sys.platform == "linux"

NAME = "haptic-rig"
LINK = f"/memfd:{NAME} (deleted)"
_PROC = "/proc"
# A reader of a file that shrinks gets SIGBUS, which would end a loop without zero effort.
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW
_MFD_NOEXEC_SEAL = 0x8  # Linux 6.3


def make(size: int) -> int:
    """Return the descriptor of zeroed memory of this size (bytes)."""
    descriptor = _memfd()
    try:
        # Allocated now: a tick that first touches a page without memory left would be killed by SIGBUS.
        os.posix_fallocate(descriptor, 0, size)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _SEALS)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _memfd() -> int:
    """Return the descriptor of an anonymous file that cannot be executed."""
    flags = os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING
    try:
        # Kernels with vm.memfd_noexec = 2 refuse files without this flag, those before 6.3 refuse the flag.
        return os.memfd_create(NAME, flags | _MFD_NOEXEC_SEAL)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        return os.memfd_create(NAME, flags)


def close(descriptor: int) -> None:
    """Let go of what `make` made."""
    os.close(descriptor)


def is_sound(descriptor: int) -> bool:
    """Return True if the opened file cannot shrink under its reader."""
    return bool(fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK)


def is_memory(path: str) -> bool:
    """Return True if the path of an open file leads to such a memory."""
    try:
        return os.readlink(path) == LINK
    except OSError:
        return False


def paths(pid: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield each memory as a process has it open, ``/proc/PID/fd/N``, with that process: of all, or of one."""
    for process in os.listdir(_PROC) if pid is None else [str(pid)]:
        if not process.isdecimal():
            continue
        # No registry of loops: it could be stale. The kernel's list of open files cannot.
        try:
            found = [f"{_PROC}/{process}/fd/{name}" for name in os.listdir(f"{_PROC}/{process}/fd")]
        except OSError:  # the process ended, or belongs to another user
            continue
        yield from ((int(process), path) for path in found if is_memory(path))


def held(path: str, descriptor: int) -> str:
    """Return a path for what this process opened, which is valid after the other process has ended too."""
    return f"{_PROC}/self/fd/{descriptor}"


def is_process(pid: int, creator: int) -> bool:
    """Return True if a process has this number, in its own container or outside: the kernel knows both."""
    if creator == pid:
        return True
    # In a container a process has another number inside than outside; NSpid lists both.
    with open(f"{_PROC}/{pid}/status", encoding="ascii", errors="replace") as status:
        for line in status:
            if line.startswith("NSpid:"):
                return creator in [int(number) for number in line.split()[1:]]
    return False


def may_look(pid: int) -> bool:
    """Return True if this user may list a process's open files; raises `ProcessLookupError` if it does not exist."""
    try:
        os.listdir(f"{_PROC}/{pid}/fd")
    except PermissionError:
        return False
    except OSError:
        raise ProcessLookupError from None
    return True


def command_lines() -> Iterator[tuple[int, list[bytes]]]:
    """Yield the processes that this user may not examine, with their command lines."""
    for name in os.listdir(_PROC):
        if name.isdecimal() and not os.access(f"{_PROC}/{name}/fd", os.R_OK | os.X_OK):
            try:
                with open(f"{_PROC}/{name}/cmdline", "rb") as file:
                    words = file.read().split(b"\0")
            except OSError:
                continue
            yield int(name), words
