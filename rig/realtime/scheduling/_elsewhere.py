"""Scheduling where the system is not Linux: none. A law in real time runs on a board there, which needs none."""

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
    """Request of a run on other systems: nothing is refused, because nothing is requested of the system."""

    def __init__(self, host: RealtimeRequest, *, virtual: bool) -> None:
        self.messages: list[str] = []
        asked = {"realtime": host.realtime, "priority": host.priority, "cpu": host.cpu}
        self.report: dict[str, Any] = (
            {} if virtual else {"asked": asked, "refusals": [], "machine": {"kernel": platform.platform()}}
        )

    def enter_thread(self) -> None:
        """Leave the calling thread as it is."""

    def leave_thread(self) -> None:
        """Do nothing: no scheduling was changed."""

    def prefault(self, *arrays: NDArray[Any]) -> None:
        """Leave pages to their first use."""


@contextmanager
def obtained(host: RealtimeRequest, *, virtual: bool = False) -> Iterator[Realtime]:
    """As on Linux (`rig.realtime.scheduling._realtime.obtained`), with nothing obtained.

    Raises
    ------
    RealtimeError
        ``realtime = "enforce"``.
    """
    if host.realtime == "enforce" and not virtual:
        raise RealtimeError(
            'host.realtime = "enforce" needs Linux: this system has no real-time scheduling',
            remedy='set host.realtime = "try": with the law on the board, the board\'s timer sets the timing',
        )
    yield Realtime(host, virtual=virtual)
