"""Functions of a link and its clock that the compiled loop calls, as one argument.

Links of `rig.devices` and of the simulation create it; kernels of `rig.loop` and the round-trip measurement of
`rig.doctor` use it. It must not hold anything that compiled code cannot use.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from rig.realtime.clock import Clock
from rig.realtime.groups import Int, group, type_of
from rig.realtime.plugs import NowPlug, TransferPlug, WaitPlug


@group
class LoopPort(NamedTuple):
    """Compiled functions of a link (`read`, `write`, `wait`) and of its clock (`now`, `sleep`), as one argument.

    `handle` is the first argument of `read`, `write` and `wait`, `clock_handle` that of `now` and `sleep`.
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
        """Return the loop's functions for a link: its read, write and wait functions, and those of its clock."""
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
