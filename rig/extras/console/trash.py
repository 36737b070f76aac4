"""Move recordings and their pictures to the trash directory and back, for a page.

It must never delete or overwrite a file.
"""

from pathlib import Path

from rig.core.errors import ConfigError
from rig.recording.files import make_directories, plain_errors, refuse_existing
from rig.views.plots.style import FORMATS


def throw_away(recording: Path, trash: Path) -> None:
    """Move a recording and its pictures into the directory `trash`, with a number added to the name if it is taken.

    Raises `ConfigError` if `trash` is a symbolic link, `RecordingError` if a file cannot be moved.
    """
    refuse_link(trash)
    make_directories(trash)
    moved = _with_pictures(recording)
    stem, number = recording.stem, 1
    while any((trash / f"{stem}{path.suffix}").exists() for path in moved):
        number += 1
        stem = f"{recording.stem}-{number}"
    # The recording is moved last, so that an interrupted move can be repeated: pictures are found by its name.
    for path in moved:
        _move(path, trash / f"{stem}{path.suffix}")


def refuse_link(trash: Path) -> None:
    """Raise `ConfigError` if `trash` is a symbolic link, so that no file is moved through a link."""
    if trash.is_symlink():
        raise ConfigError(f"the trash {trash} is a symbolic link", remedy="replace it by a directory")


def restore(recording: Path, directory: Path) -> None:
    """Move a recording and its pictures from the trash into `directory`.

    Raises `ConfigError` if the trash is a symbolic link, `RecordingError` if a file of this name exists.
    """
    refuse_link(recording.parent)
    moved = _with_pictures(recording)
    for path in moved:
        refuse_existing(directory / path.name)
    for path in moved:
        _move(path, directory / path.name)


def _with_pictures(recording: Path) -> list[Path]:
    pictures = [recording.with_suffix(f".{ending}") for ending in FORMATS]
    return [*(path for path in pictures if path.is_file()), recording]


def _move(path: Path, target: Path) -> None:
    with plain_errors("move", path):
        path.rename(target)
