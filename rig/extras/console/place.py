"""Names that a page may say: of what lies in one directory, never a way out of it."""

from __future__ import annotations

import stat
from collections.abc import Callable
from pathlib import Path

from rig.core.errors import ConfigError


def file_in(directory: Path, name: str) -> Path:
    """Return a plain file of a directory; `ConfigError` for a path, a link, a hidden file, or what is not there."""
    return _entry(directory, name, stat.S_ISREG, "file")


def directory_in(directory: Path, name: str) -> Path:
    """Return a directory of a directory; errors as `file_in`."""
    return _entry(directory, name, stat.S_ISDIR, "directory")


def _entry(directory: Path, name: str, right: Callable[[int], bool], kind: str) -> Path:
    path = directory / name
    try:
        plain = bool(name) and name == Path(name).name and not name.startswith(".")
        if plain and right(path.lstat().st_mode):
            return path
    except (OSError, ValueError):  # not there, or no name of a file at all
        pass
    raise ConfigError(f"{name!r} is not a {kind} here", remedy="choose one of the list")
