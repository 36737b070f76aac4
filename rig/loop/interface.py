"""Interface of the room for a trial: a loop in its thread, supervised or not, and the signals that stop it.

`rig.experiments.trials` alone imports it; it defines nothing, and no file of the room imports it. What a row and an end
consist of is in `rig.loop.layout`, which followers of a run read without loading a loop.
"""

from rig.loop._exchange import EVERY_NS
from rig.loop._run import LoopEnd, LoopSettings, LoopThread
from rig.loop._signals import Signals, stop_on_signals
from rig.loop._supervised import BOUNDS, NO_BOUND, SupervisedThread

__all__ = [
    "BOUNDS",
    "EVERY_NS",
    "NO_BOUND",
    "LoopEnd",
    "LoopSettings",
    "LoopThread",
    "Signals",
    "SupervisedThread",
    "stop_on_signals",
]
