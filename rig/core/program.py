"""Settings at the start of each program of the package: the command line, and the processes that it starts.

`rig.__main__` and each process of the package call it first. It must not load anything beyond the standard library.
"""

import atexit
import gc
import os

OFTEN = 2_000  # new objects, which take below 1 ms
# New objects between two garbage collections: more than a command makes before it ends.
SELDOM = 300_000


def begin() -> None:
    """Set up the garbage collector and the matplotlib backend, before other modules are loaded."""
    # A notebook's backend in MPLBACKEND would keep matplotlib from loading where that notebook is not installed.
    os.environ["MPLBACKEND"] = "agg"
    # Loaded modules live as long as the program: to collect them after each 700 new objects, and at the end, took a
    # fifth of the 0.67 s of `rig experiment plan`.
    gc.set_threshold(SELDOM)
    atexit.register(gc.freeze)


def stay() -> None:
    """Make garbage collections frequent and short, so that a server that runs for hours answers without delay."""
    # With SELDOM, a flood of connections made collections of 30 to 135 ms, for which STOP had to wait.
    gc.collect()
    gc.freeze()
    gc.set_threshold(OFTEN)
