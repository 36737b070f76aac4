"""A process that dies at a call that changes the disk, simulated: from the chosen call on all such calls raise.

Whatever clean-up the code still tries does nothing then, as if the process were gone. A write that dies leaves the
first half of its bytes. What compiled code writes (the rows of a capture) does not pass here; where such a file is cut
makes no difference to who finds it.
"""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rig.recording import files, lines


class DeadError(BaseException):
    """The process is gone."""


class Fuse:
    """Counts calls that change the disk, and dies at one of them, before it or after it.

    `names` says what each call so far was.
    """

    def __init__(self, dies_at: int = -1, *, after: bool = False) -> None:
        self.calls = 0
        self.names: list[str] = []
        self.dies_at = dies_at
        self.after = after
        self.dead = False

    def through(self, name: str, call: Callable[[], Any], half: Callable[[], Any] | None = None) -> Any:
        if self.dead:
            raise DeadError
        self.names.append(name)
        number, self.calls = self.calls, self.calls + 1
        if number != self.dies_at:
            return call()
        self.dead = True
        if self.after:
            call()
        elif half is not None:
            half()
        raise DeadError


class Full(Fuse):
    """A disk that is full from some call on; cutting and removing still works."""

    def through(self, name: str, call: Callable[[], Any], half: Callable[[], Any] | None = None) -> Any:
        number, self.calls = self.calls, self.calls + 1
        if number < self.dies_at or half is None:
            return call()
        half()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class FusedFile(io.FileIO):
    """A file whose writes and cuts go through the fuse."""

    fuse: Fuse

    def write(self, data: Any) -> int:  # type: ignore[override]
        whole = bytes(data)
        kept = whole[: len(whole) // 2]
        return self.fuse.through(  # type: ignore[no-any-return]
            f"write {_name(self.name)}",
            lambda: io.FileIO.write(self, whole),
            lambda: io.FileIO.write(self, kept),
        )

    def truncate(self, size: int | None = None) -> int:
        return self.fuse.through(  # type: ignore[no-any-return]
            f"truncate {_name(self.name)}", lambda: io.FileIO.truncate(self, size)
        )


@contextmanager
def fused(monkeypatch: pytest.MonkeyPatch, fuse: Fuse) -> Iterator[None]:
    """Put the fuse into everything through which a session changes the disk."""
    file = type("Fused", (FusedFile,), {"fuse": fuse})
    make, write = os.open, os.write

    def opened(path: Any, flags: int, *args: Any, **more: Any) -> int:
        if not flags & os.O_CREAT or _is_device(path):
            return make(path, flags, *args, **more)
        return fuse.through(f"create {_name(path)}", lambda: make(path, flags, *args, **more))  # type: ignore[no-any-return]

    def written(descriptor: int, data: bytes) -> int:
        path = _path_of(descriptor)
        if _is_device(path):
            return write(descriptor, data)
        return fuse.through(  # type: ignore[no-any-return]
            f"write {_name(path)}",
            lambda: write(descriptor, data),
            lambda: write(descriptor, data[: len(data) // 2]),
        )

    with monkeypatch.context() as patch:
        patch.setattr(lines, "FileIO", file)
        patch.setattr(files, "open", lambda path, mode: file(path, mode.replace("b", "")), raising=False)
        patch.setattr(os, "open", opened)
        patch.setattr(os, "write", written)
        for name in ("fsync", "replace", "rename", "mkdir", "unlink"):
            call = getattr(os, name)

            def through(*args: Any, _name_of: str = name, _call: Any = call, **more: Any) -> Any:
                about = _path_of(args[0]) if isinstance(args[0], int) else args[0]
                return fuse.through(f"{_name_of} {_name(about)}", lambda: _call(*args, **more))

            patch.setattr(os, name, through)
        yield


def _path_of(descriptor: int) -> str:
    return os.readlink(f"/proc/self/fd/{descriptor}")


def _is_device(path: Any) -> bool:
    """Not of a file system: a pipe, a terminal, shared memory."""
    return not str(path).startswith("/") or str(path).startswith(("/dev/", "/proc/", "/memfd:"))


def _name(path: Any) -> str:
    """Last part of a path; of a draft, the name that it will get."""
    name = os.path.basename(str(path))
    return f"draft of {name.split('.', 1)[1].rsplit('.', 2)[0]}" if name.endswith(".draft") else name
