"""The one decorator of every compiled function of this project, and the key of its disk cache.

numba decides whether a cached function is fresh by the time stamp of *its own* file: a helper edited in
another file leaves the caller's old machine code in force, which for a control law is silently wrong. So
the cache directory carries a hash of the files that compiled code depends on (`rig.realtime.source_files`), of
numba's and numpy's version and of the CPU; an edit there opens a new, empty directory, and directories unused for
a month are removed. Whoever edits a command or an experiment does not wait for the compiler.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy

from rig.realtime.source_files import compiled_files

F = TypeVar("F", bound=Callable[..., Any])

UNUSED_DAYS = 30.0


def cache_key(files: Iterable[Path]) -> str:
    """Sixteen hex digits over file names and contents, numba, numpy and the CPU."""
    digest = hashlib.sha256()
    cpu = getattr(numba.config, "CPU_NAME", None) or platform.processor() or platform.machine()
    for fact in (
        numba.__version__,
        numpy.__version__,
        platform.python_version(),
        platform.machine(),
        str(cpu),
    ):
        digest.update(fact.encode() + b"\0")
    for path in files:
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Directory of all caches: ``$HAPTIC_RIG_CACHE``, the user's cache directory, or a temporary one."""
    named = os.environ.get("HAPTIC_RIG_CACHE")
    base = (
        Path(named)
        if named
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "haptic-rig"
    )
    for place in (base, Path(tempfile.gettempdir()) / f"haptic-rig-cache-{os.getuid()}"):
        with contextlib.suppress(OSError, RuntimeError):
            place.mkdir(parents=True, exist_ok=True, mode=0o700)
            if place.stat().st_uid == os.getuid() and os.access(place, os.W_OK):
                return place
    return Path(tempfile.mkdtemp(prefix="haptic-rig-cache-"))


def _forget_unused(root: Path, current: Path) -> None:
    limit = time.time() - UNUSED_DAYS * 86400.0
    for path in root.glob("kernels-*"):
        try:
            if path != current and path.stat().st_mtime < limit:
                shutil.rmtree(path, ignore_errors=True)
        except OSError:
            continue


def _open_cache() -> Path:
    root = cache_root()
    directory = root / f"kernels-{cache_key(compiled_files())}"
    try:
        fresh = not directory.exists()
        directory.mkdir(exist_ok=True)
        os.utime(directory)
        if fresh:
            _forget_unused(root, directory)
    except OSError:
        directory = Path(tempfile.mkdtemp(prefix="haptic-rig-cache-"))
    return directory


CACHE_DIRECTORY = _open_cache()
numba.config.CACHE_DIR = str(CACHE_DIRECTORY)
_MARK = CACHE_DIRECTORY / "warm"


def is_cold() -> bool:
    """Whether the kernels of this version still have to be compiled (tens of seconds, once)."""
    return not _MARK.exists() and not numba.config.DISABLE_JIT


def mark_warm() -> None:
    """Remember that a whole run has been compiled into the cache."""
    with contextlib.suppress(OSError):
        _MARK.touch()


def kernel(
    signature: Any, *, cache: bool = True, inline: bool = False, borrow: bool = False
) -> Callable[[F], F]:
    """Compile a plain function for the loop: no GIL, cached on disk, one signature, numpy's error model.

    Parameters
    ----------
    signature
        numba signature, or a list of them. It is compiled at once, so that no call ever waits for the
        compiler.
    cache
        Keep the machine code on disk. Third parties' laws outside this project must say False, because
        their sources are not part of the key.
    inline
        Ask LLVM to inline small helpers always.
    borrow
        Count no references to array arguments, which the caller holds anyway. numba counts them atomically
        and removes that only from simple control flow; elsewhere it costs some 20 ns a call. Such a kernel
        cannot make or return an array, `carray` included.

    Notes
    -----
    A kernel allocates nothing and raises nothing; a value that is not finite is handled by `rig.control.guard`.
    With ``NUMBA_DISABLE_JIT=1`` the plain function is returned, so that tests and coverage see it.
    """
    options: dict[str, Any] = {"nogil": True, "cache": cache, "error_model": "numpy", "fastmath": False}
    if inline:
        options["forceinline"] = True
    if borrow:
        options["_nrt"] = False

    def decorate(function: F) -> F:
        return numba.njit(signature, **options)(function)  # type: ignore[no-any-return]

    return decorate
