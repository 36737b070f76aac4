"""From the link's bytes to the newest sample: frames split, checked, and told apart."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from rig.loop.exchange import take_time
from rig.loop.frames import NO_FRAME, keep_rest, next_frame
from rig.loop.layout import BYTES, INT_ROWS, INTS, PROGRESS_TYPE, RECEIVE_BYTES, WORD
from rig.realtime import codec, ring
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import HEAD, STATE
from rig.realtime.kernel import kernel
from rig.realtime.plugs import TRANSFER

WRAP = 1 << 32


@kernel(types.void(types.uintp, types.int64, types.int64))
def add(words: int, word: int, amount: int) -> None:
    """Raise a counter of the ring, whose only writer is the loop."""
    store_word(words + WORD * word, load_word(words + WORD * word) + amount)


@kernel(types.int64(TRANSFER, types.int64, BYTES, PROGRESS_TYPE))
def drain(read: Any, link: int, received: Any, progress: Any) -> int:
    """Read all that is there into the receive buffer: 0, or the negative errno of a broken link."""
    while progress[0]["filled"] < RECEIVE_BYTES:
        filled = progress[0]["filled"]
        got = read(link, np.int64(received.ctypes.data) + filled, np.int64(RECEIVE_BYTES - filled))
        if got <= 0:
            return int(got)
        progress[0]["filled"] += got
    return 0


@kernel(types.void(BYTES, types.int64, types.int64, PROGRESS_TYPE, types.uintp))
def forget_noise(received: Any, start: int, end: int, progress: Any, words: int) -> None:
    """Keep the unfinished frame behind the last whole one for the next reading, unless it is noise."""
    rest = keep_rest(received, start, end)
    if rest < 0:
        add(words, ring.BAD_FRAMES, 1)
    progress[0]["filled"] = max(rest, 0)


@kernel(types.int64(INTS, INTS, INTS, PROGRESS_TYPE, types.uintp))
def _take(header: Any, candidate: Any, state: Any, progress: Any, words: int) -> int:
    """Keep a STATE of this session in `state` if it is newer; return by how many samples."""
    p = progress[0]
    newer = 1
    if p["started"] != 0:
        newer = (candidate[STATE.sample_index] - p["sample_index"] + WRAP // 2) % WRAP - WRAP // 2
    if newer <= 0:
        add(words, ring.DUPLICATED if newer == 0 else ring.REORDERED, 1)
        return 0
    if p["started"] == 0:
        p["sample_index"] = candidate[STATE.sample_index]
        p["device_time"] = candidate[STATE.device_time]
        p["started"] = 1
    else:
        p["sample_index"] += newer
        p["device_time"] += (candidate[STATE.device_time] - p["device_time"]) % WRAP
    p["answers"] = header[HEAD.sequence]
    p["fresh"] += 1
    for i in range(len(state)):
        state[i] = candidate[i]
    return newer


@kernel(
    types.int64(
        BYTES, BYTES, INTS, INTS, INTS, INTS, INT_ROWS, PROGRESS_TYPE, types.int64, types.int64, types.uintp
    )
)
def newest_state(
    received: Any, raw: Any, header: Any, candidate: Any, state: Any, times: Any, exchanges: Any, progress: Any,
    session: int, device_tick_ps: int, words: int,
) -> int:  # fmt: skip
    """Take the whole frames out of the receive buffer and leave the newest fresh STATE in `state`.

    Returns the samples passed since the last one delivered, 0 when nothing is fresh; ``progress["fresh"]`` is how
    many of them arrived. An answer to a clock exchange goes to `exchanges`. An unfinished frame moves to the front
    of the buffer; two kilobytes without a delimiter are noise and are thrown away.
    """
    progress[0]["fresh"] = 0
    end = progress[0]["filled"]
    start = 0
    passed = 0
    while True:
        length, start = next_frame(received, start, end, raw)
        if length == NO_FRAME:
            break
        if length < 0:
            add(words, ring.BAD_FRAMES, 1)
            continue
        add(words, ring.FRAMES, 1)
        kind = codec.decode_state(raw, length, header, candidate)
        if header[HEAD.session] == session and kind == 0:
            passed += _take(header, candidate, state, progress, words)
        elif take_time(raw, length, header, times, exchanges, progress, device_tick_ps, words) == 0:
            add(words, ring.OTHER_FRAMES, 1)
    forget_noise(received, start, end, progress, words)
    return passed
