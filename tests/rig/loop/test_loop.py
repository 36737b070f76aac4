"""The compiled loop against a scripted far end: its samples, its ends, and its last commands."""

import ctypes
import errno
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from firmware_protocol.framing import decode_frame, encode_frame
from firmware_protocol.messages import STOP_FRAMES
from firmware_protocol.packing import pack, unpack
from rig.config import controller, presets
from rig.control.law import Law
from rig.core.sample import Phase, RowFlag
from rig.devices.port import LoopPort
from rig.loop import _receive as receive
from rig.loop._contradictions import WRAP
from rig.loop._host import run
from rig.loop._rows import DRIFT_PPM
from rig.loop._rows import lateness as row_lateness
from rig.loop._run import LoopSettings, LoopThread
from rig.loop.layout import PROGRESS, RECEIVE_BYTES, Buffers, EndReason
from rig.realtime import control_words, system
from rig.realtime.atomics import load_word, store_word, write_word
from rig.realtime.callbacks import callback_plugs
from rig.realtime.clock import MonotonicClock, VirtualClock
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.realtime.ring import Ring
from rig.recording.reader import open_recording
from rig.recording.recorder import Recorder
from tests.conformance.recording import example_header
from tests.conformance.started import WAIT_S

SESSION = 7
PERIOD_NS = 1_000_000
COMPLIANT = presets.load("koul-compliant")


def state_frame(index: int, *, session: int = SESSION, **fields: int) -> bytes:
    """Return a STATE frame: sample `index` of a device that ticks each millisecond and rests at count 0."""
    times = {"device_time": index * 16_000 % WRAP, "edge_time": (index * 16_000 - 1600) % WRAP}
    known = {
        "sample_index": index % WRAP,
        "command_age": m.NO_COMMAND_YET,
        "state": int(State.RUNNING),
        **times,
    }
    values = dict.fromkeys(STATE._fields, 0) | known | fields
    return encode_frame(pack(m.State(**values), session=session, sequence=index % 65536))


# ---------------------------------------------------------------------- frames: newest_state


class Receiver:
    """The compiled function `newest_state` with its buffers, fed in pieces."""

    def __init__(self) -> None:
        self.buffers, self.ring, self.settings = Buffers.allocate(), Ring.allocate(1), settings().as_array()

    def feed(self, data: bytes) -> int:
        b, p = self.buffers, self.buffers.progress
        filled = int(p[0]["filled"])
        assert filled + len(data) <= RECEIVE_BYTES
        b.received[filled : filled + len(data)] = np.frombuffer(data, np.uint8)
        p[0]["filled"] = filled + len(data)
        words = self.ring.words.ctypes.data
        return int(receive.newest_state(self.settings, b, words))

    @property
    def counters(self) -> dict[str, int]:
        names = ("FRAMES", "BAD_FRAMES", "OTHER_FRAMES", "DUPLICATED", "REORDERED")
        return {name.lower(): self.ring.get(getattr(control_words, name)) for name in names}

    @property
    def sample_index(self) -> int:
        return int(self.buffers.progress[0]["sample_index"])

    @property
    def count(self) -> int:
        return int(self.buffers.state[STATE.count])


def test_the_newest_of_several_frames_is_used() -> None:
    receiver = Receiver()
    assert receiver.feed(b"".join(state_frame(i, count=10 * i) for i in (5, 6, 7, 8))) == 4
    assert (receiver.sample_index, receiver.count) == (8, 80)
    assert receiver.feed(b"") == 0
    assert receiver.feed(state_frame(9, count=90)) == 1


def test_each_frame_that_is_not_used_is_counted() -> None:
    receiver = Receiver()
    receiver.feed(b"\0\0\0" + state_frame(5, count=50) + b"\0\0")
    damaged = bytearray(state_frame(6))
    damaged[9] ^= 0x40
    identity = encode_frame(pack(m.Time(1, 2, 3, 4)))
    foreign = encode_frame(bytes([m.MAJOR + 1]) + decode_frame(state_frame(6)[:-1])[1:])
    assert receiver.feed(bytes(damaged)) == 0
    assert receiver.feed(state_frame(5)) == 0
    assert receiver.feed(state_frame(4)) == 0
    assert receiver.feed(state_frame(6, session=SESSION + 1)) == 0
    assert receiver.feed(identity + foreign) == 0
    assert receiver.counters == {
        "frames": 6,
        "bad_frames": 1,
        "other_frames": 3,
        "duplicated": 1,
        "reordered": 1,
    }
    assert (receiver.sample_index, receiver.count) == (5, 50)
    assert receiver.feed(state_frame(7)) == 2, "what was lost or damaged is passed too"


def test_sample_index_and_device_time_continue_behind_32_bits() -> None:
    receiver = Receiver()
    start = WRAP - 2
    receiver.feed(state_frame(start))
    assert receiver.feed(state_frame(start + 1) + state_frame(start + 2)) == 2
    assert receiver.feed(state_frame(start + 5)) == 3
    assert receiver.sample_index == start + 5
    ticks = start * 16_000 % WRAP
    assert int(receiver.buffers.progress[0]["device_time"]) == ticks + 5 * 16_000
    assert receiver.feed(state_frame(start)) == 0
    assert receiver.counters["reordered"] == 1


