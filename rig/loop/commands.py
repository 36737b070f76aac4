"""What a loop says to the device: one COMMAND."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from firmware_protocol import codec
from firmware_protocol.codec import COMMAND
from firmware_protocol.kernel import kernel
from firmware_protocol.messages import Mode
from rig.loop.layout import BYTES, INTS, PROGRESS_TYPE, SETTINGS_TYPE
from rig.plugs import TRANSFER

MODE_CURRENT, MODE_SUPERVISE, MODE_STOP = int(Mode.CURRENT), int(Mode.SUPERVISE), int(Mode.STOP)


@kernel(
    types.int64(TRANSFER, types.int64, SETTINGS_TYPE, PROGRESS_TYPE, INTS, BYTES, types.int64, types.int64)
)
def send_command(
    write: Any, link: int, settings: Any, progress: Any, command: Any, transmit: Any, mode: int, current: int
) -> int:
    """Send one COMMAND: 1 when the link took it whole, 0 when not, negative errno when the link is broken."""
    p = progress[0]
    command[COMMAND.state_sequence] = p["answers"]
    command[COMMAND.lifetime_us] = settings[0]["lifetime_us"]
    command[COMMAND.mode] = mode
    command[COMMAND.current] = current
    size = codec.encode_command(settings[0]["session"], p["sequence"], command, transmit)
    p["sequence"] = (p["sequence"] + 1) % 65536
    if size < 0:  # a value that no field of the wire holds: nothing leaves
        return 0
    sent = write(link, np.int64(transmit.ctypes.data), size)
    if sent < 0:
        return int(sent)
    return 1 if sent == size else 0
