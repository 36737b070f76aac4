"""What a process of this package's own finds around it."""

from __future__ import annotations

import os
from collections.abc import Container
from pathlib import Path


def with_this_package(without: Container[str] = ()) -> dict[str, str]:
    """The environment of a child that imports this package from where this process has it.

    Parameters
    ----------
    without
        Names of variables that are not handed on.
    """
    found = {name: value for name, value in os.environ.items() if name not in without}
    paths = (str(Path(__file__).parents[2]), found.get("PYTHONPATH", ""))
    return {**found, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}
