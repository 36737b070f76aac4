"""Shared memory of a running loop on Linux: an anonymous file, found among the open files of its process.

The memory exists while a process has it open or mapped, so no file remains afterwards. It must not become resizable.
"""

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
    """Create zeroed shared memory of `size` bytes and return its file descriptor."""
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
    flags = os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING
    try:
        # Kernels with vm.memfd_noexec = 2 refuse files without this flag, those before 6.3 refuse the flag.
        return os.memfd_create(NAME, flags | _MFD_NOEXEC_SEAL)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        return os.memfd_create(NAME, flags)


def close(descriptor: int) -> None:
    """Close the descriptor of shared memory that `make` returned."""
    os.close(descriptor)


def is_sound(descriptor: int) -> bool:
    """Return True if the shared memory behind this descriptor is sealed against shrinking: reading it is then safe."""
    return bool(fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK)


def is_memory(path: str) -> bool:
    """Return True if `path`, an open file of a process (``/proc/PID/fd/N``), is the shared memory of a loop."""
    try:
        return os.readlink(path) == LINK
    except OSError:
        return False


def paths(pid: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield process number and path (``/proc/PID/fd/N``) of each open shared memory of a loop, in `pid` or in all."""
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
    """Return a path by which this process can reopen the shared memory `descriptor`, even after its creator ended."""
    return f"{_PROC}/self/fd/{descriptor}"


def is_process(pid: int, creator: int) -> bool:
    """Return True if process `pid` has the number `creator`, either here or inside its own container."""
    if creator == pid:
        return True
    # In a container a process has another number inside than outside; NSpid lists both.
    with open(f"{_PROC}/{pid}/status", encoding="ascii", errors="replace") as status:
        for line in status:
            if line.startswith("NSpid:"):
                return creator in [int(number) for number in line.split()[1:]]
    return False


def may_look(pid: int) -> bool:
    """Return True if this user may list a process's open files; raise `ProcessLookupError` without such a process."""
    try:
        os.listdir(f"{_PROC}/{pid}/fd")
    except PermissionError:
        return False
    except OSError:
        raise ProcessLookupError from None
    return True


def command_lines() -> Iterator[tuple[int, list[bytes]]]:
    """Yield number and command line (list of words) of each process whose open files this user may not list."""
    for name in os.listdir(_PROC):
        if name.isdecimal() and not os.access(f"{_PROC}/{name}/fd", os.R_OK | os.X_OK):
            try:
                with open(f"{_PROC}/{name}/cmdline", "rb") as file:
                    words = file.read().split(b"\0")
            except OSError:
                continue
            yield int(name), words
