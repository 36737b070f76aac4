"""The loop that a person's hand feels, as one compiled function without the GIL.

For each fresh STATE: read the count, run `rig.control.step`, answer with a COMMAND, leave one row in the ring. The beat
is the device's (block until a sample arrives, one period at most) or the host's (wake on a grid of its own that does
not drift, skip what passed, never burst, and take the newest sample that is there). Nothing blocks without a bound, so
that the stop word, a signal and the heartbeat are seen within a tick. The link is drained every time and the newest
sample kept; those behind it are counted as skipped, those that never came as lost: the law saw neither.

Estimator, law, link and clock are plug points (`rig.realtime.plugs`), so that this text is compiled once for all of
them: the in-memory link in virtual time and a serial port in real time run the same machine code.

Whatever ends the loop, it sends several STOP commands before it returns, and its caller sends them again.
"""

from __future__ import annotations

from typing import Any

from numba import types

from firmware_protocol.connection import State
from rig.control.step import CONTROL_TYPE, MEMORY_TYPE, step
from rig.devices.framed import STOP_FRAMES
from rig.loop.commands import MODE_CURRENT, MODE_STOP, NO_SYNC, send_command, sync_of
from rig.loop.ending import CLOSED, FAULT, OVERRUN, SILENT, STOPPED, ended_by_law, told_to_end
from rig.loop.exchange import ask_time
from rig.loop.layout import (
    BYTES,
    FLOAT_ROWS,
    FLOATS,
    INT_ROWS,
    INTS,
    PROGRESS_TYPE,
    ROWS_TYPE,
    SETTINGS_TYPE,
    WORD,
)
from rig.loop.parameters import renew_parameters
from rig.loop.receive import add, drain, newest_state
from rig.loop.rows import FLAG_GAP, FLAG_LATE, edge_age_ns, flag_timing, lateness, leave_row
from rig.realtime import ring
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR, LAW, NOW, TRANSFER, WAIT

_FAULT_STATE = int(State.FAULT)
SHORTEST_WAIT_NS = 200_000
LONGEST_WAIT_NS = 10_000_000


@kernel(types.boolean(SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE))
def _overran(settings: Any, memory: Any, progress: Any) -> bool:
    """Whether this tick came more than one period late.

    Device-paced, the newest of several samples is in time though those behind it were not: they are what tells.
    """
    flags = memory[0]["flags"]
    behind = settings[0]["host_paced"] == 0 and flags & FLAG_GAP != 0 and progress[0]["fresh"] > 1
    return bool(behind or flags & FLAG_LATE != 0)


@kernel(types.int64(INTS, SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE))
def _outcome(state: Any, settings: Any, memory: Any, progress: Any) -> int:
    """End reason that follows from this tick, 0 to go on."""
    if state[STATE.fault] != 0 or state[STATE.state] == _FAULT_STATE:
        return FAULT
    reason = ended_by_law(memory)
    if reason == 0 and settings[0]["stop_when_late"] != 0 and _overran(settings, memory, progress):
        reason = OVERRUN
    return int(reason)


@kernel(types.void(WAIT, NOW, types.int64, SETTINGS_TYPE, PROGRESS_TYPE, types.uintp))
def _sleep_to_the_grid(sleep: Any, now: Any, clock: int, settings: Any, progress: Any, words: int) -> None:
    """Host-paced: sleep to the next point of the grid. Points that passed before it woke are counted and left out."""
    s, p = settings[0], progress[0]
    if p["deadline"] == 0:
        p["deadline"] = now(clock)
    p["deadline"] += s["period_ns"]
    sleep(clock, p["deadline"] - s["spin_ns"])
    woke = now(clock)
    while woke < p["deadline"]:
        woke = now(clock)
    p["late"] = woke - p["deadline"]
    passed = p["late"] // s["period_ns"]
    p["deadline"] += passed * s["period_ns"]
    add(words, ring.OVERRUNS, passed)


_NO_SAMPLE = 0
_ENDS = -1  # times an EndReason: what `_receive` returns instead of a number of samples


@kernel(
    types.int64(
        TRANSFER, WAIT, NOW, WAIT, types.int64, types.int64, SETTINGS_TYPE, types.uintp,
        BYTES, BYTES, INTS, INTS, INTS, INTS, INT_ROWS, PROGRESS_TYPE,
    )
)  # fmt: skip
def _receive(
    read: Any, wait: Any, now: Any, sleep: Any, link: int, clock: int, settings: Any, words: int,
    received: Any, raw: Any, header: Any, candidate: Any, state: Any, times: Any, exchanges: Any, progress: Any,
) -> int:  # fmt: skip
    """Wait for the next beat, one period at most: samples passed, 0 for none, or minus the reason to end."""
    s, p = settings[0], progress[0]
    reason = told_to_end(now, clock, settings, words)
    if reason != 0:
        return _ENDS * reason
    until_ns = now(clock)
    if s["host_paced"] != 0:
        _sleep_to_the_grid(sleep, now, clock, settings, progress, words)
        until_ns = now(clock)  # a link in virtual time brings its device to here; nothing is waited for
    else:
        until_ns += min(max(s["period_ns"], SHORTEST_WAIT_NS), LONGEST_WAIT_NS)
    ready = wait(link, until_ns)
    if ready > 0:
        ready = drain(read, link, received, progress)
    p["read_at"] = now(clock)
    passed = newest_state(
        received, raw, header, candidate, state, times, exchanges, progress,
        s["session"], s["device_tick_ps"], words,
    )  # fmt: skip
    if passed > 0:
        p["last_fresh"] = p["read_at"]
        if s["host_paced"] == 0:
            p["late"] = lateness(settings, progress, p["read_at"])
        return int(passed)
    if ready < 0:
        store_word(words + WORD * ring.END_ERRNO, -ready)
        return _ENDS * CLOSED
    if p["read_at"] - p["last_fresh"] > s["lost_after_ns"]:
        return _ENDS * SILENT
    if s["host_paced"] != 0:
        add(words, ring.STALE, 1)
    return _NO_SAMPLE


