"""Where processes are found, and the environment of a process of this package's own.

Rooms that start a compiler, git or a process of this package call it. It must not start anything itself.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def with_this_package() -> dict[str, str]:
    """Return the environment of a child that imports this package from where this process has it."""
    paths = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


def installed_path() -> str:
    """Return ``PATH`` without relative entries: no file of the current directory becomes a program by its name."""
    places = os.environ.get("PATH", os.defpath).split(os.pathsep)
    return os.pathsep.join(place for place in places if os.path.isabs(place))


def find_program(name: str) -> str | None:
    """Return the path of a program in `installed_path`, None if it is missing; a path is taken as it is.

    Start it with that ``PATH`` too: a compiler finds its linker there.
    """
    if os.path.dirname(name):
        return shutil.which(name)
    found = shutil.which(name, path=installed_path())
    # On Windows `which` searches the current directory first, whatever the path.
    return found if found is not None and os.path.isabs(found) else None
