"""Choose the directory of the disk cache of machine code: never outdated, and never writable by another user.

The name of the directory has a hash of the files that compiled code depends on (`rig.realtime.source_files`), the
versions of numba and numpy, and the CPU. The cached code drives a motor at a person's hand: it must not be loaded from
a directory into which another user can write.
"""

import hashlib
import logging
import os
import platform
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numba
import numpy
from llvmlite.binding import get_host_cpu_name

from rig.realtime._user_cache import user_cache
from rig.realtime.source_files import compiled_sources

UNUSED_DAYS = 30.0
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_log = logging.getLogger(__name__)


def cache_key(sources: Mapping[str, bytes]) -> str:
    """Return a hash (16 hex digits) of the sources (content by module), Python, numba, numpy and the CPU."""
    # numba compares the time stamp of a function's own file alone: after an edit of a helper in another file the
    # caller's old machine code would remain in use, which for a control law is silently wrong.
    digest = hashlib.sha256()
    cpu = getattr(numba.config, "CPU_NAME", None) or get_host_cpu_name()
    for fact in (numba.__version__, numpy.__version__, platform.python_version(), platform.machine(), cpu):
        digest.update(fact.encode() + b"\0")
    for name, text in sources.items():
        digest.update(name.encode() + b"\0" + hashlib.sha256(text).digest())
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Return the directory of all caches: ``$HAPTIC_RIG_CACHE`` or the user's; a temporary one if it is not private."""
    named = os.environ.get("HAPTIC_RIG_CACHE")
    base = Path(named) if named else Path(user_cache()) / "haptic-rig"
    for place in (base, Path(tempfile.gettempdir()) / f"haptic-rig-cache{_USER}"):
        found = _make_private(place)
        if found is not None:
            return found
    return _make_temporary()


if sys.platform == "win32":
    _USER = ""  # whose temporary files are his own already

    def writable_by_others(place: Path) -> str:
        """Return "" always: Windows file modes do not show write access, and a user's profile is private by default."""
        return ""

else:
    _USER = f"-{os.getuid()}"

    def writable_by_others(place: Path) -> str:
        """Return the reason why another user could change or replace a directory; "" if no other user can."""
        us = os.getuid()
        if place.lstat().st_uid != us or place.stat().st_uid != us:
            return f"{place} belongs to another user"
        if place.stat().st_mode & _OTHERS_WRITE:
            return f"other users can write into {place}"
        for parent in (*place.absolute().parents, *place.resolve().parents):
            mode = parent.stat().st_mode
            # In a sticky directory such as /tmp, others cannot rename or remove what they do not own.
            if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
                return f"other users can replace files in {parent}"
        return ""


def _make_private(place: Path) -> Path | None:
    """Return `place` as a private directory, created if missing; None if not writable or (with warning) not private."""
    try:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        reason = writable_by_others(place)
        if not reason:
            return place.resolve() if os.access(place, os.W_OK) else None
    except (OSError, RuntimeError):
        return None
    _log.warning(
        "%s, so no compiled code is loaded from it; set HAPTIC_RIG_CACHE to a directory that only you can write",
        reason,
    )
    return None


def _make_temporary() -> Path:
    return Path(tempfile.mkdtemp(prefix="haptic-rig-cache-"))


def _remove_unused(root: Path, current: Path) -> None:
    limit = time.time() - UNUSED_DAYS * 86400.0
    for path in root.glob("kernels-*"):
        try:
            if path != current and path.stat().st_mtime < limit:
                shutil.rmtree(path, ignore_errors=True)
        except OSError:
            continue


def open_cache() -> Path:
    """Return the directory for machine code of the present sources; remove directories that were unused for 30 days."""
    root = cache_root()
    place = root / f"kernels-{cache_key(compiled_sources())}"
    fresh = not place.exists()
    directory = _make_private(place)
    if directory is None:
        return _make_temporary()
    # The time of the last use: `_remove_unused` removes directories by it.
    os.utime(directory)
    if fresh:
        _remove_unused(root, directory)
    return directory
