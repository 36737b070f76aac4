"""A new wall for a law that runs on the device: how it comes in force there, and here at the same sample.

Python turns a posted set into a *letter* (`letter_of`) for the loop, which owns the link: the set for the host's law,
and the same wall as parameters of the device. The loop sends them as SET_BEGIN, SET_CHUNKs and SET_COMMIT, waits for
each answer, repeats what is not answered, and begins again when the device finds the handle inside a wall. Its last
answer names the sample from which the new wall counts: exactly from there the host's law has it too. So, while a
SET_COMMIT is on its way, samples wait.

The newest letter counts: one that waits for free space is replaced, one that is being sent is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.faults import Status
from firmware_protocol.parameters import ENTRY_BYTES
from firmware_protocol.transaction import RETRY_AFTER_S
from rig.control.step import CONTROL_TYPE
from rig.core.errors import ConfigError
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop.layout import BUFFERS_TYPE, FLOATS, SETTINGS_TYPE, Buffers
from rig.loop.parameters import inside
from rig.loop.supervision import (
    BLOCK_BYTES,
    SUPERVISION_BUFFERS_TYPE,
    SUPERVISION_TYPE,
    SupervisionBuffers,
)
from rig.realtime import codec
from rig.realtime.codec import ACK, SET_BEGIN, SET_CHUNK
from rig.realtime.kernel import kernel
from rig.realtime.mailbox import SET_FLOATS, take

# Steps of the conversation.
IDLE = 0
WAITING = 1  # for free space
BEGUN = 2
CHUNKS = 3
COMMITTED = 4  # sent, not yet answered
GRANTED = 5  # in force from the sample `change_at` on

# A letter: number of the set, bytes of the block, the block in numbers of six bytes, then wall position and the law's
# parameters.
NUMBER, LENGTH, ENTRIES = 0, 1, 2
ENTRY = ENTRY_BYTES  # bytes that one float64 holds exactly
VALUES = ENTRIES + BLOCK_BYTES // ENTRY

_OK, _INSIDE_WALL = int(Status.OK), int(Status.INSIDE_WALL)
_BEGIN_TYPE, _CHUNK_TYPE, _COMMIT_TYPE = codec.SET_BEGIN_TYPE, codec.SET_CHUNK_TYPE, codec.SET_COMMIT_TYPE
_CHUNK_BYTES = codec.CHUNK_BYTES
AGAIN_NS = 2_000_000  # after the device found the handle inside a wall
_FIRST_RETRY_NS, _LAST_RETRY_NS = (round(RETRY_AFTER_S[i] * 1e9) for i in (0, -1))


def letter_of(number: int, block: bytes, values: Sequence[float]) -> NDArray[np.float64]:
    """Make a letter: the number of a set, its block of live parameters, and what the host's law takes of it.

    Raises `ConfigError` for more than a letter holds.
    """
    letter = np.zeros(VALUES + len(values))
    if len(block) > BLOCK_BYTES or len(letter) > SET_FLOATS:
        raise ConfigError(
            f"a wall of {len(block) // ENTRY} parameters on the device and {len(values)} here is too much for a "
            "running loop",
            remedy="use a law with fewer parameters",
        )
    letter[NUMBER], letter[LENGTH] = number, len(block)
    for i in range(0, len(block), ENTRY):
        letter[ENTRIES + i // ENTRY] = int.from_bytes(block[i : i + ENTRY], "little")
    letter[VALUES:] = values
    return letter


@kernel(types.void(types.uintp, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE))
def _open_letter(mailbox: int, buffers: Buffers, supervised: SupervisionBuffers) -> None:
    """Take the newest letter, if there is one, unless more sets than a replay can hold were in force already."""
    v, p = supervised.supervision[0], buffers.progress[0]
    letter, block = supervised.letter, supervised.block
    if p["sets"] == len(buffers.sets) or take(mailbox, letter) == 0:
        return
    p["waiting_set"] = np.int64(letter[NUMBER])
    v["length"] = np.int64(letter[LENGTH])
    for i in range(v["length"]):
        block[i] = (np.int64(letter[ENTRIES + i // ENTRY]) >> (8 * (i % ENTRY))) & 0xFF
    for i in range(len(letter) - VALUES):
        buffers.waiting[i] = letter[VALUES + i]
    v["step"] = WAITING


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE))
def _encode(settings: Any, buffers: Buffers, supervised: SupervisionBuffers) -> int:
    """Frame of the step at which the conversation is, in `buffers.transmit`."""
    v, session = supervised.supervision[0], settings[0]["session"]
    request, block, transmit = supervised.request, supervised.block, buffers.transmit
    request[SET_BEGIN.nonce] = v["nonce"]
    if v["step"] == BEGUN:
        request[SET_BEGIN.length] = v["length"]
        request[SET_BEGIN.crc] = codec.crc32(block, 0, v["length"], 0)
        return int(codec.encode_set_begin(session, v["nonce"], request, transmit))
    if v["step"] == CHUNKS:
        request[SET_CHUNK.offset] = v["offset"]
        stop = min(v["offset"] + _CHUNK_BYTES, v["length"])
        return int(codec.encode_set_chunk(session, v["nonce"], request, block, v["offset"], stop, transmit))
    return int(codec.encode_set_commit(session, v["nonce"], request, transmit))


@kernel(types.boolean(CONTROL_TYPE, FLOATS, SUPERVISION_TYPE, types.int64))
def _may_begin(control: Any, waiting: Any, supervision: Any, time_ns: int) -> bool:
    """Whether the handle was outside both walls in the newest sample; the device judges by its own."""
    v = supervision[0]
    if v["started"] == 0 or time_ns < v["not_before"]:
        return False
    return not (
        inside(control, control[0]["wall_position"], v["count"]) or inside(control, waiting[0], v["count"])
    )


@kernel(
    types.int64(PORT_TYPE, types.uintp, CONTROL_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE)
)
def converse(
    port: LoopPort,
    mailbox: int,
    control: Any,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
) -> int:
    """Say what is due of the conversation: 0, or the negative errno of a broken link.

    `mailbox` is the address of that in which letters come, or 0 for a loop without one; `control` is what the host's
    law has in force.
    """
    v, p = supervised.supervision[0], buffers.progress[0]
    if mailbox == 0:
        return 0
    if v["step"] <= WAITING:
        _open_letter(mailbox, buffers, supervised)
    if v["step"] == IDLE or v["step"] == GRANTED:
        return 0
    time_ns = port.now(port.clock_handle)
    if v["step"] == WAITING:
        if not _may_begin(control, buffers.waiting, supervised.supervision, time_ns):
            return 0
        p["nonce"] = (p["nonce"] + 1) % 65536
        p["asking"] = 0  # a clock exchange that was on its way is given up: its answer has another nonce
        v["nonce"] = p["nonce"]
        v["offset"] = 0
        v["step"] = BEGUN
        v["tries"] = 0
    elif v["tries"] > 0 and time_ns - v["sent_at"] < min(
        _FIRST_RETRY_NS << min(v["tries"] - 1, 8), _LAST_RETRY_NS
    ):
        return 0
    size = _encode(settings, buffers, supervised)
    v["sent_at"] = time_ns
    v["tries"] += 1
    if size < 0:
        return 0
    return int(min(port.write(port.handle, np.int64(buffers.transmit.ctypes.data), size), 0))


@kernel(types.int64(BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE))
def take_answer(buffers: Buffers, supervised: SupervisionBuffers) -> int:
    """Go on with the conversation if an ACK is the answer to what was said last; return 1 then, else 0."""
    v, p, ack = supervised.supervision[0], buffers.progress[0], supervised.ack
    step, request, status = v["step"], ack[ACK.request], ack[ACK.status]
    expected = _BEGIN_TYPE if step == BEGUN else _CHUNK_TYPE if step == CHUNKS else _COMMIT_TYPE
    if step < BEGUN or step > COMMITTED or ack[ACK.nonce] != v["nonce"] or request != expected:
        return 0
    if step == CHUNKS and status == _OK and ack[ACK.detail] != v["offset"]:
        return 0  # to the chunk before, which was sent twice
    v["tries"] = 0
    if status == _INSIDE_WALL:
        v["step"] = WAITING
        v["inside"] += 1
        v["not_before"] = p["read_at"] + AGAIN_NS
    elif status != _OK:
        v["step"] = IDLE
        v["refused_set"] = p["waiting_set"]
        v["refused_status"] = status
        v["refused_detail"] = ack[ACK.detail]
        p["waiting_set"] = 0
    elif step == BEGUN:
        v["step"] = CHUNKS
    elif step == CHUNKS:
        v["offset"] += _CHUNK_BYTES
        if v["offset"] >= v["length"]:
            v["step"] = COMMITTED
    else:
        v["step"] = GRANTED
        v["parameters_crc"] = ack[ACK.crc]
        distance = (ack[ACK.sample_index] - v["index"] + (1 << 31)) % (1 << 32) - (1 << 31)
        v["change_at"] = v["index"] + distance
    return 1