def test_noise_without_a_delimiter_is_bounded_and_the_next_frame_is_received() -> None:
    receiver = Receiver()
    noise = b"\x55" * 700
    for _ in range(20):
        receiver.feed(noise)
        assert receiver.buffers.progress[0]["filled"] <= RECEIVE_BYTES // 2
    assert receiver.counters["frames"] == 0
    assert receiver.counters["bad_frames"] >= 5
    receiver.feed(b"\0")
    assert receiver.feed(state_frame(3)) == 1


PIECES = st.lists(
    st.one_of(
        st.integers(0, 40).map(state_frame),
        st.integers(0, 40).map(lambda i: state_frame(i, session=3)),
        st.binary(max_size=20),
        st.integers(0, 40).map(lambda i: state_frame(i)[: 5 + i]),
        st.just(encode_frame(pack(m.Time(1, 2, 3, 4)))),
    ),
    max_size=30,
)


@given(pieces=PIECES, cuts=st.lists(st.integers(1, 60), min_size=1, max_size=50))
def test_frames_may_be_cut_anywhere(pieces: Any, cuts: list[int]) -> None:
    stream = b"".join(pieces)
    whole, chunked, single = Receiver(), Receiver(), Receiver()
    passed = whole.feed(stream)
    seen = at = 0
    for size in cycle(cuts):
        if at >= len(stream):
            break
        seen += chunked.feed(stream[at : at + size])
        at += size
    assert seen == passed == sum(single.feed(bytes([byte])) for byte in stream)
    for other in (chunked, single):
        assert other.counters == whole.counters
        assert (other.sample_index, other.buffers.state.tolist()) == (
            whole.sample_index,
            whole.buffers.state.tolist(),
        )


# ---------------------------------------------------------------------- lateness


def lateness(receipts_ns: list[int]) -> list[int]:
    values, progress = settings().as_array(), np.zeros(1, PROGRESS)
    progress[0]["earliest"] = receipts_ns[0]
    late = []
    for number, receipt in enumerate(receipts_ns):
        progress[0]["sample_index"] = number
        late.append(int(row_lateness(values, progress, receipt)))
    return late


def test_on_the_grid_nothing_is_late_and_one_late_receipt_does_not_move_the_grid() -> None:
    on_grid = [1_000 + PERIOD_NS * k for k in range(100)]
    assert lateness(on_grid) == [0] * 100
    late = list(on_grid)
    late[50] += 700_000
    result = lateness(late)
    assert 699_000 <= result[50] <= 700_000
    assert result[51:] == [0] * 49


@pytest.mark.parametrize(("ppm", "late"), [(90, False), (-90, False), (1000, True)])
def test_two_ordinary_crystals_may_differ_and_a_slow_host_may_not(ppm: int, late: bool) -> None:
    assert DRIFT_PPM == 100
    result = lateness([round(PERIOD_NS * k * (1 + ppm * 1e-6)) for k in range(20_000)])
    assert (max(result) > PERIOD_NS) is late
    assert min(result) >= 0


@given(st.lists(st.integers(0, 3_000_000), min_size=1, max_size=50))
def test_lateness_is_never_negative_nor_more_than_the_delay(delays: list[int]) -> None:
    result = lateness([PERIOD_NS * k + delay for k, delay in enumerate(delays)])
    assert all(0 <= late <= delay for late, delay in zip(result, delays, strict=True))


# ---------------------------------------------------------------------- whole runs in virtual time


class Script:
    """A far end that sends given bytes at given times, or fails, and records the frames of the host.

    `script` has pairs of a time (ns) and bytes to send, a negative errno, or a function to call.
    """

    def __init__(self, *script: Any) -> None:
        self.clock = VirtualClock(0)
        self.events = sorted(script, key=lambda event: event[0])
        self.arrived = b""
        self.sent = []
        self.error = 0
        self.write_error = 0
        self.room = 1 << 30  # bytes that a write takes

    def _wait(self, deadline_ns: int) -> bool:
        if self.error or self.arrived:
            self._check(self.error)
            return True
        if not self.events or self.events[0][0] > deadline_ns:
            self.clock.sleep_until(deadline_ns)
            return False
        at, what = self.events.pop(0)
        self.clock.sleep_until(at)
        if callable(what):
            what()
            return False
        if isinstance(what, int):
            self.error = what
            self._check(what)
        self.arrived += what
        return True

    def _read(self, size: int) -> bytes:
        data, self.arrived = self.arrived[:size], self.arrived[size:]
        return data

    def _write(self, data: bytes) -> int:
        self._check(self.write_error)
        self.sent.append((self.clock.now_ns(), data))
        return min(len(data), self.room)

    @staticmethod
    def _check(error: int) -> None:
        if error:
            raise OSError(-error, "as the test asks")

    def port(self) -> Any:
        plugs = callback_plugs(read=self._read, write=self._write, wait=self._wait)
        return LoopPort.on(self.clock, **plugs._asdict())

    def failure(self) -> None:
        return None

    def commands(self) -> Any:
        return [unpack(decode_frame(frame[:-1])) for _, frame in self.sent]


