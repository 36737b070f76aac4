"""Facilities of this operating system for a process, and what it does not support.

Devices, experiments and the bridge of drives call it before they run in real time. It must not set anything up;
`rig.realtime.scheduling` does.
"""

from __future__ import annotations

import os
import sys

from rig.core.errors import PlanError


def processors() -> list[int]:
    """Return the numbers of those that this process may use."""
    if sys.platform == "linux":
        return sorted(os.sched_getaffinity(0))
    else:
        return list(range(os.cpu_count() or 1))


ON_THE_BOARD = 'let the board run the law: set controller.loop = "device"'


def refuse_real_time(what: str, remedy: str = ON_THE_BOARD) -> None:
    """Raise `PlanError` where something would have to keep time on this computer and it runs no Linux.

    Parameters
    ----------
    what
        That would, as the subject of a sentence.
    remedy
        Instruction on what to do instead.
    """
    if sys.platform != "linux":
        raise PlanError(f"{what} needs Linux to run in real time", remedy=remedy)
