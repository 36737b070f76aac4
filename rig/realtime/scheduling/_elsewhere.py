"""Replace `_realtime` on systems other than Linux: no scheduling is requested; real-time laws run on the board."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rig.core.errors import RealtimeError
from rig.realtime.scheduling._request import RealtimeRequest

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Realtime:
    """Result of a request for real-time scheduling on systems other than Linux, where nothing is requested."""

    def __init__(self, host: RealtimeRequest, *, virtual: bool) -> None:
        self.messages: list[str] = []
        asked = {"realtime": host.realtime, "priority": host.priority, "cpu": host.cpu}
        self.report: dict[str, Any] = (
            {} if virtual else {"asked": asked, "refusals": [], "machine": {"kernel": platform.platform()}}
        )

    def enter_thread(self) -> None:
        """Do nothing: on this system the calling thread keeps its scheduling."""

    def leave_thread(self) -> None:
        """Do nothing: on this system the scheduling of a thread is never changed."""

    def prefault(self, *arrays: NDArray[Any]) -> None:
        """Do nothing: on this system memory pages of arrays are loaded when they are first used."""


@contextmanager
def obtained(host: RealtimeRequest, *, virtual: bool = False) -> Iterator[Realtime]:
    """Yield a `Realtime` object without requesting real-time scheduling, on systems other than Linux.

    Raise `RealtimeError` if ``realtime = "enforce"`` is set, which needs Linux.
    """
    if host.realtime == "enforce" and not virtual:
        raise RealtimeError(
            'host.realtime = "enforce" needs Linux: this system has no real-time scheduling',
            remedy='set host.realtime = "try": the run then starts without real-time scheduling. With controller.loop '
            '= "device" the control law runs on the board, and the board\'s timer sets its timing',
        )
    yield Realtime(host, virtual=virtual)