def at_rest(law: Any = None, **control: Any) -> Any:
    """Return a controller that homes where the handle is and pushes for ever by default."""
    made = controller.for_experiment(COMPLIANT, current_quantum_a=0.001, law=law)
    wanted = {"home_target": 0.0, "settle_ticks": 0, "trial_ticks": 1 << 40, "release_ticks": 1, **control}
    for name, value in wanted.items():
        made.control[name] = value
    return made


def settings(**changes: Any) -> Any:
    values = {
        "period_ns": PERIOD_NS, "session": SESSION, "lifetime_us": 5_000, "lost_after_ns": 50 * PERIOD_NS,
        "device_tick_ps": 62_500, "current_quantum_a": 0.001, "wait_for_room": False,
    }  # fmt: skip
    return LoopSettings(**{**values, **changes})


def ran(link: Any, bundle: Any = None, *, memory: Any = None, **changes: Any) -> Any:
    memory = memory or Ring.allocate(4096)
    run.prepare()
    thread = LoopThread(link, bundle or at_rest(), settings(**changes), memory)
    thread.start()
    thread._thread.join(WAIT_S)  # in a thread of its own: it blocks all signals there
    assert thread._ended.is_set()
    return thread, thread.end()


def ticks(first: Any, last: Any, **fields: Any) -> Any:
    return [(PERIOD_NS * k, state_frame(k, **fields)) for k in range(first, last)]


def assert_ends_with_stops(link: Any) -> None:
    last = link.commands()[-STOP_FRAMES:]
    assert len(last) == STOP_FRAMES
    for header, command in last:
        assert (command.mode, command.current) == (m.Mode.STOP, 0)
        assert header.session == SESSION


def test_each_fresh_state_is_answered_once_by_a_command_that_names_it() -> None:
    link = Script(*ticks(1, 30))
    thread, end = ran(link)
    assert end.reason == EndReason.LINK_SILENT
    answers = [command for _, command in link.commands() if command.mode == m.Mode.CURRENT]
    assert [answer.state_sequence for answer in answers] == list(range(1, 30))
    assert {answer.lifetime_us for answer in answers} == {5_000}
    assert [header.sequence for header, _ in link.commands()] == list(range(29 + STOP_FRAMES))
    rows = thread.ring.rows[:29]
    assert rows["sample_index"].tolist() == list(range(1, 30))
    assert rows["current_sent"].tolist() == [answer.current for answer in answers]
    assert (np.diff(rows["device_time"]) == 1_000_000).all()
    assert (rows["edge_age"] == 100_000).all()
    assert (end.counters["ticks"], end.counters["commands"]) == (29, 29)
    assert_ends_with_stops(link)


def test_a_silent_link_ends_the_run_after_the_agreed_time() -> None:
    link = Script(*ticks(1, 10))
    _, end = ran(link, lost_after_ns=20 * PERIOD_NS)
    assert end.reason == EndReason.LINK_SILENT
    assert 29 * PERIOD_NS <= link.clock.now_ns() <= 31 * PERIOD_NS
    assert_ends_with_stops(link)


def test_a_device_without_any_frame_is_silent_too() -> None:
    link = Script()
    thread, end = ran(link)
    assert (end.reason, end.counters["ticks"]) == (EndReason.LINK_SILENT, 0)
    assert thread.handover() is None
    assert_ends_with_stops(link)


def test_noise_and_strangers_do_not_keep_a_silent_device_alive() -> None:
    noise = [(PERIOD_NS * k, bytes([k % 255 + 1]) * 300) for k in range(10, 500)]
    strangers = [(PERIOD_NS * k, state_frame(k, session=3)) for k in range(10, 500)]
    link = Script(*ticks(1, 10), *noise, *strangers)
    _, end = ran(link, lost_after_ns=20 * PERIOD_NS)
    assert end.reason == EndReason.LINK_SILENT
    assert link.clock.now_ns() <= 32 * PERIOD_NS


def test_a_link_that_does_not_take_the_command_is_closed() -> None:
    link = Script(*ticks(1, 10))
    link.write_error = -errno.EPIPE
    thread, end = ran(link)
    assert (end.reason, end.counters["errno"], end.counters["ticks"]) == (
        EndReason.LINK_CLOSED,
        errno.EPIPE,
        1,
    )
    assert end.counters["unsent"] == 1
    assert thread.ring.get(control_words.HEAD) == 1, "the tick is recorded all the same"


def test_a_full_line_is_counted_and_survived() -> None:
    link = Script(*ticks(1, 10))
    link.room = 5
    _, end = ran(link)
    assert end.reason == EndReason.LINK_SILENT
    assert (end.counters["unsent"], end.counters["commands"]) == (9, 0)


