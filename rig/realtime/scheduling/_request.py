"""Fields by which a run requests real-time scheduling.

`rig.config` and simulated devices fill them in. It must not import `rig.config`.
"""

from dataclasses import dataclass
from typing import Protocol


class RealtimeRequest(Protocol):
    """Interface of a request for real-time scheduling: how strictly, at which priority, on which processor."""

    @property
    def realtime(self) -> str:
        """Return how strictly real-time scheduling is requested: "enforce" (a refusal is an error), "try" or "off"."""
        ...

    @property
    def priority(self) -> int:
        """Return the requested priority of the loop's thread under SCHED_FIFO, 1 to 99."""
        ...

    @property
    def cpu(self) -> int | None:
        """Return the number of the processor on which the loop must run; None for any processor."""
        ...


@dataclass(frozen=True, slots=True)
class BoardScheduling:
    """Request of a simulated board. Its priority exceeds that of a host's loop: the board's timer must not wait."""

    realtime: str = "try"
    priority: int = 90
    cpu: int | None = None
