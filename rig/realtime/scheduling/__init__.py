"""Real-time scheduling for the loop: requested, reported as obtained, undone afterwards.

    with obtained(experiment.host) as realtime:  # the process: memory, idle states; and what the thread may have
        ...
        realtime.enter_thread()                  # in the loop's own thread: policy, processor, stack

* `realtime`: the context and what it reports
* `memory`, `idle`: locked pages, and processors kept from deep sleep; of the process, counted
* `thread`: policy, processor and timer slack of the calling thread, and its stack
* `rights`, `refusals`: what this process may do, and what would get it granted
* `facts`: what the kernel reports about itself
* `calls`: the C library

Nothing here loads numba. Off Linux nothing is asked for (`elsewhere`).

The loop, trials, `rig.doctor`, `rig serve rig` and the simulated drives request it. It must not keep what it obtained
after the context ends.
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