def test_a_command_that_does_not_fit_the_wire_is_not_sent() -> None:
    link = Script(*ticks(1, 5))
    _, end = ran(link, lifetime_us=1 << 40)
    assert end.counters["unsent"] == 4
    assert link.sent == []


def test_a_broken_link_ends_the_run_with_its_error_number_after_an_answer_to_the_last_state() -> None:
    link = Script(*ticks(1, 10))
    link.events += [(10 * PERIOD_NS, what) for what in (lambda: None, state_frame(10), -errno.ENODEV)]
    _, end = ran(link)
    assert (end.reason, end.counters["errno"]) == (EndReason.LINK_CLOSED, errno.ENODEV)
    assert end.counters["ticks"] == 10
    assert_ends_with_stops(link)


def test_the_stop_word_stops_within_one_period() -> None:
    memory = Ring.allocate(4096)
    link = Script(*ticks(1, 100), (20 * PERIOD_NS + 1, lambda: memory.put(control_words.STOP, 1)))
    _, end = ran(link, memory=memory)
    assert (end.reason, end.counters["ticks"]) == (EndReason.STOPPED, 20)
    assert link.clock.now_ns() <= 21 * PERIOD_NS + 1
    assert_ends_with_stops(link)


def test_a_stop_before_the_start_steps_no_law() -> None:
    memory = Ring.allocate(4096)
    memory.put(control_words.STOP, 1)
    link = Script(*ticks(1, 100))
    _, end = ran(link, memory=memory)
    assert (end.reason, end.counters["ticks"]) == (EndReason.STOPPED, 0)
    assert_ends_with_stops(link)


def test_a_supervisor_that_falls_silent_ends_the_run() -> None:
    memory = Ring.allocate(4096)
    memory.put(control_words.HEARTBEAT, 10 * PERIOD_NS)
    alive = [
        (PERIOD_NS * k + 1, lambda k=k: memory.put(control_words.HEARTBEAT, PERIOD_NS * (k + 10)))
        for k in range(1, 20)
    ]
    link = Script(*ticks(1, 100), *alive)
    _, end = ran(link, memory=memory)
    assert end.reason == EndReason.HEARTBEAT_MISSED
    assert 29 * PERIOD_NS <= link.clock.now_ns() <= 31 * PERIOD_NS
    assert_ends_with_stops(link)


@pytest.mark.parametrize(
    "fields",
    [
        {"fault": int(Fault.ENCODER)},
        {"state": int(State.FAULT)},
        {"state": int(State.CONFIGURED)},
        {"state": 200},
    ],
)
def test_a_fault_of_the_device_ends_the_run_in_the_tick_that_reports_it(fields: Any) -> None:
    link = Script(*ticks(1, 10), *ticks(10, 20, **fields))
    thread, end = ran(link)
    assert (end.reason, end.counters["ticks"]) == (EndReason.DEVICE_FAULT, 10)
    assert thread.ring.rows[9]["current_sent"] == 0
    assert thread.handover()["newest_state"] == 10
    assert_ends_with_stops(link)


def test_the_end_of_the_trial_is_the_end_of_the_run() -> None:
    link = Script(*ticks(1, 100))
    thread, end = ran(link, at_rest(trial_ticks=10, release_ticks=3))
    assert end.reason == EndReason.FINISHED
    phases = thread.ring.rows["phase"][: end.counters["ticks"]]
    assert (phases == Phase.TRIAL).sum() == 10
    assert phases[-1] == Phase.DONE
    assert_ends_with_stops(link)


def test_leaving_the_window_or_an_unreachable_start_end_with_zero() -> None:
    link = Script(*ticks(1, 10), *ticks(10, 20, count=1_000_000))
    _, end = ran(link)
    assert (end.reason, end.counters["ticks"]) == (EndReason.OUT_OF_WINDOW, 10)
    assert_ends_with_stops(link)
    link = Script(*ticks(1, 100))
    thread, end = ran(link, at_rest(home_target=-0.01, home_timeout_ticks=30))
    assert (end.reason, end.counters["ticks"]) == (EndReason.HOMING_FAILED, 32)
    assert thread.ring.rows[31]["flags"] & RowFlag.HOMING_FAILED
    assert_ends_with_stops(link)


