"""Receive bytes from the link: split them into frames, check and dispatch these, return the newest STATE message.

Both loops call it. It must not wait, and must accept any bytes.
"""

from typing import Any

import numpy as np
from numba import types

from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._contradictions import ahead, take_news, time_of
from rig.loop._exchange import take_time
from rig.loop.frames import NO_FRAME, keep_rest, next_frame
from rig.loop.layout import BUFFERS_TYPE, RECEIVE_BYTES, SETTINGS_TYPE, WORD, Buffers
from rig.realtime import codec, control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import HEAD, STATE
from rig.realtime.kernel import kernel


@kernel(types.void(types.uintp, types.int64, types.int64))
def add(words: int, word: int, amount: int) -> None:
    """Add `amount` to the counter `word` of the control words at the address `words`; only the loop writes counters."""
    store_word(words + WORD * word, load_word(words + WORD * word) + amount)


@kernel(types.int64(PORT_TYPE, BUFFERS_TYPE))
def drain(port: LoopPort, buffers: Buffers) -> int:
    """Read all available bytes into the receive buffer; return 0, or the negative errno of a broken link."""
    p, start = buffers.progress[0], np.int64(buffers.received.ctypes.data)
    while p["filled"] < RECEIVE_BYTES:
        got = port.read(port.handle, start + p["filled"], np.int64(RECEIVE_BYTES - p["filled"]))
        if got <= 0:
            return int(got)
        p["filled"] += got
    return 0


@kernel(types.void(BUFFERS_TYPE, types.int64, types.int64, types.uintp))
def forget_noise(buffers: Buffers, start: int, end: int, words: int) -> None:
    """Move the unfinished frame (`start` to `end`) to the front of the receive buffer; discard it if it is noise."""
    rest = keep_rest(buffers.received, start, end)
    if rest < 0:
        add(words, control_words.BAD_FRAMES, 1)
    buffers.progress[0]["filled"] = max(rest, 0)


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, types.uintp))
def _take(settings: Any, buffers: Buffers, words: int) -> int:
    """Store the received STATE message if it is newer and consistent; return how many samples it is newer, or 0."""
    p, candidate, state = buffers.progress[0], buffers.candidate, buffers.state
    newer, accepted = take_news(settings, buffers.progress, candidate, state, p["started"] == 0)
    if accepted == 0:
        return 0
    if newer <= 0:
        add(words, control_words.DUPLICATED if newer == 0 else control_words.REORDERED, 1)
        return 0
    if p["started"] == 0:
        p["sample_index"] = candidate[STATE.sample_index]
        p["device_time"] = candidate[STATE.device_time]
        p["started"] = 1
    else:
        p["sample_index"] += newer
        # Relative to the expected time: a clock that jumps back is then a jump and not almost a whole wrap forward.
        expected = time_of(settings, newer)
        p["device_time"] += expected + ahead(candidate[STATE.device_time] - p["device_time"], expected)
    p["answers"] = buffers.header[HEAD.sequence]
    p["fresh"] += 1
    for i in range(len(state)):
        state[i] = candidate[i]
    return newer


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, types.uintp))
def newest_state(settings: Any, buffers: Buffers, words: int) -> int:
    """Process all whole frames in the receive buffer and store the newest STATE message in `buffers.state`.

    Return the number of samples since the last stored STATE, 0 if no newer one arrived; the number of STATEs that
    arrived is stored in ``progress["fresh"]``. The times of a clock exchange are stored in `buffers.exchanges`. An
    unfinished frame moves to the front of the buffer; two kilobytes without a delimiter are noise and are discarded.
    """
    p, header = buffers.progress[0], buffers.header
    p["fresh"] = 0
    end = p["filled"]
    start = 0
    passed = 0
    while True:
        length, start = next_frame(buffers.received, start, end, buffers.raw)
        if length == NO_FRAME:
            break
        # A bad frame is skipped, not fatal: COBS finds the next one at the following delimiter.
        if length < 0:
            add(words, control_words.BAD_FRAMES, 1)
            continue
        add(words, control_words.FRAMES, 1)
        kind = codec.decode_state(buffers.raw, length, header, buffers.candidate)
        if header[HEAD.session] == settings[0]["session"] and kind == 0:
            passed += _take(settings, buffers, words)
        elif take_time(settings, buffers, length, words) == 0:
            add(words, control_words.OTHER_FRAMES, 1)
    forget_noise(buffers, start, end, words)
    return passed
