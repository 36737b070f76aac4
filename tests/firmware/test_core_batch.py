"""BATCH: every tick of a supervised law arrives unchanged or is known to be missing."""

from ctypes import CDLL
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.faults import Fault
from firmware_protocol.framing import RAW_LIMIT
from firmware_protocol.messages import Mode
from sim_backend.board.firmware import OUTPUT_BYTES
from tests.conformance.rigs import rotary_rig
from tests.firmware.supervised import Board, Sample
from tests.firmware.test_core_law import push, run_values

FULL = {0: 45, 1: 76, 2: 38}  # samples in a raw frame of 252 bytes
LARGEST = {0: 127, 1: 127, 2: 32_767}  # count difference
WIDE_OPEN = {"window_minimum": -(2**31), "window_maximum": 2**31 - 1, "speed_limit": 2**32 - 1}

moves = st.one_of(st.integers(-3, 3), st.integers(-128, 127), st.sampled_from([0, 127, -128]))
# A tick: how far the handle moves, measured current, ticks missed before it, whether the link is stuck.
ticks = st.tuples(
    moves, st.integers(-4_000, 4_000), st.sampled_from([0] * 20 + [1]), st.sampled_from([False] * 9 + [True])
)


def make_board(library: CDLL, layout: int = 0, most: int = 76, **more: int) -> Board:
    return Board(library).begin(
        **run_values(push(), batch_layout=layout, batch_samples=most, **WIDE_OPEN, **more)
    )


def as_layout(sample: Sample, layout: int) -> Sample:
    return sample._replace(measured=None) if layout == 1 else sample


@given(st.integers(0, 2), st.integers(1, 76), st.lists(ticks, max_size=200))
@example(0, 45, [(0, 0, 0, False)] * 90)
def test_each_tick_arrives_or_shows_as_a_gap(library: CDLL, layout: int, most: int, script: Any) -> None:
    board = make_board(library, layout, most)
    for moved, board.measured, missed, stuck in script:
        board.missed = missed
        library.host_set_room(board.core.address, 0 if stuck else OUTPUT_BYTES)
        board.count += moved
        board.supervise()
    library.host_set_room(board.core.address, OUTPUT_BYTES)
    board.command(Mode.STOP)
    fed = {sample.index: as_layout(sample, layout) for sample in board.fed}
    assert all(fed[sample.index] == sample for sample in board.samples)
    assert [frame.message.layout for frame in board.frames] == [layout] * len(board.frames)
    dropped = board.core.status.dropped
    if not dropped:
        assert [sample.index for sample in board.samples] == list(fed)
    for frame in board.frames:
        assert 1 <= len(frame.samples) <= min(most, FULL[layout])
    sequences = [frame.sequence for frame in board.frames]
    assert sequences == sorted(set(sequences))


@pytest.mark.parametrize("layout", [0, 1, 2])
def test_frame_has_as_many_samples_as_fit_or_as_configured(library: CDLL, layout: int) -> None:
    board = make_board(library, layout)
    ticks = 2 * FULL[layout] + 5
    board.run(range(0, 2 * ticks, 2))  # a handle that stood still under this push would be a fault
    assert [len(frame.samples) for frame in board.frames] == [FULL[layout]] * 2
    raw = 6 + 13 + len(board.frames[0].message.data) + 4
    assert raw <= RAW_LIMIT < raw + {0: 5, 1: 3, 2: 6}[layout]
    few = make_board(library, layout, 7)
    few.run(range(0, 46, 2))
    assert [len(frame.samples) for frame in few.frames] == [7, 7, 7]


def test_a_frame_knows_when_its_first_sample_was_taken(library: CDLL) -> None:
    board = make_board(library, 0, 10)
    times = []
    for board.count in range(35):
        times.append(board.core.status.due & 0xFFFFFFFF)
        board.supervise()
    assert [frame.message.device_time for frame in board.frames] == times[::10][:3]


