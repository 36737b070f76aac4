"""Clock exchanges one after another, as one compiled function without the GIL: how long a link takes there and back.

It uses the plug points of the loop (`rig.realtime.plugs`), its codec and its way of waiting, so that what it measures
is what the loop will meet: the same system calls, the same scheduling, the STATE frames of the device in between.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np
from numba import types

from rig.loop.frames import NO_FRAME, keep_rest, next_frame
from rig.realtime import codec
from rig.realtime.codec import GET_TIME, HEAD, STATE, TIME
from rig.realtime.kernel import kernel
from rig.realtime.plugs import NOW, TRANSFER, WAIT

RECEIVE_BYTES = 4096
RETRY_FULL_NS = 1_000_000  # pause when the line takes no more bytes
MOST_READS = 16  # of a full buffer before the clock is looked at again

# Places in the tally.
_NAMES = (
    "filled",  # bytes of an unfinished frame at the front of the receive buffer
    "session",  # of the headers that are sent
    "sequence",
    "nonce",
    "last_sent",  # host time (ns), 0 before the first
    "sent",
    "answered",
    "lost",  # no answer within the time-out
    "late",  # an answer that came after its time-out
    "unsent",  # the line took no more bytes
    "bad_frames",
    "states",
    "state_sequence",  # of the newest STATE, -1 before the first
    "bytes_out",
    "bytes_in",
)
TALLY: Any = namedtuple("TallyFields", _NAMES)(*range(len(_NAMES)))

# Columns of an exchange: the four stamps, the host's in ns, the device's in its own units.
EXCHANGE: Any = namedtuple(
    "ExchangeFields", ("host_sent", "device_received", "device_sent", "host_received")
)(*range(4))

_INTS, _BYTES = types.int64[::1], types.uint8[::1]
_TABLE = types.int64[:, ::1]
_NONCES = 1 << 16


@kernel(types.int64(_BYTES, types.int64, _INTS, _INTS, _INTS))
def _take(raw: Any, length: int, header: Any, values: Any, tally: Any) -> int:
    """Look at one frame: 1 when it is the answer to the newest question, whose fields are then in `values`."""
    if codec.decode_time(raw, length, header, values) == 0:
        if values[TIME.nonce] == tally[TALLY.nonce] and values[TIME.host_sent] == tally[TALLY.last_sent]:
            return 1
        tally[TALLY.late] += 1
    elif codec.decode_state(raw, length, header, values) == 0:
        tally[TALLY.states] += 1
        tally[TALLY.state_sequence] = header[HEAD.sequence]
    return 0


@kernel(types.int64(TRANSFER, types.int64, _BYTES, _BYTES, _INTS, _INTS, _INTS, _INTS))
def _gather(
    read: Any, link: int, received: Any, raw: Any, header: Any, values: Any, answer: Any, tally: Any
) -> int:
    """Read what is there and look at its frames: 1 when the answer came (into `answer`), 0, or negative errno."""
    came = 0
    got = np.int64(1)
    for _ in range(MOST_READS):  # a far end that never pauses must not keep us here
        if got <= 0:
            break
        filled = tally[TALLY.filled]
        got = read(link, np.int64(received.ctypes.data) + filled, np.int64(RECEIVE_BYTES - filled))
        if got < 0:
            return int(got)
        tally[TALLY.bytes_in] += got
        end = filled + got
        start = 0
        while True:
            length, start = next_frame(received, start, end, raw)
            if length == NO_FRAME:
                break
            if length < 0:
                tally[TALLY.bad_frames] += 1
            elif _take(raw, length, header, values, tally) == 1:
                came = 1
                for i in range(len(answer)):
                    answer[i] = values[i]
        rest = keep_rest(received, start, end)
        if rest < 0:
            tally[TALLY.bad_frames] += 1
        tally[TALLY.filled] = max(rest, 0)
    return came


@kernel(
    types.int64(
        TRANSFER, WAIT, NOW, types.int64, types.int64, types.int64, types.int64,
        _BYTES, _BYTES, _INTS, _INTS, _INTS, _INTS,
    )
)  # fmt: skip
def _listen(
    read: Any, wait: Any, now: Any, link: int, clock: int, until_ns: int, for_answer: int,
    received: Any, raw: Any, header: Any, values: Any, answer: Any, tally: Any,
) -> int:  # fmt: skip
    """Take what comes until a moment, or until the answer is there if one is waited for: 1 if it came, 0, or -errno."""
    while now(clock) < until_ns:
        ready = wait(link, until_ns)
        if ready > 0:
            ready = _gather(read, link, received, raw, header, values, answer, tally)
        if ready < 0:
            return int(ready)
        if ready == 1 and for_answer == 1:
            return 1
    return 0


@kernel(
    types.int64(
        TRANSFER, TRANSFER, WAIT, NOW, types.int64, types.int64, types.int64, types.int64, types.int64,
        _TABLE, _INTS, _BYTES, _BYTES, _BYTES, _INTS, _INTS, _INTS,
    )
)  # fmt: skip
def ping(
    read: Any, write: Any, wait: Any, now: Any, link: int, clock: int, until_ns: int, period_ns: int,
    timeout_ns: int, exchanges: Any, tally: Any, received: Any, raw: Any, transmit: Any, header: Any,
    values: Any, answer: Any,
) -> int:  # fmt: skip
    """Ask for the time again and again, until a moment or until the table is full.

    Parameters
    ----------
    read, write, wait, now, link, clock
        Plug points of the link and its clock with their handles (`rig.devices.device.LoopPort`).
    until_ns
        When to begin no other exchange (ns, link's clock); a call ends one time-out later at most.
    period_ns
        Least time from one question to the next; the next one waits for the answer, too.
    timeout_ns
        How long to wait for an answer.
    exchanges
        Table of `EXCHANGE`, filled from ``tally[TALLY.answered]`` on.
    tally
        Counters and what is remembered from call to call (`TALLY`).
    received, raw, transmit, header, values, answer
        Buffers of `RECEIVE_BYTES`, `codec.RAW_BYTES` and `codec.FRAME_BYTES`, and of the fields of a header, of a STATE
        and of a TIME.

    Returns
    -------
    int
        Exchanges in the table, or the negative errno of a broken link.
    """
    time_ns = now(clock)
    while tally[TALLY.answered] < len(exchanges) and time_ns < until_ns:
        due_ns = min(tally[TALLY.last_sent] + period_ns, until_ns)
        came = _listen(read, wait, now, link, clock, due_ns, 0, received, raw, header, values, answer, tally)
        if came < 0:
            return int(came)
        time_ns = now(clock)
        if time_ns >= until_ns:
            break
        tally[TALLY.last_sent] = time_ns
        values[GET_TIME.nonce] = tally[TALLY.nonce]
        values[GET_TIME.host_sent] = time_ns
        size = codec.encode_get_time(tally[TALLY.session], tally[TALLY.sequence], values[:2], transmit)
        tally[TALLY.sequence] = (tally[TALLY.sequence] + 1) % 65536
        taken = write(link, np.int64(transmit.ctypes.data), size)
        if taken < 0:
            return int(taken)
        tally[TALLY.bytes_out] += taken
        patience_ns = timeout_ns
        if taken == size:
            tally[TALLY.sent] += 1
        else:
            tally[TALLY.unsent] += 1
            patience_ns = RETRY_FULL_NS
        came = _listen(
            read, wait, now, link, clock, time_ns + patience_ns, 1,
            received, raw, header, values, answer, tally,
        )  # fmt: skip
        received_ns = now(clock)
        if came < 0:
            return int(came)
        if came == 1:
            row = tally[TALLY.answered]
            exchanges[row, EXCHANGE.host_sent] = time_ns
            exchanges[row, EXCHANGE.device_received] = answer[TIME.device_received]
            exchanges[row, EXCHANGE.device_sent] = answer[TIME.device_sent]
            exchanges[row, EXCHANGE.host_received] = received_ns
            tally[TALLY.answered] = row + 1
        elif taken == size:
            tally[TALLY.lost] += 1
        tally[TALLY.nonce] = (tally[TALLY.nonce] + 1) % _NONCES  # what comes now answers nothing any more
        time_ns = received_ns
    return int(tally[TALLY.answered])


VALUES = len(STATE)
"""Room for the fields of the largest message that is read."""
