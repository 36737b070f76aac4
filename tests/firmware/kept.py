"""A cache of compiled files, shared by test processes and runs."""

import fcntl
import hashlib
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

from rig.realtime.kernel import CACHE_DIRECTORY


def kept(key: str, make: Callable[[Path], None]) -> Path:
    """Return a directory that `make` has filled for this key, now or in an earlier run; safe for parallel calls."""
    path = CACHE_DIRECTORY / f"test-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if not path.exists():
        with open(f"{path}.lock", "w") as lock, tempfile.TemporaryDirectory(dir=CACHE_DIRECTORY) as workplace:
            fcntl.flock(
                lock, fcntl.LOCK_EX
            )  # linking an image takes seconds, which two processes need not spend
            if not path.exists():
                made = Path(workplace) / "made"
                made.mkdir()
                make(made)
                made.rename(path)
    return path


def identity(program: str) -> str:
    """Return a string that identifies the version of a program."""
    place = Path(program).resolve()
    return f"{place} {place.stat().st_size} {place.stat().st_mtime_ns}"


def content(files: Iterable[Path]) -> str:
    """Return a fingerprint of the paths and contents of files."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
