"""Simulate commercial drives: a moteus behind a serial port and an ODrive on a CAN bus, each with the simulated plant.

``python -m sim_backend.drives moteus --rig koul-rigid`` prints what a host opens and serves until it is ended;
`simulated_drive` does the same for a block of Python, in a process that dies with the one that started it. The tests
drive both with the makers' own libraries, unchanged; each module names the page that it mirrors.
"""

import sys

if sys.platform == "linux":
    from sim_backend.drives.process import simulated_drive

__all__ = ["simulated_drive"]
