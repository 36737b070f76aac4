"""Keep idle processors from deep sleep, because waking from deep sleep takes 0.1 ms and more.

`_realtime` uses it. It must not change a setting that remains after the process ends.
"""

import os
import struct
from pathlib import Path

from rig.realtime.scheduling.facts import ROOT

LATENCY_US = 0
DEVICE = "dev/cpu_dma_latency"


def hold(root: Path = ROOT) -> int:
    """Keep idle processors from deep sleep until the returned descriptor is closed; raise `OSError` if not allowed."""
    # The kernel applies the smallest latency that any open descriptor of this device requests.
    descriptor = os.open(root / DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", LATENCY_US))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
