"""Request real-time scheduling for the loop, report what was granted, and undo it afterwards.

    with obtained(experiment.host) as realtime:  # for the process: lock memory, prevent deep sleep, test the rights
        ...
        realtime.enter_thread()                  # in the loop's own thread: policy, processor, stack

The loop, trials, `rig.doctor`, `rig serve rig` and the simulated drives use it. It must not load numba. Nothing that
was granted may remain after the context ends. On systems other than Linux nothing is requested.
"""

import sys

from rig.realtime.scheduling._request import BoardScheduling, RealtimeRequest
from rig.realtime.scheduling._rights import Rights

if sys.platform == "linux":
    from rig.realtime.scheduling._idle import DEVICE as IDLE_DEVICE
    from rig.realtime.scheduling._realtime import Realtime, obtained
    from rig.realtime.scheduling._rights import name_of_group
    from rig.realtime.scheduling._thread import ThreadState, tried
else:
    from rig.realtime.scheduling._elsewhere import Realtime, obtained

__all__ = ["BoardScheduling", "Realtime", "RealtimeRequest", "Rights", "obtained"]
if sys.platform == "linux":  # for the doctor
    __all__ += ["IDLE_DEVICE", "ThreadState", "name_of_group", "tried"]
