"""The control loop on the host, as one compiled function that runs without the GIL.

For each new STATE message: read the count, run `rig.control.step`, reply with a COMMAND, put one row into the ring.
`rig.loop._run` starts it in a thread. It must not wait without a bound, allocate, or return before it has sent several
STOP commands.
"""

from typing import Any

from numba import types

from firmware_protocol.messages import STOP_FRAMES
from rig.control.step import CONTROLLER_TYPE, MEMORY_TYPE, ControllerArguments, shown_phase, step
from rig.devices.port import PORT_TYPE, LoopPort
from rig.loop._commands import MODE_CURRENT, MODE_STOP, NO_SYNC, send_command, sync_of
from rig.loop._currents import compare_command, compare_measured
from rig.loop._ending import (
    CLOSED,
    DELAYED,
    OVERRUN,
    SILENT,
    STOPPED,
    reason_by_contradiction,
    reason_by_device,
    reason_by_law,
    reason_by_request,
    reason_by_switch,
)
from rig.loop._exchange import ask_time
from rig.loop._link_delay import is_delayed
from rig.loop._parameters import renew_parameters
from rig.loop._receive import add, drain, newest_state
from rig.loop._rows import FLAG_GAP, FLAG_LATE, edge_age_ns, flag_timing, lateness, leave_row
from rig.loop.layout import (
    BUFFERS_TYPE,
    PROGRESS_TYPE,
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

# Bounds of one wait: the stop word, a signal and the heartbeat are checked between waits, so within a tick or 10 ms.
SHORTEST_WAIT_NS = 200_000
LONGEST_WAIT_NS = 10_000_000


@kernel(types.boolean(SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE))
def _overran(settings: Any, memory: Any, progress: Any) -> bool:
    """Return True if this tick, or a sample that was skipped before it, is more than one period late."""
    # Device-paced, the newest of several samples is in time though the skipped ones were not: they decide.
    flags = memory[0]["flags"]
    behind = settings[0]["host_paced"] == 0 and flags & FLAG_GAP != 0 and progress[0]["fresh"] > 1
    return bool(behind or flags & FLAG_LATE != 0)


@kernel(types.int64(SETTINGS_TYPE, BUFFERS_TYPE, MEMORY_TYPE))
def _outcome(settings: Any, buffers: Buffers, memory: Any) -> int:
    """Return the reason to end the run after this tick (device, link, limit switch, law or lateness), 0 to continue."""
    progress = buffers.progress
    reason = reason_by_device(buffers.state, progress)
    if reason == 0 and is_delayed(settings, buffers):
        reason = DELAYED
    if reason == 0:
        reason = reason_by_switch(buffers.state, settings, progress)
    if reason == 0:
        reason = reason_by_law(memory)
    if reason == 0 and settings[0]["stop_when_late"] != 0 and _overran(settings, memory, progress):
        reason = OVERRUN
    return int(reason)


@kernel(types.void(PORT_TYPE, SETTINGS_TYPE, PROGRESS_TYPE, types.uintp))
def _sleep_to_the_grid(port: LoopPort, settings: Any, progress: Any, words: int) -> None:
    """Sleep until the next tick of the host's own time grid; count and skip ticks that have already passed."""
    s, p = settings[0], progress[0]
    if p["deadline"] == 0:
        p["deadline"] = port.now(port.clock_handle)
    # Absolute deadlines: a late wake-up does not shift the grid.
    p["deadline"] += s["period_ns"]
    port.sleep(port.clock_handle, p["deadline"] - s["spin_ns"])
    woke = port.now(port.clock_handle)
    while woke < p["deadline"]:
        woke = port.now(port.clock_handle)
    p["late"] = woke - p["deadline"]
    # Points that passed are skipped, never run in a burst: several commands at once would be one effort too late.
    passed = p["late"] // s["period_ns"]
    p["deadline"] += passed * s["period_ns"]
    add(words, control_words.OVERRUNS, passed)


_NO_SAMPLE = 0
_ENDS = -1  # times an EndReason: what `_receive` returns instead of a number of samples


@kernel(types.int64(PORT_TYPE, SETTINGS_TYPE, BUFFERS_TYPE, types.uintp))
def _receive(port: LoopPort, settings: Any, buffers: Buffers, words: int) -> int:
    """Wait at most one period for a sample; return how many samples newer it is, 0 if none came, or −`EndReason`."""
    s, p = settings[0], buffers.progress[0]
    reason = reason_by_request(port, settings, words)
    if reason != 0:
        return _ENDS * reason
    until_ns = port.now(port.clock_handle)
    if s["host_paced"] != 0:
        _sleep_to_the_grid(port, settings, buffers.progress, words)
        # A link in virtual time advances its device to this time; the loop does not wait.
        until_ns = port.now(port.clock_handle)
    else:
        until_ns += min(max(s["period_ns"], SHORTEST_WAIT_NS), LONGEST_WAIT_NS)
    ready = port.wait(port.handle, until_ns)
    if ready > 0:
        ready = drain(port, buffers)
    p["read_at"] = port.now(port.clock_handle)
    passed = newest_state(settings, buffers, words)
    if passed > 0:
        p["last_fresh"] = p["read_at"]
        if s["host_paced"] == 0:
            p["late"] = lateness(settings, buffers.progress, p["read_at"])
        return int(passed)
    # Before a closed link: a device that restarts may close the port as well, and its restart is the reason.
    if p["contradiction"] != 0:
        return _ENDS * reason_by_contradiction(buffers.progress)
    if ready < 0:
        store_word(words + WORD * control_words.END_ERRNO, -ready)
        return _ENDS * CLOSED
    if p["read_at"] - p["last_fresh"] > s["lost_after_ns"]:
        return _ENDS * SILENT
    if s["host_paced"] != 0:
        add(words, control_words.STALE, 1)
    return _NO_SAMPLE


@kernel(
    types.int64(PORT_TYPE, CONTROLLER_TYPE, SHARED_TYPE, SETTINGS_TYPE, BUFFERS_TYPE),
)
def run(
    port: LoopPort, controller: ControllerArguments, shared: SharedRing, settings: Any, buffers: Buffers
) -> int:
    """Run the control loop until an end reason; then send zero effort several times, and return the reason.

    The reason (`EndReason`) is also stored in the ring. The caller must set the control word LOOP_DONE, because it must
    be set after an exception of a law too.

    Parameters
    ----------
    port
        Functions of the link and of its clock.
    controller
        Arguments of the law of one tick (`rig.control.step`).
    shared
        Ring that recorder and supervisor share with the loop.
    settings, buffers
        Memory of the loop (`rig.loop.layout`).
    """
    memory, state, words = controller.memory, buffers.state, shared.words
    p, m = buffers.progress[0], memory[0]
    p["last_fresh"] = port.now(port.clock_handle)
    tick = 0
    reason = 0
    while reason == 0:
        elapsed = _receive(port, settings, buffers, words)
        if elapsed == _NO_SAMPLE:
            continue
        if elapsed < 0:
            reason = -elapsed
            break
        # The first sample has no predecessor: what passed before it is no loss.
        if tick == 0:
            elapsed = 1
        received_ns = p["read_at"]
        renew_parameters(controller, shared, buffers, tick)
        edge_age_s = edge_age_ns(buffers.progress, state, settings) * 1e-9
        current = step(controller, state[STATE.count], edge_age_s, elapsed, state[STATE.current_commanded])
        # The law took too long and the caller has given up waiting.
        if load_word(words + WORD * control_words.STOP) == control_words.ABANDONED:
            store_word(words + WORD * control_words.END_REASON, STOPPED)
            return STOPPED
        computed_ns = port.now(port.clock_handle)
        flag_timing(settings, memory, buffers.progress, elapsed, words)
        compare_command(buffers, memory)
        compare_measured(buffers, memory, elapsed)
        # Before the command is sent: the tick that finds the reason already sends STOP instead of its current.
        mode, sync = MODE_CURRENT, sync_of(memory)
        reason = _outcome(settings, buffers, memory)
        if reason != 0:
            mode, sync = MODE_STOP, NO_SYNC
            current = 0
            m["effort_sent"] = 0.0
            m["current_sent"] = 0
        taken = send_command(port, settings, buffers, mode, current, sync)
        sent_ns = port.now(port.clock_handle)
        add(words, control_words.COMMANDS if taken == 1 else control_words.UNSENT, 1)
        leave_row(controller, shared, settings, buffers, tick, elapsed, received_ns, computed_ns, sent_ns)
        tick += 1
        store_word(words + WORD * control_words.TICKS, tick)
        store_word(words + WORD * control_words.PHASE, shown_phase(memory))
        if taken >= 0 and reason == 0:
            taken = ask_time(port, settings, buffers)
        if taken < 0:
            store_word(words + WORD * control_words.END_ERRNO, -taken)
            reason = CLOSED
    # Also on a closed link: one whose reading fails may still transmit. The caller sends them again.
    for _ in range(STOP_FRAMES):
        send_command(port, settings, buffers, MODE_STOP, 0, NO_SYNC)
    store_word(words + WORD * control_words.END_REASON, reason)
    return int(reason)