@kernel(
    types.int64(
        TRANSFER, TRANSFER, WAIT, NOW, WAIT, ESTIMATOR, LAW, types.int64, types.int64,
        SETTINGS_TYPE, CONTROL_TYPE, MEMORY_TYPE, FLOATS, INTS, FLOATS, FLOATS, FLOATS,
        types.uintp, types.uintp, ROWS_TYPE, BYTES, BYTES, BYTES, INTS, INTS, INTS, INTS, INTS, INTS, INT_ROWS,
        FLOATS, FLOAT_ROWS, PROGRESS_TYPE,
    ),
    borrow=True,  # a law that raises leaves without giving back what was counted: arrays would stay for good
)  # fmt: skip
def run(
    read: Any, write: Any, wait: Any, now: Any, sleep: Any, estimator: Any, law: Any, link: int, clock: int,
    settings: Any, control: Any, memory: Any, estimator_f: Any, estimator_i: Any, estimator_p: Any,
    law_state: Any, law_parameters: Any,
    words: int, mailbox: int, rows: Any, received: Any, raw: Any, transmit: Any, header: Any, candidate: Any,
    state: Any, command: Any, question: Any, times: Any, exchanges: Any, waiting: Any, sets: Any, progress: Any,
) -> int:  # fmt: skip
    """Run until something ends it; then zero first, several times, then the reason.

    Parameters
    ----------
    read, write, wait, now, sleep, link, clock
        Plug points of the link and its clock with their handles (`rig.devices.device.LoopPort`).
    estimator, law
        Plug points of the controller.
    settings, control, memory, estimator_*, law_*
        `rig.loop.layout.SETTINGS`, and the arguments of `rig.control.step.step`.
    words, mailbox, rows
        Addresses of the ring's control words and of its parameter mailbox (0: none), and its rows
        (`rig.realtime.ring`).
    received … progress
        The fields of `rig.loop.layout.Buffers`.

    Returns
    -------
    int
        `EndReason`; also stored in the ring. LOOP_DONE is the caller's to set, because it must be set after an
        exception of a law too.
    """
    p, m = progress[0], memory[0]
    p["last_fresh"] = now(clock)
    tick = 0
    reason = 0
    while reason == 0:
        elapsed = _receive(
            read, wait, now, sleep, link, clock, settings, words,
            received, raw, header, candidate, state, times, exchanges, progress,
        )  # fmt: skip
        if elapsed == _NO_SAMPLE:
            continue
        if elapsed < 0:
            reason = -elapsed
            break
        if tick == 0:
            elapsed = 1
        received_ns = p["read_at"]
        renew_parameters(
            mailbox, control, law_parameters, waiting, sets, progress, state[STATE.count], tick, words
        )
        current = step(
            estimator, law, state[STATE.count], edge_age_ns(progress, state, settings) * 1e-9, elapsed,
            control, memory, estimator_f, estimator_i, estimator_p, law_state, law_parameters,
        )  # fmt: skip
        if (
            load_word(words + WORD * ring.STOP) == ring.ABANDONED
        ):  # a law that took for ever: nobody waits for us
            store_word(words + WORD * ring.END_REASON, STOPPED)
            return STOPPED
        computed_ns = now(clock)
        flag_timing(settings, memory, progress, elapsed, words)
        mode, sync = MODE_CURRENT, sync_of(memory)
        reason = _outcome(state, settings, memory, progress)
        if reason != 0:
            mode, sync = MODE_STOP, NO_SYNC
            current = 0
            m["effort_sent"] = 0.0
            m["current_sent"] = 0
        taken = send_command(write, link, settings, progress, command, transmit, mode, current, sync)
        sent_ns = now(clock)
        add(words, ring.COMMANDS if taken == 1 else ring.UNSENT, 1)
        leave_row(
            words,
            rows,
            tick,
            elapsed,
            received_ns,
            computed_ns,
            sent_ns,
            state,
            progress,
            settings,
            control,
            memory,
        )
        tick += 1
        store_word(words + WORD * ring.TICKS, tick)
        store_word(words + WORD * ring.PHASE, m["phase"])
        if taken >= 0 and reason == 0:
            taken = ask_time(write, now, link, clock, settings, progress, question, transmit)
        if taken < 0:
            store_word(words + WORD * ring.END_ERRNO, -taken)
            reason = CLOSED
    for _ in range(STOP_FRAMES):  # also on a closed link: one that only reads badly still carries them
        send_command(write, link, settings, progress, command, transmit, MODE_STOP, 0, NO_SYNC)
    store_word(words + WORD * ring.END_REASON, reason)
    return int(reason)
