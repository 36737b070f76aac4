"""Functions of a link that the compiled loop calls, as one group of arguments.

Links of `rig.devices` and of the simulation make it; kernels of `rig.loop` and the ping of `rig.doctor` take it. It
must not hold anything that compiled code cannot use.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from rig.realtime.clock import Clock
from rig.realtime.groups import Int, group, type_of
from rig.realtime.plugs import NowPlug, TransferPlug, WaitPlug


@group
class LoopPort(NamedTuple):
    """Plug functions (`rig.realtime.plugs`) and their handles.

    `read`, `write` and `wait` take `handle`; `now` and `sleep` are those of the link's clock and take `clock_handle`.
    """

    read: TransferPlug
    write: TransferPlug
    wait: WaitPlug
    handle: Int
    now: NowPlug
    sleep: WaitPlug
    clock_handle: Int

    @classmethod
    def on(cls, clock: Clock, *, read: Any, write: Any, wait: Any, handle: int) -> LoopPort:
        """Return a port from the functions of a link and from its clock."""
        return cls(
            read=read,
            write=write,
            wait=wait,
            handle=handle,
            now=clock.now_plug,
            sleep=clock.sleep_plug,
            clock_handle=clock.handle,
        )


PORT_TYPE = type_of(LoopPort)
