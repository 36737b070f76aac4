"""Loop for a law that runs on the device: it receives samples, records them, and sends a keep-alive every few ms.

The device sends every tick in BATCH frames. The host runs `rig.control.step` on each sample too, and writes the same
row as `rig.loop._host`. It must not wait without a bound, or return before it has sent several STOP commands.
"""

from typing import Any

from numba import types

from firmware_protocol.messages import STOP_FRAMES
from rig.control.step import (
    CONTROL_TYPE,
    CONTROLLER_TYPE,
    MEMORY_TYPE,
    ControllerArguments,
    shown_phase,
    step,
)
from rig.core.sample import Phase
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._batches import has_room, take_frames
from rig.loop._commands import MODE_STOP, MODE_SUPERVISE, NO_SYNC, send_command
from rig.loop._contradictions import WRAP, ahead
from rig.loop._currents import compare_measured
from rig.loop._device_host_agreement import compare, settle
from rig.loop._ending import (
    CLOSED,
    DEVICE_ENDED,
    FAULT,
    FINISHED,
    HEARTBEAT,
    SILENT,
    STOPPED,
    reason_by_contradiction,
    reason_by_device,
    reason_by_law,
    reason_by_request,
    reason_by_switch,
)
from rig.loop._exchange import ask_time
from rig.loop._parameter_update import COMMITTED, GRANTED, IDLE, send_update
from rig.loop._parameters import begin_set
from rig.loop._receive import add, drain
from rig.loop._rows import FLAG_GAP, leave_row
from rig.loop._supervision import (
    COUNT,
    CURRENT,
    INDEX,
    LATE,
    MEASURED,
    QUEUE,
    RECEIVED,
    STATES_KEPT,
    SUPERVISION_BUFFERS_TYPE,
    SUPERVISION_TYPE,
    TIME,
    SupervisionBuffers,
)
from rig.loop.layout import (
    BUFFERS_TYPE,
    INT_ROWS,
    INTS,
    PROGRESS_TYPE,
    RECEIVE_BYTES,
    SETTINGS_TYPE,
    SHARED_TYPE,
    WORD,
    Buffers,
    SharedRing,
)
from rig.realtime import control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel

_RELEASE = int(Phase.RELEASE)
READINGS_A_TURN = 16  # reads of a full receive buffer before the loop does anything else
ROWS_A_TURN = 1024
REST_NS = 20_000_000  # after the stop: how long to receive samples that are in transit
SETTLE_NS = 2_000_000  # after the STATE that shows the stop active
_CONTINUE = 0
_ABANDONED = -1


@kernel(
    types.int64(PORT_TYPE, CONTROL_TYPE, SHARED_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE)
)
def _send_due(
    port: LoopPort,
    control: Any,
    shared: SharedRing,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
) -> int:
    """Send keep-alive, GET_TIME and parameter update if they are due; return 0, or -errno if the link is broken."""
    v, s = supervised.supervision[0], settings[0]
    time_ns = port.now(port.clock_handle)
    if time_ns >= v["next_command"]:
        taken = send_command(port, settings, buffers, MODE_SUPERVISE, 0, NO_SYNC)
        add(shared.words, control_words.COMMANDS if taken == 1 else control_words.UNSENT, 1)
        v["next_command"] = time_ns + s["supervise_every_ns"]
        if taken >= 0:
            taken = ask_time(port, settings, buffers)
        if taken < 0:
            return int(taken)
    return int(send_update(port, shared.mailbox, control, settings, buffers, supervised))


@kernel(
    types.int64(PORT_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, types.int64, types.uintp)
)
def _listen(
    port: LoopPort,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
    until_ns: int,
    words: int,
) -> int:
    """Wait for bytes until host time `until_ns`, and process all frames; return 0, or -errno if the link is broken."""
    p = buffers.progress[0]
    ready = port.wait(port.handle, until_ns)
    p["read_at"] = port.now(port.clock_handle)
    if ready <= 0:
        return int(ready)
    for _ in range(READINGS_A_TURN):
        if not has_room(supervised.supervision):
            break
        ready = drain(port, buffers)
        more = p["filled"] == RECEIVE_BYTES
        p["read_at"] = port.now(port.clock_handle)
        fresh = take_frames(settings, buffers, supervised, words)
        if fresh > 0:
            p["last_fresh"] = p["read_at"]
        if ready < 0:
            return int(ready)
        if not more:
            break
    return 0


@kernel(types.void(INT_ROWS, INTS, SUPERVISION_TYPE, types.int64))
def _take_states(states: Any, state: Any, supervision: Any, sample_index: int) -> None:
    """Copy the newest STATE message not later than the sample `sample_index` from the queue `states` into `state`."""
    # A batch carries neither limits, inputs nor fault: a sample has those of the STATE before it.
    v = supervision[0]
    while v["states_tail"] < v["states_head"]:
        waiting = states[v["states_tail"] % STATES_KEPT]
        if ahead(waiting[STATE.sample_index], sample_index) > 0:
            break
        settle(supervision, waiting)
        for i in range(len(state)):
            state[i] = waiting[i]
        v["states_tail"] += 1


