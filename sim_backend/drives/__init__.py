"""Drives that people own, simulated: a moteus behind a serial port and an ODrive on a CAN bus, each with our plant.

``python -m sim_backend.drives moteus --rig koul-rigid`` prints what a host opens and serves until it is ended;
`simulated_drive` does the same for a block of Python, in a process that dies with the one that started it.

* A moteus is behind a pseudo-terminal, as its own serial port or as the maker's USB adapter (`fdcanusb`), or on a bus
  with CAN FD; an ODrive is on a CAN bus.
* A bus is an interface of SocketCAN, or a Unix socket that passes the same frames (`outlets`).

Each behaviour names the page of the maker's documentation that it mirrors, in the module that has it. The makers' own
libraries, unchanged, drive these drives in the tests. What goes wrong on command stands in `faults`.
"""

import sys

if sys.platform == "linux":
    from sim_backend.drives.process import simulated_drive

__all__ = ["simulated_drive"]
