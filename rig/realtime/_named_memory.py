"""Shared memory of a running loop on systems other than Linux: a file in the user's cache directory.

    .../haptic-rig/loops/PID/alive   locked by process PID while it runs
    .../haptic-rig/loops/PID/N       shared memory number N of this process

The functions have the same names and results as in `rig.realtime._anonymous_memory`. `rig.realtime.memories` and the
ring use them. This file must not import numba or numpy.
"""

import os
import time
from collections.abc import Iterator
from io import FileIO

from rig.core import locks
from rig.realtime._user_cache import user_cache

ALIVE = "alive"
_PATIENCE_S = 2.0  # for other processes that create or list memories: they need milliseconds
_CHUNK = bytes(1 << 20)

_alive: dict[int, FileIO] = {}  # lock of this process, by its number: a fork has none
_made: dict[int, str] = {}  # path of each memory by its descriptor


def make(size: int) -> int:
    """Create a file of `size` zero bytes as shared memory of a loop and return its descriptor."""
    directory = _own_directory()
    number = max((int(name) for name in os.listdir(directory) if name.isdecimal()), default=0) + 1
    path = os.path.join(directory, str(number))
    descriptor = _open(path, "x+")
    try:
        for start in range(0, size, len(_CHUNK)):
            # Written, not only extended: a full disk is reported here and not by a fault in a tick.
            os.write(descriptor, _CHUNK[: size - start])
    except OSError:
        os.close(descriptor)
        os.unlink(path)
        raise
    _made[descriptor] = path
    return descriptor


def close(descriptor: int) -> None:
    """Close the descriptor of a shared memory that `make` returned, and remove the memory's file."""
    os.close(descriptor)
    path = _made.pop(descriptor, None)
    if path is not None:
        _remove(path)


def is_sound(descriptor: int) -> bool:
    """Return True always: on these systems only this user can change the file of a loop's memory."""
    return True


def is_memory(path: str) -> bool:
    """Return True if `path` is the file of a loop's shared memory and the process that created the file still runs."""
    directory, name = os.path.split(path)
    return (
        name.isdecimal()
        and os.path.dirname(directory) == _root()
        and os.path.exists(path)
        and _is_alive(directory)
    )


def paths(pid: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield process number and path of each loop's shared memory whose process runs; `pid` selects one process."""
    for process in _names(_root()) if pid is None else [str(pid)]:
        directory = os.path.join(_root(), process)
        if process.isdecimal() and _is_alive(directory):
            yield from (
                (int(process), os.path.join(directory, name))
                for name in _names(directory)
                if name.isdecimal()
            )


def held(path: str, descriptor: int) -> str:
    """Return `path`, by which this process can open the memory again."""
    return path


def is_process(pid: int, creator: int) -> bool:
    """Return True if `pid` and `creator` are the same process number."""
    return creator == pid


def may_look(pid: int) -> bool:
    """Return True if the process `pid` runs a loop of this user; raise `ProcessLookupError` otherwise."""
    if not _is_alive(os.path.join(_root(), str(pid))):
        raise ProcessLookupError
    return True


def command_lines() -> Iterator[tuple[int, list[bytes]]]:
    """Return an empty iterator: on these systems processes of other users are not examined."""
    return iter(())


def _root() -> str:
    return os.path.join(user_cache(), "haptic-rig", "loops")


def _own_directory() -> str:
    """Return the directory for shared memories of this process, created and locked; remove those of dead processes."""
    pid = os.getpid()
    directory = os.path.join(_root(), str(pid))
    if pid not in _alive:
        os.makedirs(_root(), mode=0o700, exist_ok=True)
        with FileIO(os.path.join(_root(), "lock"), "a") as one_at_a_time:
            _wait_for_lock(one_at_a_time)
            # A killed process leaves its directory, whose lock is free then: the next process removes it.
            for name in _names(_root()):
                _remove_if_dead(os.path.join(_root(), name))
            os.makedirs(directory, mode=0o700, exist_ok=True)
            alive = FileIO(os.path.join(directory, ALIVE), "a")
            _wait_for_lock(alive)
            _alive[pid] = alive
    return directory


def _wait_for_lock(file: FileIO) -> None:
    deadline = time.monotonic() + _PATIENCE_S
    while not locks.lock(file.fileno()) and time.monotonic() < deadline:
        time.sleep(0.005)


def _remove_if_dead(directory: str) -> None:
    if os.path.isdir(directory) and not _is_alive(directory):
        for name in _names(directory):
            _remove(os.path.join(directory, name))
        try:
            os.rmdir(directory)
        except OSError:
            return


def _is_alive(directory: str) -> bool:
    return locks.is_locked(os.path.join(directory, ALIVE))


def _names(directory: str) -> list[str]:
    try:
        return sorted(os.listdir(directory))
    except OSError:
        return []


def _remove(path: str) -> None:
    try:
        os.unlink(path)
    except OSError:
        return


def _open(path: str, mode: str) -> int:
    # FileIO and not os.open, which on Windows would change line ends without O_BINARY.
    with FileIO(path, mode) as file:
        return os.dup(file.fileno())
