"""Memory that only the loop for a law on the device needs, in addition to the memory in `rig.loop.layout`.

All files of that loop share it. It must not be allocated while the loop runs.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.loop.layout import RECEIVE_BYTES
from rig.realtime import codec
from rig.realtime.codec import ACK, BATCH, SAMPLE, SET_BEGIN, STATE
from rig.realtime.groups import Bytes, Floats, IntRows, Ints, group, type_of
from rig.realtime.mailbox import MOST_BYTES

# One row: how far the streams have come, the transaction of a parameter update, and the device–host agreement.
SUPERVISION = np.dtype(
    [
        ("started", "<i8"),  # 1 once a sample has come
        ("index", "<i8"),  # newest sample in the queue, extended to 64 bits
        ("time", "<i8"),  # its device time (device ticks), extended likewise
        ("clock_error", "<i8"),  # of the samples: device's clock ahead of their index (device ticks)
        ("count", "<i8"),
        ("batch_sequence", "<i8"),  # of the newest BATCH
        ("missed_first", "<i8"),  # samples before the first one that came, as far as the frames tell
        ("head", "<i8"),  # samples put into the queue so far
        ("tail", "<i8"),  # samples taken out of it
        ("heard", "<i8"),  # 1 once a STATE has come
        ("states_head", "<i8"),
        ("states_tail", "<i8"),
        ("next_command", "<i8"),  # when the next keep-alive is due (ns)
        ("stop_sequence", "<i8"),  # of the first STOP; -1 before it
        ("done_at", "<i8"),  # sample at which the device's law had ended, -1 while it runs
        ("ticks", "<i8"),  # steps of the law so far
        # a new wall on its way to the device (rig.loop._parameter_update); its transaction is that of firmware_protocol
        ("step", "<i8"),
        ("nonce", "<i8"),
        ("length", "<i8"),
        ("request", "<i8"),
        ("offset", "<i8"),
        ("tries", "<i8"),
        ("again_at", "<i8"),
        ("not_before", "<i8"),  # host time before which it is not tried again (ns)
        ("change_at", "<i8"),  # sample from which the new wall counts
        ("inside", "<i8"),  # times that the device found the handle inside a wall
        ("refused_set", "<i8"),  # newest set that the device refused finally, 0 for none
        ("refused_status", "<i8"),
        ("refused_detail", "<i8"),
        ("parameters_crc", "<i8"),  # of the device's whole block after the last change, -1 before one
        # comparison of the device's current with the host law's (rig.loop._device_host_agreement)
        ("sent", "<i8"),  # current of the law in the last row
        ("comparable", "<i8"),  # 1 when the next sample shows what the device computed
        ("forgetting", "<i8"),  # ticks until a gap is forgotten
        ("limits_before", "<i8"),  # limits in the last STATE
        ("compared", "<i8"),
        ("differing", "<i8"),
        ("beyond", "<i8"),
        ("greatest", "<i8"),
        ("excluded", "<i8"),
        ("open_compared", "<i8"),  # since the last STATE: not yet known whether a limit acted
        ("open_differing", "<i8"),
        ("open_beyond", "<i8"),
        ("open_greatest", "<i8"),
    ],
    align=True,
)
SUPERVISION_TYPE = types.Array(numba.from_dtype(SUPERVISION), 1, "C")

# Columns of the queue of samples.
INDEX, TIME, COUNT, CURRENT, MEASURED, RECEIVED, LATE = range(7)
SAMPLE_COLUMNS = 7
# Most samples that one reading of the link can bring: a sample has at least 3 bytes.
SAMPLES_A_READING = RECEIVE_BYTES // 3 + codec.MOST_SAMPLES
# 80 ms at 50 kHz and more: the time that samples may wait for the reply about a new wall.
QUEUE = 4 * SAMPLES_A_READING
STATES_KEPT = 16  # 80 ms of them
CONTIGUOUS = len(STATE)  # column behind the fields of a STATE: 1 when none is missing before it

# Bytes of an update: head, block, the values of the host's law.
HEAD_NUMBER, HEAD_LENGTH = 0, 1  # int64: of the set, and of the block (bytes)
BLOCK_AT, BLOCK_BYTES = 16, 96  # of a block of live parameters, six bytes each
VALUES_AT = BLOCK_AT + BLOCK_BYTES


@group
class SupervisionBuffers(NamedTuple):
    """Memory of the loop for a law on the device, in addition to the ring and to `rig.loop.layout.Buffers`.

    Attributes
    ----------
    supervision
        State of the loop, an array of length 1 with the fields of `SUPERVISION`.
    batch, decoded
        Fields and samples of the BATCH message that was received last.
    samples
        Queue of samples for the law, oldest first.
    states
        Queue of STATEs whose sample has not been processed yet.
    newest
        Newest STATE; its sample may not have been processed yet.
    ack, request
        Fields of the ACK that was received last, and of a request to send.
    update, update_head, update_block, update_values
        Bytes of the newest parameter update (`rig.loop._parameter_update`), and views of their three parts: head,
        parameter block for the device, values for the host's law.
    """

    supervision: Annotated[NDArray[np.void], SUPERVISION_TYPE]
    batch: Ints
    decoded: IntRows
    samples: IntRows
    states: IntRows
    newest: Ints
    ack: Ints
    request: Ints
    update: Bytes
    update_head: Ints
    update_block: Bytes
    update_values: Floats

    @classmethod
    def allocate(cls) -> SupervisionBuffers:
        """Return new buffers with initial values; the caller must do this before the loop starts."""
        supervision, update = np.zeros(1, SUPERVISION), np.zeros(MOST_BYTES, np.uint8)
        for name in ("stop_sequence", "done_at", "parameters_crc"):
            supervision[name] = -1
        return cls(
            supervision=supervision,
            batch=np.zeros(len(BATCH), np.int64),
            decoded=np.zeros((codec.MOST_SAMPLES, len(SAMPLE)), np.int64),
            samples=np.zeros((QUEUE, SAMPLE_COLUMNS), np.int64),
            states=np.zeros((STATES_KEPT, len(STATE) + 1), np.int64),
            newest=np.zeros(len(STATE), np.int64),
            ack=np.zeros(len(ACK), np.int64),
            request=np.zeros(len(SET_BEGIN), np.int64),
            update=update,
            update_head=update[:BLOCK_AT].view(np.int64),
            update_block=update[BLOCK_AT:VALUES_AT],
            update_values=update[VALUES_AT:].view(np.float64),
        )


SUPERVISION_BUFFERS_TYPE = type_of(SupervisionBuffers)
