"""Paths of other programs, and environment of child processes of this package.

Packages that start a compiler, git or a process of `rig` call it. It must not start anything itself.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def with_this_package() -> dict[str, str]:
    """Return the environment for a child process that imports this package from the same place as this process."""
    paths = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


def installed_path() -> str:
    """Return ``PATH`` without relative entries, so that no file of the current directory is started as a program."""
    places = os.environ.get("PATH", os.defpath).split(os.pathsep)
    return os.pathsep.join(place for place in places if os.path.isabs(place))


def find_program(name: str) -> str | None:
    """Return the path of a program in `installed_path`, None if it is missing; `name` may also be a path.

    Start the program with `installed_path` as its ``PATH``: a compiler finds its linker there.
    """
    if os.path.dirname(name):
        return shutil.which(name)
    found = shutil.which(name, path=installed_path())
    # On Windows `which` searches the current directory first, whatever the path.
    return found if found is not None and os.path.isabs(found) else None
