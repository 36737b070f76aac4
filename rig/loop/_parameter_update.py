"""Change the wall while the law runs on the device: the new wall becomes active on device and host at the same sample.

Python encodes a posted set (`update_of`) for the loop, which owns the link: the set for the host's law, and the same
wall as a parameter block of the device. The loop sends the block as a transaction (SET_BEGIN, SET_CHUNKs, SET_COMMIT;
see `firmware_protocol.transaction`), and repeats it when the device finds the handle inside a wall. The last reply
names the first sample with the new wall; the host's law waits for this reply. `rig.loop._supervise` and `_supervised`
call it. A wall must not change while the handle is inside.
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import types

from firmware_protocol import transaction
from firmware_protocol.faults import Status
from firmware_protocol.parameters import ENTRY_BYTES
from firmware_protocol.transaction import BEGIN, CHUNK, CHUNK_BYTES, COMMIT, DONE, ENDLESS, Transaction
from rig.control.step import CONTROL_TYPE
from rig.core.errors import ConfigError
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._parameters import inside
from rig.loop._supervision import (
    BLOCK_BYTES,
    HEAD_LENGTH,
    HEAD_NUMBER,
    SUPERVISION_BUFFERS_TYPE,
    SUPERVISION_TYPE,
    VALUES_AT,
    SupervisionBuffers,
)
from rig.loop.layout import BUFFERS_TYPE, FLOATS, SETTINGS_TYPE, Buffers
from rig.realtime import codec
from rig.realtime.codec import ACK, SET_BEGIN, SET_CHUNK
from rig.realtime.kernel import kernel
from rig.realtime.mailbox import MOST_BYTES, take

_i64 = types.int64
TRANSACTION = types.NamedUniTuple(_i64, len(Transaction._fields), Transaction)
# The host's side of a transaction, compiled: the very functions of `firmware_protocol.transaction`.
after_time = kernel(TRANSACTION(TRANSACTION, _i64, _i64))(transaction.after_time)
after_answer = kernel(TRANSACTION(TRANSACTION, _i64, _i64, _i64, _i64))(transaction.after_answer)

# Steps of an update.
IDLE = 0
WAITING = 1  # until the handle is in free space
UNDER_WAY = 2
COMMITTED = 3  # SET_COMMIT is due or sent, and not yet answered
GRANTED = 4  # active from the sample `change_at` on

_INSIDE_WALL = int(Status.INSIDE_WALL)
_HEAD = struct.Struct("<qq")  # head of an update: number of the set, size of the block (bytes)
AGAIN_NS = 2_000_000  # pause after the device has found the handle inside a wall


def update_of(number: int, block: bytes, values: Sequence[float]) -> bytes:
    """Return the bytes of an update: its number, parameter block for the device, and values for the host's law.

    Raise `ConfigError` if block or values are too long.
    """
    if len(block) > BLOCK_BYTES or VALUES_AT + 8 * len(values) > MOST_BYTES:
        raise ConfigError(
            f"a law with {len(block) // ENTRY_BYTES} parameters on the device (at most {BLOCK_BYTES // ENTRY_BYTES}) "
            f"and {len(values)} on the host (at most {(MOST_BYTES - VALUES_AT) // 8}) has too many for a running loop",
            remedy="use a law with fewer parameters",
        )
    head = _HEAD.pack(number, len(block)) + block.ljust(BLOCK_BYTES, b"\0")
    return head + struct.pack(f"<{len(values)}d", *values)


@kernel(types.void(types.uintp, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE))
def _take_update(mailbox: int, buffers: Buffers, supervised: SupervisionBuffers) -> None:
    """Take the newest update from the mailbox, unless this run has changed the wall `SETS_KEPT` (256) times already."""
    v, p, values = supervised.supervision[0], buffers.progress[0], supervised.update_values
    if p["sets"] == len(buffers.sets) or take(mailbox, supervised.update) == 0:
        return
    p["waiting_set"] = supervised.update_head[HEAD_NUMBER]
    v["length"] = supervised.update_head[HEAD_LENGTH]
    for i in range(len(values)):
        buffers.waiting[i] = values[i]
    v["step"] = WAITING


@kernel(TRANSACTION(SUPERVISION_TYPE))
def _transaction(supervision: Any) -> Transaction:
    v = supervision[0]
    return Transaction(v["nonce"], v["length"], v["request"], v["offset"], v["tries"], v["again_at"])


@kernel(types.void(SUPERVISION_TYPE, TRANSACTION))
def _remember(supervision: Any, t: Transaction) -> None:
    v = supervision[0]
    v["nonce"], v["length"], v["request"] = t.nonce, t.length, t.step
    v["offset"], v["tries"], v["again_at"] = t.offset, t.tries, t.again_at
    v["step"] = COMMITTED if t.step == COMMIT else UNDER_WAY


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, TRANSACTION))
def _encode(settings: Any, buffers: Buffers, supervised: SupervisionBuffers, t: Transaction) -> int:
    session, request, block = settings[0]["session"], supervised.request, supervised.update_block
    request[SET_BEGIN.nonce] = t.nonce
    if t.step == BEGIN:
        request[SET_BEGIN.length] = t.length
        request[SET_BEGIN.crc] = codec.crc32(block, 0, t.length, 0)
        return int(codec.encode_set_begin(session, t.nonce, request, buffers.transmit))
    if t.step == CHUNK:
        request[SET_CHUNK.offset] = t.offset
        stop = min(t.offset + CHUNK_BYTES, t.length)
        return int(codec.encode_set_chunk(session, t.nonce, request, block, t.offset, stop, buffers.transmit))
    return int(codec.encode_set_commit(session, t.nonce, request, buffers.transmit))


@kernel(types.boolean(CONTROL_TYPE, FLOATS, SUPERVISION_TYPE, types.int64))
def _may_begin(control: Any, waiting: Any, supervision: Any, time_ns: int) -> bool:
    """Return True if the newest sample is outside the present and the new wall (`waiting`); the device checks too."""
    v = supervision[0]
    if v["started"] == 0 or time_ns < v["not_before"]:
        return False
    return not (
        inside(control, control[0]["wall_position"], v["count"]) or inside(control, waiting[0], v["count"])
    )


@kernel(
    types.int64(PORT_TYPE, types.uintp, CONTROL_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE)
)
def send_update(
    port: LoopPort,
    mailbox: int,
    control: Any,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
) -> int:
    """Send the next request of a parameter update if one is due; return 0, or the negative errno of a broken link.

    `mailbox` is the address of the mailbox, 0 for a loop without updates; `control` contains the host law's settings.
    """
    v, p = supervised.supervision[0], buffers.progress[0]
    if mailbox == 0:
        return 0
    # A newer update replaces one that waits for the handle to be in free space, but not one that is being sent.
    if v["step"] <= WAITING:
        _take_update(mailbox, buffers, supervised)
    if v["step"] == IDLE or v["step"] == GRANTED:
        return 0
    time_ns = port.now(port.clock_handle)
    if v["step"] == WAITING:
        if not _may_begin(control, buffers.waiting, supervised.supervision, time_ns):
            return 0
        p["nonce"] = (p["nonce"] + 1) % 65536
        p["asking"] = 0  # a pending clock exchange is given up: its answer has another nonce
        _remember(supervised.supervision, Transaction(p["nonce"], v["length"], BEGIN, 0, 0, 0))
    before = _transaction(supervised.supervision)
    t = after_time(before, time_ns, ENDLESS)
    if t.tries == before.tries:
        return 0
    _remember(supervised.supervision, t)
    size = _encode(settings, buffers, supervised, t)
    if size < 0:
        return 0
    return int(min(port.write(port.handle, np.int64(buffers.transmit.ctypes.data), size), 0))


@kernel(types.int64(BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE))
def take_answer(buffers: Buffers, supervised: SupervisionBuffers) -> int:
    """Continue the parameter update and return 1 if the received ACK replies to the last request; else return 0."""
    v, p, ack = supervised.supervision[0], buffers.progress[0], supervised.ack
    if v["step"] != UNDER_WAY and v["step"] != COMMITTED:
        return 0
    before, status = _transaction(supervised.supervision), ack[ACK.status]
    t = after_answer(before, ack[ACK.nonce], ack[ACK.request], status, ack[ACK.detail])
    if t.step == before.step and t.offset == before.offset:
        return 0
    _remember(supervised.supervision, t)
    if t.step == DONE:
        v["step"] = GRANTED
        v["parameters_crc"] = ack[ACK.crc]
        distance = (ack[ACK.sample_index] - v["index"] + (1 << 31)) % (1 << 32) - (1 << 31)
        v["change_at"] = v["index"] + distance
    elif status == _INSIDE_WALL:
        v["step"] = WAITING
        v["inside"] += 1
        v["not_before"] = p["read_at"] + AGAIN_NS
    elif t.step < 0:
        v["step"] = IDLE
        v["refused_set"] = p["waiting_set"]
        v["refused_status"] = status
        v["refused_detail"] = ack[ACK.detail]
        p["waiting_set"] = 0
    return 1
