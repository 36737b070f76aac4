"""Recordings that the operator puts aside: moved with their pictures, never removed, and never over another."""

from __future__ import annotations

from pathlib import Path

from rig.core.errors import ConfigError
from rig.recording.files import make_directories, plain_errors, refuse_existing
from rig.views.plots.style import FORMATS


def throw_away(recording: Path, trash: Path) -> None:
    """Move a recording and its pictures into a directory, under a free name.

    Raises `ConfigError` where the trash is a link to elsewhere, `RecordingError` when the disk refuses.
    """
    refuse_link(trash)
    make_directories(trash)
    moved = _with_pictures(recording)
    stem, number = recording.stem, 1
    while any((trash / f"{stem}{path.suffix}").exists() for path in moved):
        number += 1
        stem = f"{recording.stem}-{number}"
    for path in moved:
        _move(path, trash / f"{stem}{path.suffix}")


def refuse_link(trash: Path) -> None:
    """Raise `ConfigError` where the trash is a link: nothing is moved to elsewhere, or from there."""
    if trash.is_symlink():
        raise ConfigError(f"{trash} is a symbolic link", remedy="replace it by a directory")


def restore(recording: Path, directory: Path) -> None:
    """Move a recording and its pictures back.

    Raises `ConfigError` where the trash is a link to elsewhere, `RecordingError` where something of their name exists.
    """
    refuse_link(recording.parent)
    moved = _with_pictures(recording)
    for path in moved:
        refuse_existing(directory / path.name)
    for path in moved:
        _move(path, directory / path.name)


def _with_pictures(recording: Path) -> list[Path]:
    """Return the recording last: while its pictures move, it is still where it was."""
    pictures = [recording.with_suffix(f".{ending}") for ending in FORMATS]
    return [*(path for path in pictures if path.is_file()), recording]


def _move(path: Path, target: Path) -> None:
    with plain_errors("move", path):
        path.rename(target)
