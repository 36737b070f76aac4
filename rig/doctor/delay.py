"""A delay in ticks of the loop, in which theory takes it."""

from __future__ import annotations

import math


def ticks_late(late_s: float, rate: float, pacing: str = "device") -> int:
    """Ticks from a sample to its command, which is so late (s), at a rate (Hz): one at least in real time.

    A command that arrives in the course of a tick is active from the next one on, hence whole ticks. A loop that the
    host paces lets a sample wait for its own tick, one more at most.
    """
    return max(1, math.ceil(late_s * rate - 1e-9)) + (1 if pacing == "host" else 0)


def ticks_text(number: int) -> str:
    """``1 tick``, ``2 ticks``."""
    return f"{number} tick{'' if number == 1 else 's'}"