@kernel(types.int64(CONTROL_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, INTS))
def _show_sample(
    control: Any, settings: Any, buffers: Buffers, supervised: SupervisionBuffers, sample: Any
) -> int:
    """Set `buffers.state` to a sample, with the newest STATE before it; return the ticks since the last sample."""
    supervision, state = supervised.supervision, buffers.state
    v, p = supervision[0], buffers.progress[0]
    elapsed = sample[INDEX] - p["sample_index"]
    if v["ticks"] == 0:
        elapsed = 1 + v["missed_first"]
    p["sample_index"] = sample[INDEX]
    p["device_time"] = sample[TIME]
    p["late"] = sample[LATE]
    _take_states(supervised.states, state, supervision, sample[INDEX])
    compare(supervision, settings, control, elapsed, sample[CURRENT])
    state[STATE.sample_index] = sample[INDEX] % WRAP
    state[STATE.device_time] = sample[TIME] % WRAP
    state[STATE.count] = sample[COUNT]
    state[STATE.edge_time] = state[STATE.device_time]  # a BATCH does not contain it
    state[STATE.current_commanded] = sample[CURRENT]
    state[STATE.current_measured] = sample[MEASURED]
    return int(elapsed)


@kernel(
    types.int64(
        CONTROLLER_TYPE, SHARED_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE, types.boolean
    ),
)
def _run_law(
    controller: ControllerArguments,
    shared: SharedRing,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
    to_the_end: bool,
) -> int:
    """Run the law on queued samples and write their rows; return an `EndReason`, or 0 to continue.

    Return -1 if the waiting thread has given up. With `to_the_end`, samples do not wait for the reply about a new wall.
    """
    # While the reply about a new wall is awaited, samples wait as long as there is room: the reply names the sample
    # from which the new wall counts.
    v, m = supervised.supervision[0], controller.memory[0]
    state, words = buffers.state, shared.words
    for _ in range(ROWS_A_TURN):
        held = v["step"] == COMMITTED and has_room(supervised.supervision) and not to_the_end
        if v["tail"] == v["head"] or held:
            break
        # The same law and row as if it had run here: recording, verdict and replay are the same, and differences of the
        # device's current are counted.
        sample = supervised.samples[v["tail"] % QUEUE]
        v["tail"] += 1
        tick = v["ticks"]
        elapsed = _show_sample(controller.control, settings, buffers, supervised, sample)
        if v["step"] == GRANTED and sample[INDEX] >= v["change_at"]:
            begin_set(controller, buffers, tick, words)
            v["step"] = IDLE
        current = step(controller, sample[COUNT], 0.0, elapsed, sample[CURRENT])
        # The caller has given up waiting.
        if load_word(words + WORD * control_words.STOP) == control_words.ABANDONED:
            return _ABANDONED
        v["sent"] = current
        v["comparable"] = 1 if v["stop_sequence"] < 0 else 0
        if elapsed > 1:
            m["flags"] |= FLAG_GAP
            add(words, control_words.LOST, elapsed - 1)
        compare_measured(buffers, controller.memory, elapsed)
        reason = reason_by_device(state, buffers.progress)
        if reason == 0:
            reason = reason_by_switch(state, settings, buffers.progress)
        if reason == 0:
            reason = reason_by_law(controller.memory)
        if reason != 0:
            m["effort_sent"] = 0.0
            m["current_sent"] = 0
        leave_row(controller, shared, settings, buffers, tick, elapsed, sample[RECEIVED], 0, 0)
        v["ticks"] = tick + 1
        store_word(words + WORD * control_words.TICKS, tick + 1)
        store_word(words + WORD * control_words.PHASE, shown_phase(controller.memory))
        if reason != 0:
            return int(reason)
    return _CONTINUE


@kernel(types.int64(INTS, SUPERVISION_TYPE, SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE, types.int64))
def _reason_without_row(
    newest: Any, supervision: Any, settings: Any, memory: Any, progress: Any, ready: int
) -> int:
    """Return the reason to end when no new sample arrived (device, link; `ready` < 0: link broken), 0 to continue."""
    v, s, p = supervision[0], settings[0], progress[0]
    reason = reason_by_contradiction(progress)
    if reason == 0 and v["heard"] != 0:
        reason = reason_by_device(newest, progress)
    if reason != 0:
        return int(reason)
    if ready < 0:
        return CLOSED
    if p["read_at"] - p["last_fresh"] > s["lost_after_ns"]:
        return SILENT
    # A gap may have moved the phases of the two laws apart: the host's may end later by what the link tolerates.
    patience = s["lost_after_ns"] // s["period_ns"]
    if v["done_at"] >= 0 and v["ticks"] > 0 and p["sample_index"] - v["done_at"] > patience:
        return FINISHED if memory[0]["phase"] == _RELEASE else DEVICE_ENDED
    return 0


