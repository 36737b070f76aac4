"""Keep processors from deep sleep, because waking from it takes 0.1 ms and more.

The kernel applies the smallest requested latency of all open descriptors.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

from rig.realtime.scheduling.facts import ROOT

LATENCY_US = 0
DEVICE = "dev/cpu_dma_latency"


def hold(root: Path = ROOT) -> int:
    """Request a latency of `LATENCY_US`; return the descriptor, which must stay open to hold it. Raises `OSError`."""
    descriptor = os.open(root / DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", LATENCY_US))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
