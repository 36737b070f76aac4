"""The imports and kernels of the process from which devices and hosts are forked.

Otherwise each child would load the same machine code: a third of a second, for a life of a tenth.
"""

import threading

from sim_backend.board.device import SimulatedDevice
from sim_backend.ends.line import PseudoTerminal
from sim_backend.ends.real_time import RealTime
from tests.conformance import far_end  # noqa: F401
from tests.conformance.rigs import rotary_rig

with PseudoTerminal() as port:
    RealTime(SimulatedDevice(rotary_rig()), port, threading.Event()).run(0.0)
