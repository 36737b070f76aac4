"""The loop that a person's hand feels, as one compiled function without the GIL.

For each fresh STATE: read the count, run `rig.step`, answer with a COMMAND, leave one row in the ring.
Pacing is the device's: the loop blocks until a sample arrives, never without a bound, so that the stop word
and the heartbeat are seen within a tick. It drains the link every time and keeps the newest sample; the
ones it had to skip are counted as lost, because the law did not see them.

Estimator, law, link and clock are plug points (`rig.plugs`), so that this text is compiled once for all of
them: the in-memory link in virtual time and a serial port in real time run the same machine code.

Whatever ends the loop, it sends several STOP commands before it returns, and its caller sends them again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numba
import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import codec
from firmware_protocol.codec import COMMAND, HEAD, STATE
from firmware_protocol.connection import State
from firmware_protocol.kernel import kernel
from firmware_protocol.messages import Mode
from rig import ring
from rig.devices.framed import STOP_FRAMES
from rig.plugs import ESTIMATOR, LAW, NOW, TRANSFER, WAIT
from rig.sample import ROW, RowFlag
from rig.step import CONTROL_TYPE, DONE, MEMORY_TYPE, step
from rig.step import HOMING_FAILED as FLAG_HOMING
from rig.step import NONFINITE as FLAG_NONFINITE
from rig.step import OUT_OF_WINDOW as FLAG_WINDOW
from rig.system import monotonic_now, sleep_until
from rig.words import load_word, store_word


class EndReason(IntEnum):
    """Why the loop ended."""

    RUNNING = 0
    FINISHED = 1  # all phases done
    STOPPED = 2  # somebody set the stop word
    HEARTBEAT_MISSED = 3  # the supervisor fell silent
    LINK_CLOSED = 4  # the port is gone (END_ERRNO says why)
    LINK_SILENT = 5  # no fresh sample for too long
    DEVICE_FAULT = 6  # the device latched a fault
    NONFINITE = 7  # law or estimator gave NaN or infinity
    OUT_OF_WINDOW = 8  # position window or speed limit
    HOMING_FAILED = 9  # the start was not reached in time
    LAW_RAISED = 10  # law or estimator raised an exception (set by the caller)


SETTINGS = np.dtype(
    [
        ("period_ns", "<i8"),
        ("session", "<i8"),
        ("lifetime_us", "<i8"),  # of every command: the device's watchdog
        ("lost_after_ns", "<i8"),  # silence that ends the run
        ("device_tick_ps", "<i8"),  # unit of the device's clock
        ("current_quantum_a", "<f8"),
        (
            "wait_for_room",
            "<i8",
        ),  # 1: wait for the recorder when the ring is full (virtual time); 0: drop, count
    ],
    align=True,
)

# What the loop remembers of the link, one row: sequence numbers and the two clocks extended to 64 bits.
PROGRESS = np.dtype(
    [
        ("filled", "<i8"),  # bytes of an unfinished frame at the front of the receive buffer
        ("started", "<i8"),
        ("answers", "<i8"),  # header sequence of the newest STATE
        ("sequence", "<i8"),  # of the next COMMAND
        ("sample_index", "<i8"),
        ("device_time", "<i8"),  # device ticks
        ("earliest", "<i8"),  # least receipt time minus its place on the grid (ns)
        ("last_fresh", "<i8"),  # host time of the newest fresh sample (ns)
    ],
    align=True,
)

_MODE_CURRENT, _MODE_STOP, _FAULT_STATE = int(Mode.CURRENT), int(Mode.STOP), int(State.FAULT)
_FINISHED, _STOPPED, _HEARTBEAT = (int(EndReason[n]) for n in ("FINISHED", "STOPPED", "HEARTBEAT_MISSED"))
_CLOSED, _SILENT, _FAULT = (int(EndReason[n]) for n in ("LINK_CLOSED", "LINK_SILENT", "DEVICE_FAULT"))
_NONFINITE, _WINDOW, _HOMING = (int(EndReason[n]) for n in ("NONFINITE", "OUT_OF_WINDOW", "HOMING_FAILED"))
_FLAG_LATE, _FLAG_GAP = int(RowFlag.LATE), int(RowFlag.GAP)
_WORD = 8
WRAP = 1 << 32
RECEIVE_BYTES = 4096
SHORTEST_WAIT_NS = 200_000
LONGEST_WAIT_NS = 10_000_000
DRIFT_PPM = 100  # the host's grid may stretch by this much against the device's: two ordinary crystals
ROOM_POLL_NS = 50_000

_FLOATS, _INTS, _BYTES = types.float64[::1], types.int64[::1], types.uint8[::1]
SETTINGS_TYPE = types.Array(numba.from_dtype(SETTINGS), 1, "C")
PROGRESS_TYPE = types.Array(numba.from_dtype(PROGRESS), 1, "C")
ROWS_TYPE = types.Array(numba.from_dtype(ROW), 1, "C")


@dataclass(frozen=True, slots=True)
class Buffers:
    """Everything the loop writes into besides the ring: allocated once, since the loop allocates nothing."""

    received: NDArray[np.uint8]
    raw: NDArray[np.uint8]
    transmit: NDArray[np.uint8]
    header: NDArray[np.int64]
    candidate: NDArray[np.int64]
    state: NDArray[np.int64]
    command: NDArray[np.int64]
    progress: NDArray[np.void]

    @classmethod
    def allocate(cls) -> Buffers:
        """Make them, zeroed."""
        return cls(
            received=np.zeros(RECEIVE_BYTES, np.uint8),
            raw=np.zeros(codec.RAW_BYTES, np.uint8),
            transmit=np.zeros(codec.FRAME_BYTES, np.uint8),
            header=np.zeros(len(HEAD), np.int64),
            candidate=np.zeros(len(STATE), np.int64),
            state=np.zeros(len(STATE), np.int64),
            command=np.zeros(len(COMMAND), np.int64),
            progress=np.zeros(1, PROGRESS),
        )


@kernel(types.void(types.uintp, types.int64))
def _count(words: int, word: int) -> None:
    store_word(words + _WORD * word, load_word(words + _WORD * word) + 1)


@kernel(types.int64(_BYTES, types.int64, _INTS, _INTS, _INTS, PROGRESS_TYPE, types.int64, types.uintp))
def _take(
    raw: Any, length: int, header: Any, candidate: Any, state: Any, progress: Any, session: int, words: int
) -> int:
    """Keep a frame in `state` if it is a newer STATE of this session; return by how many samples."""
    if codec.decode_state(raw, length, header, candidate) != 0 or header[HEAD.session] != session:
        _count(words, ring.OTHER_FRAMES)
        return 0
    p = progress[0]
    newer = 1
    if p["started"] != 0:
        newer = (candidate[STATE.sample_index] - p["sample_index"] + WRAP // 2) % WRAP - WRAP // 2
    if newer <= 0:
        _count(words, ring.DUPLICATED if newer == 0 else ring.REORDERED)
        return 0
    if p["started"] == 0:
        p["sample_index"] = candidate[STATE.sample_index]
        p["device_time"] = candidate[STATE.device_time]
        p["started"] = 1
    else:
        p["sample_index"] += newer
        p["device_time"] += (candidate[STATE.device_time] - p["device_time"]) % WRAP
    p["answers"] = header[HEAD.sequence]
    for i in range(len(state)):
        state[i] = candidate[i]
    return newer


@kernel(types.int64(_BYTES, _BYTES, _INTS, _INTS, _INTS, PROGRESS_TYPE, types.int64, types.uintp))
def newest_state(
    received: Any, raw: Any, header: Any, candidate: Any, state: Any, progress: Any, session: int, words: int
) -> int:
    """Take the whole frames out of the receive buffer and leave the newest fresh STATE in `state`.

    Returns the samples passed since the last one delivered, 0 when nothing is fresh. An unfinished frame
    moves to the front of the buffer; two kilobytes without a delimiter are noise and are thrown away.
    """
    end = progress[0]["filled"]
    start = 0
    passed = 0
    while True:
        stop = codec.find_delimiter(received, start, end)
        if stop < 0:
            break
        if stop > start:
            length = codec.decode_frame(received, start, stop, raw)
            if length < 0:
                _count(words, ring.BAD_FRAMES)
            else:
                _count(words, ring.FRAMES)
                passed += _take(raw, length, header, candidate, state, progress, session, words)
        start = stop + 1
    rest = end - start
    if rest > RECEIVE_BYTES // 2:
        _count(words, ring.BAD_FRAMES)
        rest = 0
    for i in range(rest):
        received[i] = received[start + i]
    progress[0]["filled"] = rest
    return passed


@kernel(types.int64(TRANSFER, types.int64, _BYTES, PROGRESS_TYPE))
def _drain(read: Any, link: int, received: Any, progress: Any) -> int:
    """Read all that is there into the receive buffer: 0, or the negative errno of a broken link."""
    while progress[0]["filled"] < RECEIVE_BYTES:
        filled = progress[0]["filled"]
        got = read(link, np.int64(received.ctypes.data) + filled, np.int64(RECEIVE_BYTES - filled))
        if got <= 0:
            return int(got)
        progress[0]["filled"] += got
    return 0


@kernel(
    types.int64(TRANSFER, types.int64, SETTINGS_TYPE, PROGRESS_TYPE, _INTS, _BYTES, types.int64, types.int64)
)
def _send(
    write: Any, link: int, settings: Any, progress: Any, command: Any, transmit: Any, mode: int, current: int
) -> int:
    """Send one COMMAND: 1 when the link took it whole, 0 when not, negative errno when the link is broken."""
    p = progress[0]
    command[COMMAND.state_sequence] = p["answers"]
    command[COMMAND.lifetime_us] = settings[0]["lifetime_us"]
    command[COMMAND.mode] = mode
    command[COMMAND.current] = current
    size = codec.encode_command(settings[0]["session"], p["sequence"], command, transmit)
    p["sequence"] = (p["sequence"] + 1) % 65536
    if size < 0:  # a value that no field of the wire holds: nothing leaves
        return 0
    sent = write(link, np.int64(transmit.ctypes.data), size)
    if sent < 0:
        return int(sent)
    return 1 if sent == size else 0


@kernel(types.int64(SETTINGS_TYPE, PROGRESS_TYPE, types.int64))
def _lateness(settings: Any, progress: Any, received_ns: int) -> int:
    """Receipt behind the grid of the sample index, against the earliest receipt so far (ns)."""
    p = progress[0]
    offset = received_ns - p["sample_index"] * settings[0]["period_ns"]
    stretched = p["earliest"] + settings[0]["period_ns"] * DRIFT_PPM // 1_000_000
    p["earliest"] = min(offset, stretched)
    return int(offset - p["earliest"])


@kernel(types.int64(types.uintp, types.int64, types.int64))
def _room(words: int, capacity: int, wait_for_room: int) -> int:
    """Slot for the next row, or -1 when the ring is full and must not be waited for."""
    head = load_word(words + _WORD * ring.HEAD)
    while head - load_word(words + _WORD * ring.TAIL) >= capacity:
        if wait_for_room == 0 or load_word(words + _WORD * ring.RECORDER_ERROR) != 0:
            _count(words, ring.DROPPED)
            return -1
        sleep_until(monotonic_now(0) + ROOM_POLL_NS)
    return int(head % capacity)


@kernel(types.int64(PROGRESS_TYPE, _INTS, SETTINGS_TYPE))
def _edge_age_ns(progress: Any, state: Any, settings: Any) -> int:
    """Age of the last encoder edge at the sample; the device's clock wraps, so an age is a difference."""
    ticks = (progress[0]["device_time"] - state[STATE.edge_time]) % WRAP
    return int(ticks * settings[0]["device_tick_ps"] // 1000)


@kernel(types.void(ROWS_TYPE, types.int64, MEMORY_TYPE), inline=True)
def show_law(rows: Any, slot: int, memory: Any) -> None:
    """Put what `step` left in its memory into a row: all that a replay computes anew."""
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


@kernel(
    types.void(
        ROWS_TYPE, types.int64, types.int64, types.int64, types.int64, types.int64, types.int64,
        _INTS, PROGRESS_TYPE, SETTINGS_TYPE, CONTROL_TYPE, MEMORY_TYPE, types.int64,
    )
)  # fmt: skip
def _fill_row(
    rows: Any, slot: int, tick: int, elapsed: int, received_ns: int, computed_ns: int, sent_ns: int,
    state: Any, progress: Any, settings: Any, control: Any, memory: Any, late: int,
) -> None:  # fmt: skip
    """One row of `rig.sample.COLUMNS`; the effort in force follows from the current in force."""
    r, p, s = rows[slot], progress[0], settings[0]
    quantum = control[0]["effort_quantum"]
    r["tick"] = tick
    r["sample_index"] = p["sample_index"]
    r["elapsed_ticks"] = elapsed
    r["host_time"] = received_ns
    r["device_time"] = p["device_time"] * s["device_tick_ps"] // 1000
    r["lateness"] = late
    r["count"] = state[STATE.count]
    r["edge_age"] = _edge_age_ns(progress, state, settings)
    r["effort_applied"] = state[STATE.current_commanded] * quantum
    r["current_applied"] = state[STATE.current_commanded]
    r["current_measured"] = state[STATE.current_measured] * s["current_quantum_a"]
    r["command_age"] = state[STATE.command_age]
    r["limits"] = state[STATE.limits]
    r["fault"] = state[STATE.fault]
    r["device_state"] = state[STATE.state]
    r["inputs"] = state[STATE.inputs]
    r["missed_ticks"] = state[STATE.missed_ticks]
    r["execution_time"] = state[STATE.execution_time] * s["device_tick_ps"] // 1000
    show_law(rows, slot, memory)
    r["received_at"] = received_ns
    r["computed_at"] = computed_ns
    r["sent_at"] = sent_ns
    r["sampled_at"] = 0  # sealing fills these two in, when the clocks can be compared
    r["applied_at"] = 0


@kernel(types.int64(_INTS, MEMORY_TYPE))
def _outcome(state: Any, memory: Any) -> int:
    """End reason that follows from this tick, 0 to go on."""
    flags = memory[0]["flags"]
    if state[STATE.fault] != 0 or state[STATE.state] == _FAULT_STATE:
        return _FAULT
    if flags & FLAG_NONFINITE:
        return _NONFINITE
    if flags & FLAG_WINDOW:
        return _WINDOW
    if flags & FLAG_HOMING:
        return _HOMING
    if memory[0]["phase"] == DONE:
        return _FINISHED
    return 0


_NO_SAMPLE = 0
_ENDS = -1  # times an EndReason: what `_receive` returns instead of a number of samples


@kernel(
    types.int64(
        TRANSFER, WAIT, NOW, types.int64, types.int64, SETTINGS_TYPE, types.uintp,
        _BYTES, _BYTES, _INTS, _INTS, _INTS, PROGRESS_TYPE,
    )
)  # fmt: skip
def _receive(
    read: Any, wait: Any, now: Any, link: int, clock: int, settings: Any, words: int,
    received: Any, raw: Any, header: Any, candidate: Any, state: Any, progress: Any,
) -> int:  # fmt: skip
    """Wait for one period at most: samples passed, 0 for none, or minus the reason to end."""
    s, p = settings[0], progress[0]
    time_ns = now(clock)
    if load_word(words + _WORD * ring.STOP) != 0:
        return _ENDS * _STOPPED
    alive_until = load_word(words + _WORD * ring.HEARTBEAT)
    if alive_until != 0 and time_ns > alive_until:
        return _ENDS * _HEARTBEAT
    pause_ns = min(max(s["period_ns"], SHORTEST_WAIT_NS), LONGEST_WAIT_NS)
    ready = wait(link, time_ns + pause_ns)
    if ready > 0:
        ready = _drain(read, link, received, progress)
    passed = newest_state(received, raw, header, candidate, state, progress, s["session"], words)
    if passed > 0:
        p["last_fresh"] = now(clock)
        return int(passed)
    if ready < 0:
        store_word(words + _WORD * ring.END_ERRNO, -ready)
        return _ENDS * _CLOSED
    if now(clock) - p["last_fresh"] > s["lost_after_ns"]:
        return _ENDS * _SILENT
    return _NO_SAMPLE


@kernel(types.void(SETTINGS_TYPE, MEMORY_TYPE, PROGRESS_TYPE, types.int64, types.int64, types.uintp))
def _flag_timing(settings: Any, memory: Any, progress: Any, elapsed: int, late_ns: int, words: int) -> None:
    """Flag and count lateness and gaps of this tick."""
    if late_ns > settings[0]["period_ns"]:
        memory[0]["flags"] |= _FLAG_LATE
        _count(words, ring.LATE)
    if elapsed > 1:
        memory[0]["flags"] |= _FLAG_GAP
        store_word(words + _WORD * ring.LOST, load_word(words + _WORD * ring.LOST) + elapsed - 1)


@kernel(
    types.int64(
        TRANSFER, TRANSFER, WAIT, NOW, ESTIMATOR, LAW, types.int64, types.int64,
        SETTINGS_TYPE, CONTROL_TYPE, MEMORY_TYPE, _FLOATS, _INTS, _FLOATS, _FLOATS, _FLOATS,
        types.uintp, ROWS_TYPE, _BYTES, _BYTES, _BYTES, _INTS, _INTS, _INTS, _INTS, PROGRESS_TYPE,
    )
)  # fmt: skip
def run(
    read: Any, write: Any, wait: Any, now: Any, estimator: Any, law: Any, link: int, clock: int,
    settings: Any, control: Any, memory: Any, estimator_f: Any, estimator_i: Any, estimator_p: Any,
    law_state: Any, law_parameters: Any,
    words: int, rows: Any, received: Any, raw: Any, transmit: Any, header: Any, candidate: Any, state: Any,
    command: Any, progress: Any,
) -> int:  # fmt: skip
    """Run until something ends it; then zero first, several times, then the reason.

    Parameters
    ----------
    read, write, wait, now, link, clock
        Plug points of the link and its clock with their handles (`rig.devices.device.LoopPort`).
    estimator, law
        Plug points of the controller.
    settings, control, memory, estimator_*, law_*
        `SETTINGS`, and the arguments of `rig.step.step`.
    words, rows
        Address of the control words and rows of the ring (`rig.ring`).
    received … progress
        The fields of `Buffers`.

    Returns
    -------
    int
        `EndReason`; also stored in the ring. LOOP_DONE is the caller's to set, because it must be set after an
        exception of a law too.
    """
    s, p, m = settings[0], progress[0], memory[0]
    p["last_fresh"] = now(clock)
    tick = 0
    reason = 0
    while reason == 0:
        elapsed = _receive(
            read, wait, now, link, clock, settings, words, received, raw, header, candidate, state, progress
        )
        if elapsed == _NO_SAMPLE:
            continue
        if elapsed < 0:
            reason = -elapsed
            break
        received_ns = p["last_fresh"]
        if tick == 0:
            elapsed = 1
            p["earliest"] = received_ns - p["sample_index"] * s["period_ns"]
        current = step(
            estimator, law, state[STATE.count], _edge_age_ns(progress, state, settings) * 1e-9, elapsed,
            control, memory, estimator_f, estimator_i, estimator_p, law_state, law_parameters,
        )  # fmt: skip
        computed_ns = now(clock)
        mode = _MODE_CURRENT
        reason = _outcome(state, memory)
        if reason != 0:
            mode = _MODE_STOP
            current = 0
            m["effort_sent"] = 0.0
            m["current_sent"] = 0
        taken = _send(write, link, settings, progress, command, transmit, mode, current)
        sent_ns = now(clock)
        _count(words, ring.COMMANDS if taken == 1 else ring.UNSENT)

        late_ns = _lateness(settings, progress, received_ns)
        _flag_timing(settings, memory, progress, elapsed, late_ns, words)
        slot = _room(words, len(rows), s["wait_for_room"])
        if slot >= 0:
            _fill_row(
                rows, slot, tick, elapsed, received_ns, computed_ns, sent_ns,
                state, progress, settings, control, memory, late_ns,
            )  # fmt: skip
            store_word(words + _WORD * ring.HEAD, load_word(words + _WORD * ring.HEAD) + 1)
        tick += 1
        store_word(words + _WORD * ring.TICKS, tick)
        store_word(words + _WORD * ring.PHASE, m["phase"])
        if taken < 0:
            store_word(words + _WORD * ring.END_ERRNO, -taken)
            reason = _CLOSED
    for _ in range(STOP_FRAMES):  # also on a closed link: one that only reads badly still carries them
        _send(write, link, settings, progress, command, transmit, _MODE_STOP, 0)
    store_word(words + _WORD * ring.END_REASON, reason)
    return int(reason)
