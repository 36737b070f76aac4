"""Send COMMAND messages, with which the host's loop sets the device's current or keeps a law on the device running.

Both loops call it. It must not wait for a link that accepts no bytes.
"""

from typing import Any

import numpy as np
from numba import types

from firmware_protocol.messages import Mode, Sync
from rig.control.step import MEMORY_TYPE
from rig.core.sample import Phase, RowFlag
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._currents import keep_command
from rig.loop.layout import BUFFERS_TYPE, SETTINGS_TYPE, Buffers
from rig.realtime import codec
from rig.realtime.codec import COMMAND, STATE
from rig.realtime.kernel import kernel

MODE_CURRENT, MODE_SUPERVISE, MODE_STOP = int(Mode.CURRENT), int(Mode.SUPERVISE), int(Mode.STOP)
NO_SYNC = 0
_TRIAL, _INSIDE = int(Sync.TRIAL), int(Sync.INSIDE)
_PHASE_TRIAL, _FLAG_INSIDE = int(Phase.TRIAL), int(RowFlag.INSIDE)


@kernel(types.int64(MEMORY_TYPE), inline=True)
def sync_of(memory: Any) -> int:
    """Return the levels of the sync outputs (bits of `Sync`) by the law: trial in progress, handle in the wall."""
    bits = NO_SYNC
    if memory[0]["phase"] == _PHASE_TRIAL:
        bits |= _TRIAL
    if memory[0]["flags"] & _FLAG_INSIDE:
        bits |= _INSIDE
    return bits


@kernel(
    types.int64(PORT_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, types.int64, types.int64, types.int64),
)
def send_command(port: LoopPort, settings: Any, buffers: Buffers, mode: int, current: int, sync: int) -> int:
    """Send a COMMAND message; return 1 if the link accepted all of it, else 0, or the broken link's negative errno.

    `mode` says who computes the current (`Mode`), `current` is the motor current (quanta), `sync` contains the levels
    of the sync outputs (bits of `Sync`).
    """
    p, command, transmit = buffers.progress[0], buffers.command, buffers.transmit
    command[COMMAND.state_sequence] = p["answers"]
    command[COMMAND.lifetime_us] = settings[0]["lifetime_us"]
    command[COMMAND.mode] = mode
    command[COMMAND.flags] = sync
    command[COMMAND.current] = current
    keep_command(buffers.sent, p["sequence"], current, buffers.state[STATE.sample_index])
    size = codec.encode_command(settings[0]["session"], p["sequence"], command, transmit)
    p["sequence"] = (p["sequence"] + 1) % 65536
    if size < 0:  # a value that no field of the wire holds: nothing leaves
        return 0
    sent = port.write(port.handle, np.int64(transmit.ctypes.data), size)
    if sent < 0:
        return int(sent)
    return 1 if sent == size else 0