@pytest.mark.parametrize("layout", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_too_large_step_is_a_fault_and_the_rest_is_kept(library: CDLL, layout: int, sign: int) -> None:
    board = make_board(library, layout)
    most = LARGEST[layout] if sign > 0 else LARGEST[layout] + 1
    board.run([0, 0, sign * most, sign * most])
    assert board.core.status.fault == Fault.NONE
    board.run([2 * sign * most + sign])
    status = board.core.status
    assert (status.fault, status.current, status.enabled) == (Fault.BATCH_OVERFLOW, 0, 0)
    assert [sample.count for sample in board.samples] == [0, 0, sign * most, sign * most]
    assert (board.states[-1].fault, board.states[-1].count) == (Fault.BATCH_OVERFLOW, 2 * sign * most + sign)


def test_how_far_the_handle_moved_over_a_gap_need_not_fit(library: CDLL) -> None:
    board = make_board(library)
    board.run([0, 0])
    board.missed = 1
    board.run([10_000, 10_001])
    board.command(Mode.STOP)
    assert board.core.status.fault == Fault.NONE
    assert [sample.count for sample in board.samples] == [0, 0, 10_000, 10_001]
    first, second = board.frames
    assert second.message.first_index == first.message.first_index + 2 + 1


@pytest.mark.parametrize("mode", [Mode.STOP, Mode.CURRENT])
def test_the_last_samples_leave_when_supervision_ends(library: CDLL, mode: Mode) -> None:
    board = make_board(library)
    board.run([0] * 7)
    assert not board.frames
    board.command(mode)
    assert [len(frame.samples) for frame in board.frames] == [7]
    board.tick()
    board.tick()
    assert len(board.frames) == 1


def test_the_tick_of_a_fault_is_the_last_that_arrives(library: CDLL) -> None:
    board = Board(library, rotary_rig()).begin(**run_values(push()))
    board.run([0] * 7)
    board.measured = 32_767
    board.run([1, 2])  # one alone is a spike of the converter
    board.measured = 0
    for _ in range(50):
        board.tick()
    assert board.core.status.fault == Fault.OVER_CURRENT
    assert [sample.count for sample in board.samples] == [0] * 7 + [1, 2]
    assert board.samples[-1].measured == 32_767


def test_a_fault_between_ticks_ends_the_frame(library: CDLL) -> None:
    board = make_board(library)
    board.run([0] * 7)
    library.host_fault(board.core.address, int(Fault.INTERNAL))
    board.tick()
    assert [len(frame.samples) for frame in board.frames] == [7]


def test_a_new_session_begins_with_frame_zero_and_without_the_past(library: CDLL) -> None:
    board = make_board(library, 0, 5)
    board.run([0] * 12)
    board.disarm()
    board.count = 5_000
    board.frames.clear()
    assert board.arm().status == 0
    board.run([5_000] * 5)
    (frame,) = board.frames
    assert (frame.sequence, frame.message.base_count) == (0, 5_000)


def test_nothing_is_batched_while_the_host_computes(library: CDLL) -> None:
    board = Board(library).begin(**run_values(push(), law=0))
    board.run([0] * 100)
    assert not board.frames
    assert [b.sample_index - a.sample_index for a, b in pairwise(board.states)] == [1] * 99


class Busy(Board):
    """A board whose main loop calls device_poll `polls` times after a tick."""

    polls = 0

    def strike(self) -> None:
        self.library.host_tick_alone(self.core.address)
        for _ in range(self.polls):
            self.library.host_poll(self.core.address, b"", 0)


@given(
    st.integers(0, 2),
    st.integers(1, 76),
    st.sampled_from([0, 1]),
    st.lists(st.integers(0, 6), min_size=20, max_size=150),
)
@example(0, 45, 1, [1] * 150)
@example(0, 45, 0, [0] * 150)
def test_each_frame_leaves_whole_however_little_time_remains_between_ticks(
    library: CDLL, layout: int, most: int, law: int, script: list[int]
) -> None:
    board = Busy(library).begin(**run_values(push(), batch_layout=layout, batch_samples=most, law=law))
    board.host.statistics.lost = 0
    for board.count, board.polls in enumerate(script):
        board.supervise()
    board.polls = 60
    board.supervise()
    board.command(Mode.STOP)
    fed = {sample.index: as_layout(sample, layout) for sample in board.fed}
    if law:
        assert board.samples == list(fed.values())
    assert board.states[-1].sample_index <= board.fed[-1].index
    assert all(state.count == fed[state.sample_index].count for state in board.states)


@pytest.mark.parametrize("end", ["stop", "disarm"])
def test_the_current_is_gone_before_what_waits_is_packed_and_sent(library: CDLL, end: str) -> None:
    board = make_board(library)
    board.run([120] * 60)
    before = board.core.status
    assert before.current != 0
    sent = len(board.samples)
    if end == "stop":
        board.command(Mode.STOP)
    else:
        assert board.disarm().status == 0
    after = board.core.status
    assert len(board.samples) > sent
    assert (after.current, after.frames_driven) == (0, before.frames_driven)
