"""Measure a link by repeated exchanges of time stamps, in one compiled function that runs without the GIL.

The host sends the message GetTime, and the device replies with Time. `rig.doctor._round_trip` calls `ping`. The
function must use the same port functions, codec and way of waiting as the real-time loop, so that the times are valid
for the loop.
"""

from __future__ import annotations

from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from numba import types

from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop.frames import NO_FRAME, keep_rest, next_frame
from rig.realtime import codec
from rig.realtime.codec import GET_TIME, HEAD, STATE, TIME
from rig.realtime.groups import Bytes, Ints, group, type_of
from rig.realtime.kernel import kernel

RECEIVE_BYTES = 4096
# Pause (ns) after the line has accepted only a part of a request.
RETRY_FULL_NS = 1_000_000
# Reads of a full buffer before the function checks the clock again.
MOST_READS = 16

# Places in the tally.
_NAMES = (
    "filled",  # bytes of an unfinished frame at the front of the receive buffer
    # Session number in the headers of all requests.
    "session",
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

_INTS = types.int64[::1]
_NONCES = 1 << 16


@group
class PingBuffers(NamedTuple):
    """Working arrays of `ping`: received bytes, a decoded and an outgoing frame; fields of header, message, reply."""

    received: Bytes
    raw: Bytes
    transmit: Bytes
    header: Ints
    values: Ints
    answer: Ints

    @classmethod
    def allocate(cls) -> PingBuffers:
        return cls(
            received=np.zeros(RECEIVE_BYTES, np.uint8),
            raw=np.zeros(codec.RAW_BYTES, np.uint8),
            transmit=np.zeros(codec.FRAME_BYTES, np.uint8),
            header=np.zeros(len(HEAD), np.int64),
            values=np.zeros(len(STATE), np.int64),  # the largest message that is read
            answer=np.zeros(len(TIME), np.int64),
        )


_BUFFERS_TYPE = type_of(PingBuffers)


@kernel(types.int64(_BUFFERS_TYPE, types.int64, _INTS))
def _take(buffers: PingBuffers, length: int, tally: Any) -> int:
    """Decode a received frame; return 1 if it is the reply to the newest request (in `buffers.values`), else 0."""
    raw, header, values = buffers.raw, buffers.header, buffers.values
    if codec.decode_time(raw, length, header, values) == 0:
        if values[TIME.nonce] == tally[TALLY.nonce] and values[TIME.host_sent] == tally[TALLY.last_sent]:
            return 1
        tally[TALLY.late] += 1
    elif codec.decode_state(raw, length, header, values) == 0:
        tally[TALLY.states] += 1
        tally[TALLY.state_sequence] = header[HEAD.sequence]
    return 0


@kernel(types.int64(PORT_TYPE, _BUFFERS_TYPE, _INTS))
def _gather(port: LoopPort, buffers: PingBuffers, tally: Any) -> int:
    """Read and decode received frames; return 1 if the awaited reply came (in `buffers.answer`), else 0 or -errno."""
    received, answer = buffers.received, buffers.answer
    came = 0
    got = np.int64(1)
    # Bounded: a device that never pauses must not keep this function from its deadline.
    for _ in range(MOST_READS):
        if got <= 0:
            break
        filled = tally[TALLY.filled]
        start = np.int64(received.ctypes.data) + filled
        got = port.read(port.handle, start, np.int64(RECEIVE_BYTES - filled))
        if got < 0:
            return int(got)
        tally[TALLY.bytes_in] += got
        end = filled + got
        start = 0
        while True:
            length, start = next_frame(received, start, end, buffers.raw)
            if length == NO_FRAME:
                break
            if length < 0:
                tally[TALLY.bad_frames] += 1
            elif _take(buffers, length, tally) == 1:
                came = 1
                for i in range(len(answer)):
                    answer[i] = buffers.values[i]
        rest = keep_rest(received, start, end)
        if rest < 0:
            tally[TALLY.bad_frames] += 1
        tally[TALLY.filled] = max(rest, 0)
    return came


@kernel(types.int64(PORT_TYPE, _BUFFERS_TYPE, _INTS, types.int64, types.int64))
def _listen(port: LoopPort, buffers: PingBuffers, tally: Any, until_ns: int, for_answer: int) -> int:
    """Receive frames until the time `until_ns` (ns), or if `for_answer` is 1 until the awaited reply arrives.

    Return 1 if `for_answer` is 1 and the reply has arrived, 0 if the time has passed, or -errno of a broken link.
    """
    while port.now(port.clock_handle) < until_ns:
        ready = port.wait(port.handle, until_ns)
        if ready > 0:
            ready = _gather(port, buffers, tally)
        if ready < 0:
            return int(ready)
        if ready == 1 and for_answer == 1:
            return 1
    return 0


@kernel(
    types.int64(
        *(PORT_TYPE, _BUFFERS_TYPE, types.int64[:, ::1], _INTS, types.int64, types.int64, types.int64)
    )
)
def ping(
    port: LoopPort,
    buffers: PingBuffers,
    exchanges: Any,
    tally: Any,
    until_ns: int,
    period_ns: int,
    timeout_ns: int,
) -> int:
    """Request the device's time repeatedly, until `until_ns` or until the array `exchanges` is full.

    Parameters
    ----------
    port
        Functions that read, write and wait on the link, and the clock of the link.
    buffers
        Working arrays of this function.
    exchanges
        Array of shape (n, 4), int64, with one row per reply and the columns of `EXCHANGE`; rows from
        ``tally[TALLY.answered]`` on are filled.
    tally
        Array of counters, int64, with the elements of `TALLY`; the next call continues with it.
    until_ns
        Time after which no exchange begins (ns, clock of the link); the call ends at most one timeout later.
    period_ns
        Shortest time from one request to the next (ns); a request also waits for the previous reply or its timeout.
    timeout_ns
        Longest time to wait for a reply (ns).

    Returns
    -------
    int
        Number of filled rows in `exchanges`, or the negative errno of a broken link.
    """
    values, transmit, answer = buffers.values, buffers.transmit, buffers.answer
    time_ns = port.now(port.clock_handle)
    while tally[TALLY.answered] < len(exchanges) and time_ns < until_ns:
        due_ns = min(tally[TALLY.last_sent] + period_ns, until_ns)
        came = _listen(port, buffers, tally, due_ns, 0)
        if came < 0:
            return int(came)
        time_ns = port.now(port.clock_handle)
        if time_ns >= until_ns:
            break
        tally[TALLY.last_sent] = time_ns
        values[GET_TIME.nonce] = tally[TALLY.nonce]
        values[GET_TIME.host_sent] = time_ns
        size = codec.encode_get_time(tally[TALLY.session], tally[TALLY.sequence], values[:2], transmit)
        tally[TALLY.sequence] = (tally[TALLY.sequence] + 1) % 65536
        taken = port.write(port.handle, np.int64(transmit.ctypes.data), size)
        if taken < 0:
            return int(taken)
        tally[TALLY.bytes_out] += taken
        patience_ns = timeout_ns
        if taken == size:
            tally[TALLY.sent] += 1
        else:
            tally[TALLY.unsent] += 1
            patience_ns = RETRY_FULL_NS
        came = _listen(port, buffers, tally, time_ns + patience_ns, 1)
        received_ns = port.now(port.clock_handle)
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
        # A new nonce, also after a timeout: a reply that comes now is late and counts as such.
        tally[TALLY.nonce] = (tally[TALLY.nonce] + 1) % _NONCES
        time_ns = received_ns
    return int(tally[TALLY.answered])
