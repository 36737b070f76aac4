"""Interface of `rig.loop` for trials: the threads of both loops, and the signals that stop them.

Only `rig.experiments.trials` imports it; it defines nothing, and no file of `rig.loop` imports it. Memory layout and
end reasons are in `rig.loop.layout`, which programs that display a run read without loading a loop.
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
