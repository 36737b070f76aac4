"""Convert names that a page sends to paths, and reject every name that leads outside of a directory."""

import stat
from collections.abc import Callable
from pathlib import Path

from rig.core.errors import ConfigError


def file_in(directory: Path, name: str) -> Path:
    """Return the path of a regular file in `directory`; raise `ConfigError` for other paths, links and hidden files."""
    return _entry(directory, name, stat.S_ISREG, "file")


def directory_in(directory: Path, name: str) -> Path:
    """Return the path of a subdirectory; raise `ConfigError` for other paths, links and hidden directories."""
    return _entry(directory, name, stat.S_ISDIR, "directory")


def _entry(directory: Path, name: str, right: Callable[[int], bool], kind: str) -> Path:
    path = directory / name
    try:
        plain = bool(name) and name == Path(name).name and not name.startswith(".")
        if plain and right(path.lstat().st_mode):
            return path
    except (OSError, ValueError):  # not there, or no name of a file at all
        pass
    raise ConfigError(
        f"{name!r} is not the name of a {kind} in {directory.name}", remedy=f"choose a listed {kind}"
    )
