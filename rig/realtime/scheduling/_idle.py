"""Keep processors from deep sleep: waking from it takes 0.1 ms and more.

The kernel keeps a request for as long as the descriptor it was written to is open, and obeys the smallest.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

from rig.realtime.scheduling.facts import ROOT

LATENCY_US = 0
DEVICE = "dev/cpu_dma_latency"


def hold(root: Path = ROOT) -> int:
    """Ask for `LATENCY_US` and return the descriptor that holds the request; raises `OSError`."""
    descriptor = os.open(root / DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", LATENCY_US))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
