"""Simulate commercial drives: a moteus behind a serial port and an ODrive on a CAN bus, each with the simulated rig.

``python -m sim_backend.drives moteus --rig koul-rigid`` prints the port that a host opens, and serves it until a signal
ends the program; `simulated_drive` does the same within a ``with`` block, in a child process that ends with its parent.
The tests use both drives through the makers' own libraries, unchanged; each module names the page of the maker that it
follows.
"""

import sys

if sys.platform == "linux":
    from sim_backend.drives.process import simulated_drive

__all__ = ["simulated_drive"]
