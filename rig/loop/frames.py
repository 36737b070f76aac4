"""Split a byte stream into frames at the delimiters, in compiled code.

The loop's receiving kernels and the ping of `rig.doctor` call it. Kernels here allocate nothing and interpret no
message.
"""

from typing import Any

from numba import types

from rig.realtime import codec
from rig.realtime.kernel import kernel

NO_FRAME = -100  # the remaining bytes contain no whole frame

_BYTES = types.uint8[::1]


@kernel(types.UniTuple(types.int64, 2)(_BYTES, types.int64, types.int64, _BYTES))
def next_frame(received: Any, start: int, end: int, raw: Any) -> tuple[int, int]:
    """Decode the next frame in the bytes ``received[start:end]`` into `raw`.

    Returns
    -------
    int
        Length of header and payload in `raw` (bytes); or why the bytes are no frame (a negative `Defect`); or
        `NO_FRAME` if no delimiter follows.
    int
        Index of the first byte after the frame.
    """
    stop = codec.find_delimiter(received, start, end)
    while stop == start:  # delimiters alone mean nothing
        start += 1
        stop = codec.find_delimiter(received, start, end)
    if stop < 0:
        return NO_FRAME, start
    return codec.decode_frame(received, start, stop, raw), stop + 1


@kernel(types.int64(_BYTES, types.int64, types.int64))
def keep_rest(received: Any, start: int, end: int) -> int:
    """Move the unfinished frame ``received[start:end]`` to the front of the buffer; return its length (bytes).

    Discard it and return -1 if it is longer than half the buffer: so many bytes without a delimiter are noise.
    """
    rest = end - start
    if rest > len(received) // 2:
        return -1
    for i in range(rest):
        received[i] = received[start + i]
    return rest
