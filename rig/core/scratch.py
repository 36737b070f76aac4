"""Temporary directories that are removed when their process ends; after kill -9, by the next process that makes one.

Exports, builds, pictures and the console work in them. They must not contain files that a user may want to keep.
"""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.core.locks import lock

OWNER = "owner"  # a file that is locked while the process lives
YOUNG_S = 60.0  # between a directory and its lock: far longer than that takes


@contextmanager
def scratch(kind: str) -> Iterator[Path]:
    """Yield a new temporary directory ``rig-KIND-…``, removed at the end; also remove those of dead processes."""
    _remove_abandoned()
    with (
        tempfile.TemporaryDirectory(prefix=f"rig-{kind}-") as place,
        open(Path(place, OWNER), "wb") as owner,
    ):
        with suppress(OSError):  # a file system without locks, where nothing is removed either
            lock(owner.fileno())
        yield Path(place)


def _remove_abandoned() -> None:
    for owner in Path(tempfile.gettempdir()).glob(f"rig-*/{OWNER}"):
        with suppress(OSError):
            if not _is_ours(owner.parent):
                continue
            with open(owner, "rb") as file:
                left = lock(file.fileno())
            if left:
                shutil.rmtree(owner.parent, ignore_errors=True)


def _is_ours(place: Path) -> bool:
    facts = place.lstat()
    ours = not hasattr(os, "getuid") or facts.st_uid == os.getuid()
    return ours and not place.is_symlink() and time.time() - facts.st_mtime > YOUNG_S