@kernel(LAW_SIGNATURE)
def raises(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    state[1] += 1.0
    if state[1] > 3.0:
        raise ValueError("too deep for me")
    return 0.0


def test_an_exception_in_a_law_ends_the_run_and_the_streams_can_be_taken_over() -> None:
    link = Script(*ticks(1, 100))
    thread, end = ran(link, at_rest(Law("raises", "for this test", raises, 2, lambda wall: [])))
    assert end.reason == EndReason.LAW_RAISED
    assert "too deep" in str(end.error)
    assert thread.ring.get(control_words.LOOP_DONE) == 1
    streams = thread.handover()
    assert streams["next_command"] == len(link.sent)
    assert streams["state"] == State.RUNNING


# ---------------------------------------------------------------------- gaps and the ring


def test_skipped_samples_are_one_gap_of_the_law() -> None:
    frames = [state_frame(k) for k in range(1, 8)]
    link = Script((PERIOD_NS, frames[0]), (7 * PERIOD_NS, b"".join(frames[1:])), *ticks(8, 12))
    thread, end = ran(link)
    rows = thread.ring.rows[:6]
    assert rows["elapsed_ticks"].tolist() == [1, 6, 1, 1, 1, 1]
    assert rows["sample_index"].tolist() == [1, 7, 8, 9, 10, 11]
    assert ((rows["flags"] & int(RowFlag.GAP)) != 0).tolist() == [False, True, False, False, False, False]
    assert (end.counters["skipped"], end.counters["lost"]) == (5, 0)
    assert thread._controller.memory[0]["index"] == 10


def test_lost_samples_and_late_samples_are_counted_apart() -> None:
    """The law receives sample 7: 3 and 5 were lost, 4 and 6 arrived together with 7."""
    late = b"".join(state_frame(k) for k in (4, 6, 7))
    link = Script(*ticks(1, 3), (7 * PERIOD_NS, late), *ticks(8, 10))
    thread, end = ran(link)
    assert thread.ring.rows["elapsed_ticks"][:5].tolist() == [1, 1, 5, 1, 1]
    assert (end.counters["skipped"], end.counters["lost"]) == (2, 2)


def test_samples_from_before_the_loop_are_no_gap() -> None:
    link = Script((PERIOD_NS, b"".join(state_frame(k) for k in range(1, 6))), *ticks(6, 9))
    thread, end = ran(link)
    assert thread.ring.rows["elapsed_ticks"][:4].tolist() == [1, 1, 1, 1]
    assert end.counters["lost"] == 0


def test_lateness_beyond_a_period_is_flagged_and_counted() -> None:
    events = ticks(1, 40)
    events[20] = (events[20][0] + 1_500_000, events[20][1])
    events[21] = (events[21][0] + 500_001, events[21][1])
    link = Script(*events)
    thread, end = ran(link)
    late = thread.ring.rows["lateness"][:39]
    assert 1_490_000 <= late[20] <= 1_500_000
    assert ((thread.ring.rows["flags"][:39] & int(RowFlag.LATE)) != 0).nonzero()[0].tolist() == [20]
    assert end.counters["late"] == 1


@pytest.mark.parametrize("recorder_error", [0, errno.ENOSPC])
def test_in_real_time_a_full_ring_drops_rows_and_counts_them(recorder_error: int) -> None:
    """In virtual time, too, a recorder that failed is not waited for."""
    memory = Ring.allocate(8)
    memory.put(control_words.RECORDER_ERROR, recorder_error)
    _, end = ran(Script(*ticks(1, 30)), memory=memory, wait_for_room=recorder_error != 0)
    assert (end.counters["ticks"], end.counters["rows_dropped"]) == (29, 21)
    assert memory.get(control_words.HEAD) == 8
    assert memory.rows["tick"].tolist() == list(range(8))


def test_in_virtual_time_the_loop_waits_for_the_recorder(tmp_path: Path) -> None:
    memory, path = Ring.allocate(8), tmp_path / "trial.rigcap"
    with Recorder(path, example_header(), memory, virtual=True):
        _, end = ran(Script(*ticks(1, 100)), memory=memory, wait_for_room=True)
    assert end.counters["rows_dropped"] == 0
    assert open_recording(path).column("tick").tolist() == list(range(99))


# ---------------------------------------------------------------------- the host's own beat


def test_a_host_paced_loop_wakes_on_its_own_grid_and_takes_the_newest_sample() -> None:
    """Samples come 0.3 ms after the grid, so each tick uses the previous one, 0.7 ms old."""
    link = Script(*((at + 300_000, frame) for at, frame in ticks(0, 30)))
    thread, end = ran(link, host_paced=True)
    seen = thread.ring.rows[: end.counters["ticks"]]
    assert seen["sample_index"].tolist() == list(range(30))
    assert (seen["received_at"] % PERIOD_NS == 0).all()
    assert (seen["lateness"] == 0).all()
    assert end.reason == EndReason.LINK_SILENT
    assert (end.counters["overruns"], end.counters["skipped"], end.counters["lost"]) == (0, 0, 0)
    assert end.counters["stale"] == 50, "the ticks after the last sample, until the silence was too long"
    assert_ends_with_stops(link)


def test_a_tick_without_a_fresh_sample_steps_no_law_and_sends_nothing() -> None:
    slow = [(2 * PERIOD_NS * k + 1, state_frame(k)) for k in range(10)]
    link = Script(*slow)
    thread, end = ran(link, host_paced=True, lost_after_ns=5 * PERIOD_NS)
    assert end.counters["ticks"] == end.counters["commands"] == 10
    assert end.counters["stale"] == 9 + 5, "between the samples, and until the silence was too long"
    assert thread.ring.rows["elapsed_ticks"][:10].tolist() == [1] * 10


def link_with_pause(duration_ns: Any) -> Any:
    """Return a far end with thirty samples whose host pauses for a while after the tenth tick."""
    link = Script(*((at + 1, frame) for at, frame in ticks(0, 30)))
    link.events.insert(
        10, (9 * PERIOD_NS + 2, lambda: link.clock.sleep_until(link.clock.now_ns() + duration_ns))
    )
    return link


def test_missed_grid_points_are_counted_and_not_repeated() -> None:
    link = link_with_pause(4_500_000)
    thread, end = ran(link, host_paced=True)
    seen = thread.ring.rows[: end.counters["ticks"]]
    assert end.counters["overruns"] == 3
    assert np.diff(seen["received_at"]).max() <= 6 * PERIOD_NS
    assert (seen["received_at"] % PERIOD_NS <= 500_002).all(), "the grid is where it was"
    assert np.diff(seen["received_at"]).min() > 0
    assert end.counters["skipped"] + end.counters["lost"] == 29 - (len(seen) - 1)


@pytest.mark.parametrize("host_paced", [False, True])
def test_a_late_tick_ends_the_run_with_zero_where_that_is_set(host_paced: bool) -> None:
    late = Script(*ticks(1, 20), (22 * PERIOD_NS, state_frame(20)), *ticks(22, 40))
    link = link_with_pause(2_500_000) if host_paced else late
    thread, end = ran(link, host_paced=host_paced, stop_when_late=True)
    assert end.reason == EndReason.OVERRUN
    assert end.counters["late"] == 1
    last = thread.ring.rows[end.counters["ticks"] - 1]
    assert last["flags"] & RowFlag.LATE
    assert (last["current_sent"], last["effort_sent"]) == (0, 0.0)
    assert_ends_with_stops(link)


def test_a_device_paced_host_that_was_away_is_late_though_the_newest_sample_is_not() -> None:
    """Two samples wait after the pause; the older one waited for 1.5 periods and is never answered."""
    both = (11 * PERIOD_NS + PERIOD_NS // 2, state_frame(10) + state_frame(11))
    link = Script(*ticks(1, 10), both, *ticks(12, 20))
    thread, end = ran(link, stop_when_late=True)
    assert end.reason == EndReason.OVERRUN
    assert (end.counters["late"], end.counters["skipped"]) == (0, 1)
    assert thread.ring.rows["current_sent"][end.counters["ticks"] - 1] == 0
    assert_ends_with_stops(link)


@pytest.mark.quiet
def test_a_host_paced_loop_in_real_time_keeps_its_grid_and_may_spin_at_the_end_of_a_wait(wire: Any) -> None:
    thread, memory = start(wire, host_paced=True, spin_ns=100_000)
    for k in range(1, 40):
        os.write(wire.theirs.fileno(), state_frame(k))
        time.sleep(0.001)
    until(lambda: memory.get(control_words.TICKS) > 0)
    thread.finish()
    end = thread.end()
    assert end.reason == EndReason.STOPPED
    seen = memory.rows[: end.counters["ticks"]]
    assert (seen["lateness"] >= 0).all(), "never early"
    beat = (seen["received_at"] - seen["lateness"]) % PERIOD_NS
    assert np.ptp(beat) < 500_000, "all on one grid, but for what passes between waking and reading"


# ---------------------------------------------------------------------- signals


def test_a_signal_stops_the_loop_while_python_does_not_run(wire: Any) -> None:
    requests = np.array([7], np.int64)
    thread, memory = start(wire, stop_requests=requests.ctypes.data, stop_requests_before=7)
    try:
        wire.theirs.send(state_frame(1))
        until(lambda: memory.get(control_words.TICKS) == 1)
        assert memory.get(control_words.STOP) == 0
        requests[0] = 8
        until(lambda: memory.get(control_words.LOOP_DONE) == 1)
    finally:
        thread.finish()
    assert thread.end().reason == EndReason.STOPPED
    assert memory.get(control_words.STOP) == 1


# ---------------------------------------------------------------------- clocks


class Answering(Script):
    """A far end that also replies to GET_TIME, `delay_ns` later, with a clock of its own."""

    offset_units = 1_000_000
    delay_ns = 200_000

    def _write(self, data: bytes) -> int:
        taken = super()._write(data)
        header, message = unpack(decode_frame(self.sent[-1][1][:-1]))
        if isinstance(message, m.GetTime):
            received = self.clock.now_ns() * 16 // 1000 + self.offset_units
            answer = m.Time(message.nonce, message.host_sent, received, received + 16)
            at = self.clock.now_ns() + self.delay_ns
            self.events.append((at, encode_frame(pack(answer, session=header.session))))
            self.events.sort(key=lambda event: event[0])
        return taken


def test_clocks_are_compared_on_the_way_with_four_stamps() -> None:
    link = Answering(*((at + 500_000, frame) for at, frame in ticks(1, 100)))
    thread, end = ran(link, exchange_every_ns=10 * PERIOD_NS)
    exchanges = thread.exchanges()
    assert end.counters["exchanges"] == len(exchanges) >= 9
    assert (exchanges[:, 3] - exchanges[:, 0] == 200_000).all()
    offset_ns = link.offset_units * 62_500 // 1000
    assert (np.abs(exchanges[:, 1] - exchanges[:, 0] - offset_ns) <= 63).all()
    assert (exchanges[:, 2] - exchanges[:, 1] == 1000).all()
    questions = [message for _, message in link.commands() if isinstance(message, m.GetTime)]
    assert [question.nonce for question in questions] == list(range(1, len(questions) + 1))
    assert thread.handover()["nonce"] == len(questions)
    assert end.counters["other_frames"] == 0


@kernel(LAW_SIGNATURE)
def takes_2_us(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    now = np.int64(parameters[0])  # the address of a virtual clock
    write_word(now, load_word(now) + 2_000)
    return 0.0


def test_a_row_has_the_times_of_receiving_computing_and_sending() -> None:
    class Slow(Script):
        def _write(self, data: bytes) -> int:
            self.clock.sleep_until(self.clock.now_ns() + 3_000)
            return super()._write(data)

    link = Slow(*ticks(1, 5))
    law = Law("slow", "for this test", takes_2_us, 2, lambda wall: [float(link.clock.handle)])
    rows = rows_of(ran(link, at_rest(law))[0])[1:]  # the first tick computes no law
    assert rows["received_at"].tolist() == [2 * PERIOD_NS, 3 * PERIOD_NS, 4 * PERIOD_NS]
    assert (rows["computed_at"] - rows["received_at"]).tolist() == [2_000] * 3
    assert (rows["sent_at"] - rows["computed_at"]).tolist() == [3_000] * 3


def test_an_answer_that_comes_too_late_or_twice_is_no_exchange() -> None:
    link = Answering(*ticks(1, 60))
    link.delay_ns = 15 * PERIOD_NS
    thread, end = ran(link, exchange_every_ns=10 * PERIOD_NS)
    questions = [message for _, message in link.commands() if isinstance(message, m.GetTime)]
    assert end.counters["other_frames"] == len(questions) - 1 > 3
    assert thread.exchanges()[:, 0].tolist() == [questions[-1].host_sent], "the last request"


# ---------------------------------------------------------------------- new parameters


def rows_of(thread: Any) -> Any:
    return thread.ring.rows[: thread.ring.get(control_words.TICKS)]


def new_wall(bundle: Any, *, position: Any, stiffness: Any) -> Any:
    values = np.concatenate([[position], bundle.law.parameters])
    values[1] = stiffness
    return values


def test_parameters_become_active_between_two_ticks_and_only_in_free_space() -> None:
    """The handle is in the wall until tick 20: the new wall waits, and the newer of two is used."""
    bundle = at_rest()
    memory = Ring.allocate(4096)
    soft, hard = new_wall(bundle, position=0.0, stiffness=1.0), new_wall(bundle, position=0.0, stiffness=2.0)
    link = Script(
        *ticks(1, 20, count=3),
        *ticks(20, 30, count=-3),
        *ticks(30, 40, count=3),
        (5 * PERIOD_NS + 1, lambda: memory.post(soft)),
        (7 * PERIOD_NS + 1, lambda: memory.post(hard)),
    )
    thread, end = ran(link, bundle, memory=memory)
    seen = rows_of(thread)
    assert seen["parameter_set"].tolist() == [0] * 19 + [2] * 20
    stiffness = seen["effort_wall"] / -np.where(seen["penetration"] > 0.0, seen["penetration"], np.nan)
    assert np.isnan(stiffness[19:29]).all()
    assert end.counters["parameter_set"] == memory.get(control_words.PARAMETER_SET) == 2
    (kept,) = thread.parameter_sets()
    assert (kept["number"], kept["tick"], kept["wall_position"]) == (2, 19, 0.0)
    assert kept["parameters"] == hard[1:].tolist()


def test_a_wall_never_appears_around_the_handle() -> None:
    """The handle rests at −3 counts: a wall that would begin below that waits, whatever its stiffness."""
    bundle = at_rest()
    memory = Ring.allocate(4096)
    below = -10 * float(bundle.control["resolution"][0])
    link = Script(
        *ticks(1, 20, count=-3),
        (5 * PERIOD_NS + 1, lambda: memory.post(new_wall(bundle, position=below, stiffness=9.0))),
    )
    thread, _ = ran(link, bundle, memory=memory)
    assert (rows_of(thread)["parameter_set"] == 0).all()
    assert thread.parameter_sets() == []
    assert thread._buffers.progress[0]["waiting_set"] == 1


# ---------------------------------------------------------------------- real time


class Socket:
    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        self.ours, self.theirs = ours, theirs
        self.clock = MonotonicClock()

    def port(self) -> Any:
        return LoopPort.on(
            self.clock,
            read=system.descriptor_read,
            write=system.descriptor_write,
            wait=system.descriptor_wait,
            handle=self.ours.fileno(),
        )

    def failure(self) -> None:
        return None

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()


@pytest.fixture
def wire() -> Iterator[Any]:
    made = Socket()
    yield made
    made.close()


def start(wire: Any, law: Any = None, **changes: Any) -> Any:
    """Start the loop in real time, by default with a timeout of a minute for the device."""
    values = {"lost_after_ns": 60_000_000_000, **changes}
    thread = LoopThread(wire, at_rest(law), settings(**values), Ring.allocate(4096))
    thread.start()
    return thread, thread.ring


def until(condition: Any) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def sent_frames(wire: Any) -> Any:
    wire.theirs.setblocking(False)
    data = b""
    try:
        while True:
            data += wire.theirs.recv(65536)
    except BlockingIOError:
        pass
    return [unpack(decode_frame(frame)) for frame in data.split(b"\0") if frame]


def test_the_loop_needs_no_python_while_it_runs(wire: Any) -> None:
    """Another thread holds the GIL (a C call through PyDLL); the loop still answers every sample."""
    interval = sys.getswitchinterval()
    thread, memory = start(wire)
    try:
        wire.theirs.send(state_frame(1))
        until(lambda: memory.get(control_words.TICKS) == 1)
        sys.setswitchinterval(60.0)  # no thread is asked to release the GIL
        for k in range(2, 60):
            os.write(wire.theirs.fileno(), state_frame(k))
        ctypes.PyDLL(None).usleep(150_000)
        stepped = memory.get(control_words.TICKS), memory.get(control_words.SKIPPED)
    finally:
        sys.setswitchinterval(interval)
        thread.finish()
    assert sum(stepped) == 59
    assert thread.end().reason == EndReason.STOPPED


def test_stopping_a_loop_in_real_time_ends_with_stops_on_the_wire(wire: Any) -> None:
    thread, _ = start(wire)
    seen = []
    wire.theirs.send(state_frame(1))
    threading.Timer(0.05, thread.stop).start()
    thread.wait(lambda done, phase: seen.append((done, phase)))
    thread.finish()
    assert thread.end().reason == EndReason.STOPPED
    commands = sent_frames(wire)
    assert [command.mode for _, command in commands] == [m.Mode.CURRENT] + [m.Mode.STOP] * STOP_FRAMES
    assert seen
    assert not thread._thread.is_alive() or not thread._thread.join(WAIT_S)


def test_a_hang_up_in_real_time_is_a_closed_link(wire: Any) -> None:
    thread, _ = start(wire)
    wire.theirs.send(state_frame(1))
    until(lambda: thread.ring.get(control_words.TICKS) == 1)
    wire.theirs.close()
    thread.wait()
    end = thread.end()
    assert end.reason == EndReason.LINK_CLOSED
    assert end.counters["errno"] in (errno.EPIPE, errno.ECONNRESET, errno.EIO)


def test_a_loop_that_was_never_started_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    thread = LoopThread(Script(), at_rest(), settings(), Ring.allocate(8))
    monkeypatch.setattr(thread._ended, "wait", lambda _: pytest.fail("it waited"))
    thread.finish()
    assert thread.end().reason == EndReason.RUNNING
    assert thread.handover() is None


def test_an_exception_of_the_progress_does_not_stop_the_caller_from_finishing(wire: Any) -> None:
    thread, _ = start(wire)
    with pytest.raises(ZeroDivisionError):
        thread.wait(lambda done, phase: 1 // 0)
    thread.finish()
    assert thread.end().reason == EndReason.STOPPED


# ---------------------------------------------------------------------- a law that does not return


@kernel(LAW_SIGNATURE)
def waits_for_a_word(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    entered, freed = np.int64(parameters[0]), np.int64(parameters[1])
    store_word(entered, 1)
    while load_word(freed) == 0:
        pass
    return 0.0


def test_a_run_ends_though_its_law_never_returns(wire: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.loop._run.JOIN_S", 0.05)
    words = np.zeros(2, np.int64)
    entered, freed = (int(words.ctypes.data) + 8 * place for place in range(2))
    law = Law("waits", "for this test", waits_for_a_word, 2, lambda wall: [float(entered), float(freed)])
    thread, memory = start(wire, law)
    try:
        for k in range(1, 9):
            os.write(wire.theirs.fileno(), state_frame(k))
            until(lambda k=k: memory.get(control_words.TICKS) == k or words[0])
        assert words[0] == 1
        thread.stop()
        thread.wait()
        thread.finish()
        end = thread.end()
        sent_frames(wire)
    finally:
        write_word(freed, 1)
    until(lambda: not thread._thread.is_alive())
    assert sent_frames(wire) == [], (
        "its descriptor may belong to another file by now: not even a stop is sent"
    )
    assert end.reason == EndReason.STUCK
    assert thread._ended.wait(WAIT_S)
    assert thread.end().reason == EndReason.STOPPED
