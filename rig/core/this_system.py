"""List the processors that this process may use, and refuse real time on systems other than Linux.

Devices, experiments and the bridge of drives (firmware on this computer in front of a drive) call it before they run in
real time. It must not set anything up; `rig.realtime.scheduling` does.
"""

import os
import sys

from rig.core.errors import PlanError


def processors() -> list[int]:
    """Return the numbers of the processors that this process may use, in ascending order."""
    if sys.platform == "linux":
        return sorted(os.sched_getaffinity(0))
    else:
        return list(range(os.cpu_count() or 1))


ON_THE_BOARD = 'let the board run the law: set controller.loop = "device"'


def refuse_real_time(what: str, remedy: str = ON_THE_BOARD) -> None:
    """Raise `PlanError` if this computer does not run Linux, which a loop in real time needs.

    `what` would run in real time (subject of the message); `remedy` says what to do instead.
    """
    if sys.platform != "linux":
        raise PlanError(f"{what} needs Linux to run in real time", remedy=remedy)
