"""Extract samples from the BATCH frames of a device that runs the law: each sample once, in order.

Samples wait in a queue, because a later reply of the device can decide which wall was active at a sample. Duplicates
and samples that arrive after newer ones are dropped and counted; lost samples are a gap in the sample index.
`rig.loop._supervise` calls it. Like all kernels of the loop it must not allocate or wait.
"""

from typing import Any

from numba import types

from firmware_protocol.messages import BATCH_LAYOUTS
from rig.core.sample import Phase
from rig.loop._contradictions import ahead, clock_error, find_clock_contradiction, take_news
from rig.loop._exchange import take_time
from rig.loop._parameter_update import take_answer
from rig.loop._receive import add, forget_noise
from rig.loop._rows import behind_grid
from rig.loop._supervision import (
    CONTIGUOUS,
    COUNT,
    CURRENT,
    INDEX,
    LATE,
    MEASURED,
    QUEUE,
    RECEIVED,
    SAMPLES_A_READING,
    STATES_KEPT,
    SUPERVISION_BUFFERS_TYPE,
    SUPERVISION_TYPE,
    TIME,
    SupervisionBuffers,
)
from rig.loop.frames import NO_FRAME, next_frame
from rig.loop.layout import BUFFERS_TYPE, SETTINGS_TYPE, Buffers
from rig.realtime import codec, control_words
from rig.realtime.codec import BATCH, HEAD, SAMPLE, STATE
from rig.realtime.kernel import kernel

_DONE = int(Phase.DONE)
# SAMPLES_A_READING counts on samples of at least 3 bytes.
assert min(sum(int(c[1:]) // 8 for c in layout) for layout in BATCH_LAYOUTS.values()) == 3


@kernel(types.boolean(SUPERVISION_TYPE))
def has_room(supervision: Any) -> bool:
    """Return True if the queue of samples has room for all samples that one read of the link can bring."""
    v = supervision[0]
    return bool(v["head"] - v["tail"] <= QUEUE - SAMPLES_A_READING)


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, types.int64, types.uintp))
def _take_batch(
    settings: Any, buffers: Buffers, supervised: SupervisionBuffers, count: int, words: int
) -> int:
    """Queue those of the `count` samples in the received BATCH message that are new, and return their number."""
    v, s, progress = supervised.supervision[0], settings[0], buffers.progress
    header, batch, decoded = buffers.header, supervised.batch, supervised.decoded
    first, time = batch[BATCH.first_index], batch[BATCH.device_time]
    known = 0  # samples of it that came before
    if v["started"] != 0:
        passed = ahead(first, v["index"])
        error = clock_error(settings, v["clock_error"], passed, time - v["time"])
        found = find_clock_contradiction(settings, passed + count, error)
        if found != 0:
            progress[0]["contradiction"] = found
            return 0
        first = v["index"] + passed
        time = v["time"] + ahead(time, v["time"])
        known = min(max(v["index"] - first + 1, 0), count)
        if known > 0:
            twice = header[HEAD.sequence] == v["batch_sequence"]
            add(words, control_words.DUPLICATED if twice else control_words.REORDERED, known)
        if known == count:
            return 0
        v["clock_error"] = error
    else:
        v["started"] = 1
        v["index"] = first - 1
        v["missed_first"] = header[HEAD.sequence] * s["batch_samples"]
    v["batch_sequence"] = header[HEAD.sequence]
    last = first + count - 1
    late = behind_grid(settings, progress, last, last - v["index"], progress[0]["read_at"])
    period_ps = s["period_ns"] * 1000
    for i in range(known, count):
        place = supervised.samples[v["head"] % QUEUE]
        place[INDEX] = first + i
        place[TIME] = time + i * period_ps // s["device_tick_ps"]
        place[COUNT] = decoded[i, SAMPLE.count]
        place[CURRENT] = decoded[i, SAMPLE.current_commanded]
        place[MEASURED] = decoded[i, SAMPLE.current_measured]
        place[RECEIVED] = progress[0]["read_at"]
        place[LATE] = late
        v["head"] += 1
    v["index"] = last
    v["time"] = time + (count - 1) * period_ps // s["device_tick_ps"]
    v["count"] = decoded[count - 1, SAMPLE.count]
    return count - known


@kernel(types.void(SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, types.uintp))
def _take_state(settings: Any, buffers: Buffers, supervised: SupervisionBuffers, words: int) -> None:
    """Queue the received STATE message and make it the newest; only count a repeated or older one; drop a false one."""
    v, p = supervised.supervision[0], buffers.progress[0]
    header, candidate = buffers.header, buffers.candidate
    states, newest = supervised.states, supervised.newest
    newer, accepted = take_news(settings, buffers.progress, candidate, newest, v["heard"] == 0)
    if accepted == 0:
        return
    if newer <= 0:
        add(words, control_words.DUPLICATED if newer == 0 else control_words.REORDERED, 1)
        return
    contiguous = 1
    if v["heard"] != 0:
        contiguous = 1 if header[HEAD.sequence] == (p["answers"] + 1) % 65536 else 0
    v["heard"] = 1
    p["answers"] = header[HEAD.sequence]
    for i in range(len(newest)):
        newest[i] = candidate[i]
    if candidate[STATE.phase] != _DONE:
        v["done_at"] = -1
    elif v["done_at"] < 0 and v["started"] != 0:
        v["done_at"] = v["index"] + ahead(candidate[STATE.sample_index], v["index"])
    if v["states_head"] - v["states_tail"] == STATES_KEPT:  # no sample has come for long: the oldest goes
        v["states_tail"] += 1
        states[v["states_tail"] % STATES_KEPT, CONTIGUOUS] = 0
    place = states[v["states_head"] % STATES_KEPT]
    for i in range(len(candidate)):
        place[i] = candidate[i]
    place[CONTIGUOUS] = contiguous
    v["states_head"] += 1


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, types.uintp))
def take_frames(settings: Any, buffers: Buffers, supervised: SupervisionBuffers, words: int) -> int:
    """Move the samples and STATE messages in the receive buffer to their queues; return the number of new samples.

    Also process replies to a clock exchange and to a parameter update. The queue must have room (`has_room`).
    """
    session = settings[0]["session"]
    raw, header, ack = buffers.raw, buffers.header, supervised.ack
    end = buffers.progress[0]["filled"]
    start = 0
    fresh = 0
    while True:
        length, start = next_frame(buffers.received, start, end, raw)
        if length == NO_FRAME:
            break
        if length < 0:
            add(words, control_words.BAD_FRAMES, 1)
            continue
        add(words, control_words.FRAMES, 1)
        count = codec.decode_batch(raw, length, header, supervised.batch, supervised.decoded)
        ours = header[HEAD.session] == session
        if count > 0 and ours:
            fresh += _take_batch(settings, buffers, supervised, count, words)
        elif ours and codec.decode_state(raw, length, header, buffers.candidate) == 0:
            _take_state(settings, buffers, supervised, words)
        elif codec.decode_ack(raw, length, header, ack) == 0 and take_answer(buffers, supervised) == 1:
            pass
        elif take_time(settings, buffers, length, words) == 0:
            add(words, control_words.OTHER_FRAMES, 1)
    forget_noise(buffers, start, end, words)
    return fresh
