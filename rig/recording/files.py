"""Atomic writing of files (write under another name, flush to disk, rename), and messages for disk errors.

Every package that writes files uses this module. A partly written file must never have the final name.
"""

import errno
import hashlib
import os
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from rig.core.errors import ConfigError, RecordingError
from rig.core.regular_file import open_regular

_REMEDIES = {
    errno.ENOENT: "check the path, or make the directory first",
    errno.ENAMETOOLONG: "check the path",
    errno.ENOTDIR: "check the path, or make the directory first",
    errno.EEXIST: "choose another name; recordings are never overwritten",
    errno.EISDIR: "give the path of a file inside this directory",
    errno.ENXIO: "give the path of a regular file",
    errno.EOVERFLOW: "give the file that haptic-rig wrote",
    errno.EACCES: "choose a place that you may write to",
    errno.EPERM: "choose a place that you may write to",
    errno.EROFS: "choose a place that you may write to",
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "free some space, or raise the limit on file sizes",
}


def disk_error(doing: str, path: Path, number: int, reason: str | None = None) -> RecordingError:
    """Return a `RecordingError` "cannot DOING PATH: REASON" with advice on what to do.

    `number` is an errno of the operating system or of `rig.core.regular_file`; without `reason`, its text is used.
    """
    cause = reason or os.strerror(number)
    return RecordingError(f"cannot {doing} {path}: {cause}", remedy=_REMEDIES.get(number, ""))


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of the contents of a file, as 64 hex digits."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def plain_errors(doing: str, path: Path) -> Iterator[None]:
    """Replace any `OSError` raised inside the ``with`` block by a `RecordingError` "cannot DOING PATH: REASON"."""
    try:
        yield
    except OSError as error:
        raise disk_error(doing, path, error.errno or errno.EIO, error.strerror) from error


def sync_directory(directory: Path) -> None:
    """Flush the file names of a directory to the disk; do nothing if the operating system cannot flush directories."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def make_directories(directory: Path) -> None:
    """Create a directory and its missing parents, flushed to the disk; raise `RecordingError` on a disk error."""
    missing: list[Path] = []
    there = directory
    with plain_errors("make", directory):
        while not there.is_dir() and there != there.parent:
            missing.append(there)
            there = there.parent
        # Another process may have made this directory and died before it synced the name.
        sync_directory(there.parent)
        for one in reversed(missing):
            one.mkdir(exist_ok=True)
            sync_directory(one.parent)


def refuse_existing(path: Path) -> None:
    """Raise `RecordingError` if the path exists."""
    if path.exists():
        raise disk_error("write", path, errno.EEXIST)


@contextmanager
def whole_file(
    path: Path, *, overwrite: bool = False, check: Callable[[Path], None] | None = None
) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name `path` only when the ``with`` block ends without an exception.

    Before the renaming, the contents are flushed to the disk and `check` is called with the path of the temporary file.
    If the block or `check` raises an exception, the temporary file is removed. Raise `RecordingError` if `path` exists
    (unless `overwrite`), or on a disk error.
    """
    if not overwrite:
        refuse_existing(path)
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    with plain_errors("write", path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        try:
            with open(draft, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if check is not None:
                check(draft)
            os.replace(draft, path)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        sync_directory(path.parent)


@contextmanager
def whole_directory(path: Path) -> Iterator[Path]:
    """Yield the path of a new empty directory; rename it to `path` when the ``with`` block ends without an exception.

    Raise `RecordingError` if `path` exists, or on a disk error.
    """
    refuse_existing(path)
    draft = path.with_name(f".{path.name}.{os.getpid()}.draft")
    with plain_errors("write", path):
        try:
            draft.mkdir(parents=True)
            yield draft
            os.replace(draft, path)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
        sync_directory(path.parent)


def free_name(directory: Path, stem: str) -> Path:
    """Return the first of the paths STEM.rigcap, STEM-2.rigcap, … for which no recording or picture exists.

    Characters of `stem` that are not valid in a file name are replaced by hyphens. Raise `ConfigError` after 9999
    names.
    """
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip(".-") or "rig"
    for number in range(1, 10_000):
        name = stem if number == 1 else f"{stem}-{number}"
        capture = directory / f"{name}.rigcap"
        if capture not in _reserved and not any(
            capture.with_suffix(suffix).exists() for suffix in (".rigcap", ".parquet", ".png", ".svg", ".pdf")
        ):
            return capture
    raise ConfigError(
        f"{directory} already has 9999 recordings with the name {stem}",
        remedy="choose another directory or name with `output`",
    )


_reserved: set[Path] = set()
_reserving = threading.Lock()


@contextmanager
def reserved_name(directory: Path, stem: str) -> Iterator[Path]:
    """Yield an unused path STEM.rigcap, which no other thread of this process gets until the ``with`` block ends."""
    with _reserving:
        capture = free_name(directory, stem)
        _reserved.add(capture)
    try:
        yield capture
    finally:
        with _reserving:
            _reserved.discard(capture)