@kernel(types.void(INT_ROWS, INT_ROWS, SUPERVISION_TYPE, PROGRESS_TYPE))
def _queue_fault(states: Any, samples: Any, supervision: Any, progress: Any) -> None:
    """Queue the STATE message that reports a fault as a last sample, because a device sends no BATCH after a fault."""
    v = supervision[0]
    for i in range(v["states_tail"], v["states_head"]):
        state = states[i % STATES_KEPT]
        if reason_by_device(state, progress) != FAULT:
            continue
        index, time = state[STATE.sample_index], state[STATE.device_time]
        if v["started"] != 0:
            index = v["index"] + ahead(index, v["index"])
            time = v["time"] + ahead(time, v["time"])
        if v["started"] == 0 or index > v["index"]:
            place = samples[v["head"] % QUEUE]
            place[INDEX] = index
            place[TIME] = time
            place[COUNT] = state[STATE.count]
            place[CURRENT] = state[STATE.current_commanded]
            place[MEASURED] = state[STATE.current_measured]
            place[RECEIVED] = progress[0]["read_at"]
            place[LATE] = 0
            v["head"] += 1
            v["index"] = index
        break


@kernel(types.int64(INTS, SUPERVISION_TYPE), inline=True)
def _shows_stop(newest: Any, supervision: Any) -> int:
    """Return 1 if the newest STATE message names one of the host's STOPs as the active command, else 0."""
    since = (newest[STATE.command_sequence] - supervision[0]["stop_sequence"]) % 65536
    return 1 if supervision[0]["heard"] != 0 and since < STOP_FRAMES else 0


@kernel(
    types.int64(
        PORT_TYPE, CONTROLLER_TYPE, SHARED_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, SUPERVISION_BUFFERS_TYPE
    ),
)
def run(
    port: LoopPort,
    controller: ControllerArguments,
    shared: SharedRing,
    settings: Any,
    buffers: Buffers,
    supervised: SupervisionBuffers,
) -> int:
    """Supervise until an end reason; then send zero effort several times, receive late samples, and return the reason.

    The reason (`EndReason`) is also stored in the ring. The caller must set the control word LOOP_DONE.

    Parameters
    ----------
    port, controller, shared, settings, buffers
        Link, law, shared ring and memory, as for the loop on the host; the mailbox contains updates for the device.
    supervised
        Additional memory of this loop.
    """
    supervision, newest, words = supervised.supervision, supervised.newest, shared.words
    v, p = supervision[0], buffers.progress[0]
    p["last_fresh"] = port.now(port.clock_handle)
    reason = 0
    last_row = False  # whether the row of the end is there
    while reason == 0:
        reason = reason_by_request(port, settings, words)
        if reason != 0:
            break
        time_ns = port.now(port.clock_handle)
        ready = _send_due(port, controller.control, shared, settings, buffers, supervised)
        if ready >= 0:
            idle = v["tail"] == v["head"] or v["step"] == COMMITTED
            until_ns = v["next_command"] if idle else time_ns
            ready = _listen(port, settings, buffers, supervised, until_ns, words)
        reason = _run_law(controller, shared, settings, buffers, supervised, False)
        last_row = reason != _CONTINUE
        if not last_row:
            reason = _reason_without_row(
                newest, supervision, settings, controller.memory, buffers.progress, ready
            )
        if reason == CLOSED:
            store_word(words + WORD * control_words.END_ERRNO, -ready)
    if reason == _ABANDONED:
        store_word(words + WORD * control_words.END_REASON, STOPPED)
        return STOPPED
    v["stop_sequence"] = p["sequence"]
    # Also on a closed link: one whose reading fails may still transmit.
    for _ in range(STOP_FRAMES):
        send_command(port, settings, buffers, MODE_STOP, 0, NO_SYNC)
    # What the device had sent before it stopped, unless the row of the end is there.
    until_ns = port.now(port.clock_handle) + REST_NS
    listening = not last_row and reason in (STOPPED, HEARTBEAT, FAULT, DEVICE_ENDED)
    resting = not last_row
    stopped = 0
    while resting:
        ready = -1
        if listening:
            ready = _listen(port, settings, buffers, supervised, until_ns, words)
        ended = _run_law(controller, shared, settings, buffers, supervised, True)
        if stopped == 0 and _shows_stop(newest, supervision) == 1:
            stopped = 1
            until_ns = min(until_ns, port.now(port.clock_handle) + SETTLE_NS)
        more = ready >= 0 and port.now(port.clock_handle) < until_ns
        resting = ended == _CONTINUE and (more or v["tail"] < v["head"])
        if reason == FAULT and ended == _CONTINUE and not resting:
            _queue_fault(supervised.states, supervised.samples, supervision, buffers.progress)
            resting = v["tail"] < v["head"]
            listening = False
    store_word(words + WORD * control_words.END_REASON, reason)
    return int(reason)
