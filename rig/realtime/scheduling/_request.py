"""Request of a run for scheduling by the system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


class RealtimeRequest(Protocol):
    """Fields of the request; `rig.config._sections.Host` explains each."""

    @property
    def realtime(self) -> str:
        """Return the request: ``enforce``, ``try`` or ``off``."""
        ...

    @property
    def priority(self) -> int:
        """Return the requested priority under SCHED_FIFO, 1 to 99."""
        ...

    @property
    def cpu(self) -> int | None:
        """Return the processor, None for any."""
        ...


@dataclass(frozen=True, slots=True)
class BoardScheduling:
    """Scheduling of what is a device here: a board's timer never waits, so it has priority over any host's loop."""

    realtime: str = "try"
    priority: int = 90
    cpu: int | None = None
