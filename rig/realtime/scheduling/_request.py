"""Request of a run for real-time scheduling."""

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
        """Return the number of the processor for the loop; None for any processor."""
        ...


@dataclass(frozen=True, slots=True)
class BoardScheduling:
    """Request of a simulated board: its timer must not wait, so its priority is above that of a host's loop."""

    realtime: str = "try"
    priority: int = 90
    cpu: int | None = None
