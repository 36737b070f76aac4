"""Simulate a process that dies at a call that changes the disk: from the chosen call on all such calls raise an error.

A write at which the process dies stores the first half of its bytes. Rows of a capture are written by compiled code and
not counted here: a resumed session moves an incomplete capture aside.
"""

import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rig.recording import files, lines

Call = Callable[[], Any]


class DeadError(BaseException):
    """Raised by each disk call after the simulated death of the process."""


class Fuse:
    """Count calls that change the disk, and die at call `dies_at` (None: never), before it or after it.

    `names` contains a description of each call so far.
    """

    def __init__(self, dies_at: int | None = None, *, after: bool = False) -> None:
        self.calls = 0
        self.names: list[str] = []
        self.dies_at = dies_at
        self.after = after
        self.dead = False

    def call_or_die(self, name: str, call: Call, partial_call: Call | None = None) -> Any:
        if self.dead:
            raise DeadError
        self.names.append(name)
        number, self.calls = self.calls, self.calls + 1
        if number != self.dies_at:
            return call()
        self.dead = True
        if self.after:
            call()
        elif partial_call is not None:
            partial_call()
        raise DeadError


class FullDisk:
    """A disk that is full from call `full_from` on; cutting and removing files still work."""

    def __init__(self, full_from: int) -> None:
        self.calls = 0
        self.full_from = full_from

    def call_or_die(self, name: str, call: Call, partial_call: Call | None = None) -> Any:
        number, self.calls = self.calls, self.calls + 1
        if number < self.full_from or partial_call is None:
            return call()
        partial_call()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class FusedFile(io.FileIO):
    fuse: Fuse | FullDisk

    def write(self, data: Any) -> Any:
        whole = bytes(data)
        return self.fuse.call_or_die(
            f"write {_name(self.name)}",
            lambda: io.FileIO.write(self, whole),
            lambda: io.FileIO.write(self, whole[: len(whole) // 2]),
        )

    def truncate(self, size: int | None = None) -> Any:
        return self.fuse.call_or_die(f"truncate {_name(self.name)}", lambda: io.FileIO.truncate(self, size))


@contextmanager
def fused(monkeypatch: pytest.MonkeyPatch, fuse: Fuse | FullDisk) -> Iterator[None]:
    """Pass each call of a session that changes the disk to the fuse; paths must be absolute."""
    file_class = type("FusedFileOfThisFuse", (FusedFile,), {"fuse": fuse})
    real_open, real_write = os.open, os.write

    def fused_open(path: Any, flags: int, *args: Any, **options: Any) -> Any:
        assert not flags & os.O_CREAT or os.path.isabs(path), path
        if not flags & os.O_CREAT or _is_device(path):
            return real_open(path, flags, *args, **options)
        return fuse.call_or_die(f"create {_name(path)}", lambda: real_open(path, flags, *args, **options))

    def fused_write(descriptor: int, data: bytes) -> Any:
        path = _path_of(descriptor)
        if _is_device(path):
            return real_write(descriptor, data)
        return fuse.call_or_die(
            f"write {_name(path)}",
            lambda: real_write(descriptor, data),
            lambda: real_write(descriptor, data[: len(data) // 2]),
        )

    with monkeypatch.context() as patch:
        patch.setattr(lines, "FileIO", file_class)
        # Shadows the builtin in that module, which has no attribute of this name: `raising=False`.
        patch.setattr(files, "open", lambda path, mode: file_class(path, mode[0]), raising=False)
        patch.setattr(os, "open", fused_open)
        patch.setattr(os, "write", fused_write)
        for name in ("fsync", "replace", "rename", "mkdir", "unlink"):
            real_call = getattr(os, name)

            # The name of a call contains its first argument only: for `replace` and `rename`, the source.
            def fused_call(*args: Any, _call_name: str = name, _call: Any = real_call, **options: Any) -> Any:
                path = _path_of(args[0]) if isinstance(args[0], int) else args[0]
                return fuse.call_or_die(f"{_call_name} {_name(path)}", lambda: _call(*args, **options))

            patch.setattr(os, name, fused_call)
        yield


def _path_of(descriptor: int) -> str:
    return os.readlink(f"/proc/self/fd/{descriptor}")


def _is_device(path: Any) -> bool:
    """Return True for a pipe, a terminal or shared memory: `pipe:[…]`, or a path that no disk stores."""
    return not str(path).startswith("/") or str(path).startswith(("/dev/", "/proc/", "/memfd:"))


def _name(path: Any) -> str:
    """Return the last part of a path; of a draft, `.NAME.PID.draft`, without its PID, which differs between runs."""
    name = os.path.basename(str(path))
    return f"draft of {name.split('.', 1)[1].rsplit('.', 2)[0]}" if name.endswith(".draft") else name
