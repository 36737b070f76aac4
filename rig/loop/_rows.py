"""Write one row of the recording for each tick into the ring: received data, results of the law, and times.

Both loops and the replay call it. It must not overwrite a row that the recorder has not copied.
"""

from typing import Any

from numba import types

from rig.control.step import CONTROLLER_TYPE, MEMORY_TYPE, ControllerArguments
from rig.core.sample import RowFlag
from rig.loop._contradictions import WRAP
from rig.loop._exchange import device_ns
from rig.loop._receive import add
from rig.loop.layout import (
    BUFFERS_TYPE,
    INTS,
    PROGRESS_TYPE,
    ROWS_TYPE,
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
from rig.realtime.system import monotonic_now, sleep_until

# Two ordinary crystals differ by at most this: so much the host's grid may stretch against the device's.
DRIFT_PPM = 100
ROOM_POLL_NS = 50_000
# An edge may be younger than its sample by this (device ticks, a second): a STATE is made later than its sample.
YOUNGER = 1 << 24
FLAG_LATE, FLAG_GAP = int(RowFlag.LATE), int(RowFlag.GAP)


@kernel(types.int64(SETTINGS_TYPE, PROGRESS_TYPE, types.int64, types.int64, types.int64))
def behind_grid(settings: Any, progress: Any, sample_index: int, ticks: int, received_ns: int) -> int:
    """Return the lateness of a sample (ns): its receipt minus its regular time by the sample index.

    Regular times follow from the earliest receipt so far, which is moved on by the clock drift `DRIFT_PPM` (100 ppm)
    over the `ticks` since the last call.
    """
    p = progress[0]
    offset = received_ns - sample_index * settings[0]["period_ns"]
    # The earliest receipt ages: crystals drift apart, and a minimum for ever would call all ticks late one day.
    stretched = p["earliest"] + ticks * settings[0]["period_ns"] * DRIFT_PPM // 1_000_000
    p["earliest"] = min(offset, stretched)
    return int(offset - p["earliest"])


@kernel(types.int64(SETTINGS_TYPE, PROGRESS_TYPE, types.int64))
def lateness(settings: Any, progress: Any, received_ns: int) -> int:
    """Return the lateness of the newest sample (ns), received at host time `received_ns`, in a device-paced loop."""
    return int(behind_grid(settings, progress, progress[0]["sample_index"], 1, received_ns))


@kernel(types.int64(types.uintp, types.int64, types.int64))
def room(words: int, capacity: int, wait_for_room: int) -> int:
    """Return the ring's slot for the next row; while all `capacity` slots are full, wait, or drop the row (-1)."""
    head = load_word(words + WORD * control_words.HEAD)
    while head - load_word(words + WORD * control_words.TAIL) >= capacity:
        if wait_for_room == 0 or load_word(words + WORD * control_words.RECORDER_ERROR) != 0:
            add(words, control_words.DROPPED, 1)
            return -1
        # Real time also where the loop's clock is virtual: the recorder runs on its own.
        sleep_until(monotonic_now(0) + ROOM_POLL_NS)
    return int(head % capacity)


@kernel(types.int64(PROGRESS_TYPE, INTS, SETTINGS_TYPE))
def edge_age_ns(progress: Any, state: Any, settings: Any) -> int:
    """Return the time from the last encoder edge to the sample (ns)."""
    # The device's clock wraps at 32 bits, so an age is a difference modulo that.
    ticks = (progress[0]["device_time"] - state[STATE.edge_time]) % WRAP
    return int(ticks * settings[0]["device_tick_ps"] // 1000)


@kernel(types.int64(PROGRESS_TYPE, INTS))
def sync_time(progress: Any, state: Any) -> int:
    """Return the device time of the newest rising edge of the sync input (64 bits, device clock units); 0: no edge.

    An edge may be later than the sample of its STATE, because the STATE message is built after the sample.
    """
    # Extended when it is first reported: its 32 bits stay the same while the clock wraps.
    p = progress[0]
    stamp = state[STATE.sync_time]
    if stamp != p["sync_told"]:
        p["sync_told"] = stamp
        age = (p["device_time"] + YOUNGER - stamp) % WRAP - YOUNGER
        p["sync_time"] = 0 if stamp == 0 else p["device_time"] - age
    return int(p["sync_time"])


@kernel(types.void(ROWS_TYPE, types.int64, MEMORY_TYPE), inline=True)
def show_law(rows: Any, slot: int, memory: Any) -> None:
    """Copy phase, motion, efforts, current and flags of a tick from the law's `memory` into the row `slot`."""
    r, m = rows[slot], memory[0]
    r["phase"] = m["phase"]
    r["position"] = m["position"]
    r["velocity"] = m["velocity"]
    r["estimator_window"] = m["window"]
    r["penetration"] = m["penetration"]
    r["effort_wall"] = m["effort_wall"]
    r["effort_wanted"] = m["effort_wanted"]
    r["effort_sent"] = m["effort_sent"]
    r["current_sent"] = m["current_sent"]
    r["flags"] = m["flags"]


@kernel(types.void(CONTROLLER_TYPE, SHARED_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, *[types.int64] * 5))
def leave_row(
    controller: ControllerArguments,
    shared: SharedRing,
    settings: Any,
    buffers: Buffers,
    tick: int,
    elapsed: int,
    received_ns: int,
    computed_ns: int,
    sent_ns: int,
) -> None:
    """Put the row of a tick (`rig.core.sample.COLUMNS`) into the ring; if the ring is full, drop the row and count it.

    `elapsed` is the ticks since the last sample. The host times (ns) are those of the sample's receipt, of the computed
    current and of the sent COMMAND message. The active effort is computed from the active current.
    """
    words, rows, state, progress = shared.words, shared.rows, buffers.state, buffers.progress
    # Before the row may be dropped: an edge is extended to 64 bits once, when it is first reported.
    edge = sync_time(progress, state)
    slot = room(words, len(rows), settings[0]["wait_for_room"])
    if slot < 0:
        return
    r, p, s = rows[slot], progress[0], settings[0]
    quantum = controller.control[0]["effort_quantum"]
    r["tick"] = tick
    r["sample_index"] = p["sample_index"]
    r["elapsed_ticks"] = elapsed
    r["device_time"] = device_ns(p["device_time"], s["device_tick_ps"])
    r["lateness"] = p["late"]
    r["count"] = state[STATE.count]
    r["edge_age"] = edge_age_ns(progress, state, settings)
    r["effort_applied"] = state[STATE.current_commanded] * quantum
    r["current_applied"] = state[STATE.current_commanded]
    r["current_measured"] = state[STATE.current_measured] * s["current_quantum_a"]
    r["command_age"] = state[STATE.command_age]
    r["command_sequence"] = (p["sequence"] - 1) % 65536
    r["command_active"] = state[STATE.command_sequence]
    r["parameter_set"] = p["parameter_set"]
    r["limits"] = state[STATE.limits]
    r["fault"] = state[STATE.fault]
    r["device_state"] = state[STATE.state]
    r["inputs"] = state[STATE.inputs]
    r["missed_ticks"] = state[STATE.missed_ticks]
    r["sync_time"] = device_ns(edge, s["device_tick_ps"])
    r["execution_time"] = state[STATE.execution_time] * s["device_tick_ps"] // 1000
    show_law(rows, slot, controller.memory)
    r["received_at"] = received_ns
    r["computed_at"] = computed_ns
    r["sent_at"] = sent_ns
    r["sampled_at"] = 0  # sealing fills these two in, when the clocks can be compared
    r["applied_at"] = 0
    # Last, with release order: the recorder copies rows below HEAD only.
    store_word(words + WORD * control_words.HEAD, load_word(words + WORD * control_words.HEAD) + 1)


@kernel(types.void(SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE, types.int64, types.uintp))
def flag_timing(settings: Any, memory: Any, progress: Any, elapsed: int, words: int) -> None:
    """Mark the row of a late sample (LATE) or after missing ones (GAP), and count late, skipped and lost samples."""
    if progress[0]["late"] > settings[0]["period_ns"]:
        memory[0]["flags"] |= FLAG_LATE
        add(words, control_words.LATE, 1)
    if elapsed > 1:
        memory[0]["flags"] |= FLAG_GAP
        skipped = progress[0]["fresh"] - 1
        add(words, control_words.SKIPPED, skipped)
        add(words, control_words.LOST, elapsed - 1 - skipped)
