"""Find programs to start, and set the environment of child processes of this package.

Packages that start a compiler, git or a process of `rig` use it. It must not start anything itself.
"""

import os
import shutil
from pathlib import Path


def with_this_package() -> dict[str, str]:
    """Return environment variables with which a child process imports this package from the same directory."""
    paths = (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


def installed_path() -> str:
    """Return ``PATH`` without relative directories, so that no program is started from the current directory."""
    places = os.environ.get("PATH", os.defpath).split(os.pathsep)
    return os.pathsep.join(place for place in places if os.path.isabs(place))


def find_program(name: str) -> str | None:
    """Return the path of a program, not searched in the current directory (`installed_path`); None if missing."""
    if os.path.dirname(name):
        return shutil.which(name)
    found = shutil.which(name, path=installed_path())
    # On Windows `which` searches the current directory first, whatever the path.
    return found if found is not None and os.path.isabs(found) else None
