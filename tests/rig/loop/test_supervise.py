"""The host's loop for a law on the device, against a scripted far end: rows, gaps, ends, and new walls."""

import errno
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, LimitFlag, Status
from firmware_protocol.framing import encode_frame
from firmware_protocol.messages import STOP_FRAMES
from firmware_protocol.packing import pack
from firmware_protocol.parameters import decode_block
from rig.control.step import new_memory
from rig.core.errors import ConfigError, PlanError
from rig.core.present import plain
from rig.core.sample import Phase, RowFlag
from rig.experiments.trials.replay import COMPUTED
from rig.loop import _supervise as supervise
from rig.loop._parameter_update import update_of
from rig.loop._run import LoopSettings, LoopThread
from rig.loop._supervised import SupervisedThread
from rig.loop.layout import EndReason
from rig.loop.replay import NO_SETS, replay_rows
from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.conformance.batch_device import BatchDevice
from tests.conformance.started import WAIT_S
from tests.rig.loop.test_loop import PERIOD_NS, SESSION, Script, state_frame
from tests.rig.loop.test_loop import at_rest as controlled
from tests.rig.loop.test_loop import settings as settings_of


def loop_settings(**changes: Any) -> LoopSettings:
    supervised = {
        "lifetime_us": 20_000,
        "supervise_every_ns": 5_000_000,
        "batch_samples": 5,
        "agreement_quanta": 1,
    }
    made: LoopSettings = settings_of(**{**supervised, **changes})
    return made


def ran(device: BatchDevice, bundle: Any = None, *, memory: Ring | None = None, **changes: Any) -> Any:
    memory = memory or Ring.allocate(8192)
    supervise.run.prepare()
    thread = SupervisedThread(device, bundle or controlled(), loop_settings(**changes), memory)
    thread.start()
    thread._thread.join(WAIT_S)
    assert thread._ended.is_set()
    return thread, thread.end()


def silent_behind(counts: Sequence[int], *rest: Any, **options: Any) -> BatchDevice:
    device = BatchDevice(counts, *rest, **options)
    device.at[len(counts)] = lambda: setattr(device, "silent", True)
    return device


def rows_of(thread: LoopThread) -> np.ndarray:
    return thread.ring.rows[: thread.ring.get(control_words.HEAD)]


def taps(ticks: int, seed: int = 1) -> list[int]:
    noise = np.random.default_rng(seed).integers(-1, 2, ticks)
    return (np.rint(12.0 * np.sin(np.arange(ticks) / 15.0)).astype(int) + noise).tolist()


def rows_on_host(counts: Sequence[int], bundle: Any) -> np.ndarray:
    """Return the rows of the loop with the law on the host for the same samples."""
    memory = Ring.allocate(8192)
    link = Script(*((PERIOD_NS * (k + 1), state_frame(100 + k, count=c)) for k, c in enumerate(counts)))
    changes = {"supervise_every_ns": 0, "lost_after_ns": 10 * PERIOD_NS}
    thread = LoopThread(link, bundle, loop_settings(**changes), memory)
    thread.start()
    thread._thread.join(WAIT_S)
    return rows_of(thread)


def replay_again(rows: np.ndarray, bundle: Any) -> np.ndarray:
    """Return the rows that `rig.control.step` computes again from recorded samples."""
    again = rows.copy()
    bundle.memory[0] = new_memory()[0]
    replay_rows(bundle.arguments(), rows, again, NO_SETS)
    return again


def assert_replays(rows: np.ndarray, bundle: Any) -> None:
    """Check every computed column to the last bit, except in the last row, which the loop ended."""
    again = replay_again(rows.copy(), bundle)
    for name in (*COMPUTED, "flags"):
        assert again[name][:-1].tobytes() == rows[name][:-1].tobytes(), name


def assert_ends_with_stops(device: BatchDevice) -> None:
    last = device.commands()[-STOP_FRAMES:]
    assert len(last) == STOP_FRAMES
    assert {(c.mode, c.current) for c in last} == {(m.Mode.STOP, 0)}


# ---------------------------------------------------------------------- rows


@pytest.mark.parametrize("layout", [0, 1, 2])
def test_the_rows_are_those_of_a_loop_on_the_host(layout: int) -> None:
    counts = taps(400)
    bundle = controlled()
    expected = rows_on_host(counts, controlled())
    device = silent_behind(counts, expected["current_sent"].tolist(), layout=layout)
    thread, end = ran(device, bundle)
    rows = rows_of(thread)[:400]
    assert end.reason == EndReason.LINK_SILENT
    for name in (*COMPUTED, "flags", "tick", "sample_index", "elapsed_ticks", "count", "parameter_set"):
        assert (rows[name] == expected[name]).all(), name
    assert rows["current_applied"].tolist() == [0, *expected["current_sent"][:-1].tolist()]
    assert (rows["current_measured"] == (0.0 if layout == 1 else 0.007)).all()
    assert (rows["edge_age"] == 0).all()
    assert (rows["computed_at"] == 0).all()
    assert (rows["sent_at"] == 0).all()
    assert (np.diff(rows["device_time"]) == PERIOD_NS).all()
    assert thread.agreement().holds
    assert thread.agreement().differing == 0
    assert thread.agreement().compared >= 390
    assert_ends_with_stops(device)


def test_the_host_sends_in_time_and_compares_the_clocks() -> None:
    device = silent_behind(taps(300))
    thread, end = ran(device, exchange_every_ns=20 * PERIOD_NS)
    supervising = [at for at, c in device.received if isinstance(c, m.Command) and c.mode == m.Mode.SUPERVISE]
    assert supervising[0] == 0, "the device sends nothing before"
    assert set(np.diff(supervising)) == {5_000_000}
    assert end.counters["commands"] == len(supervising)
    assert end.counters["exchanges"] == len(thread.exchanges()) >= 14
    assert thread.handover()["nonce"] == sum(isinstance(c, m.GetTime) for _, c in device.received)


def test_columns_that_a_batch_lacks_come_from_the_newest_state() -> None:
    """STATEs come at samples 100, 105, …; each batch of five begins there."""
    device = silent_behind([0] * 60, states_every=5)
    device.at[12] = lambda: setattr(device, "limits", int(LimitFlag.SPEED))  # in the STATE of sample 115
    thread, _ = ran(device)
    rows = rows_of(thread)
    assert rows["limits"][rows["sample_index"] < 115].max() == 0
    assert (
        rows["limits"][(rows["sample_index"] >= 115) & (rows["sample_index"] < 120)] == LimitFlag.SPEED
    ).all()
    assert (rows["inputs"][5:] == 2).all()
    assert (rows["execution_time"][5:] == 10_000).all()
    assert (rows["device_state"] == State.RUNNING).all()


# ---------------------------------------------------------------------- faults of frames


MANGLED = {
    "damage": lambda held, frame: [frame[:20] + bytes([frame[20] % 255 + 1]) + frame[21:]],
    "drop": lambda held, frame: [],
    "duplicate": lambda held, frame: [frame, frame],
    "truncate": lambda held, frame: [frame[:30]],  # runs into the next one
    "short": lambda held, frame: [frame[:30] + b"\0"],
    "stranger": lambda held, frame: [frame, encode_frame(pack(m.Batch(0, 0, 0, 0, b"12345"), session=3))],
    "no samples": lambda held, frame: [encode_frame(pack(m.Batch(0, 0, 0, 0, b""), session=SESSION))],
    "unknown layout": lambda held, frame: [encode_frame(pack(m.Batch(0, 0, 0, 9, b"123"), session=SESSION))],
}


@pytest.mark.parametrize("kind", [*MANGLED, "reorder"])
@pytest.mark.parametrize("struck", [(3,), (0, 1, 2)])
def test_a_fault_of_a_frame_is_a_counted_gap_and_never_a_wrong_row(
    kind: Any, struck: tuple[int, ...]
) -> None:
    counts = taps(200, seed=4)
    held: list[bytes] = []

    def mangle(number: int, frame: bytes) -> list[bytes]:
        if number in struck:
            if kind == "reorder":
                held.append(frame)
                return []
            return MANGLED[kind](held, frame)
        late, held[:] = list(held), []
        return [frame, *late]

    device = silent_behind(counts, mangle=mangle)
    bundle = controlled()
    thread, end = ran(device, bundle)
    rows = rows_of(thread)
    assert end.reason == EndReason.LINK_SILENT
    place = rows["sample_index"] - 100
    assert (np.diff(place) > 0).all()
    assert rows["count"].tolist() == [counts[k] for k in place], "each count is its own sample's"
    assert rows["elapsed_ticks"].tolist() == np.diff(place, prepend=-1).tolist()
    assert (rows["device_time"] == rows["device_time"][0] + (place - place[0]) * PERIOD_NS).all()
    lost = 200 - len(rows)
    assert end.counters["lost"] == lost
    assert ((rows["flags"] & RowFlag.GAP) != 0).sum() == np.count_nonzero(rows["elapsed_ticks"] > 1)
    assert (lost > 0) == (kind not in ("duplicate", "stranger"))
    assert end.counters["duplicated"] == (5 * len(struck) if kind == "duplicate" else 0)
    assert end.counters["reordered"] == (5 * len(struck) if kind == "reorder" else 0)
    assert_replays(rows, controlled())


@settings(max_examples=15)
@given(
    st.dictionaries(st.integers(0, 39), st.sampled_from([*MANGLED]), max_size=12),
    st.integers(1, 45),
    st.integers(0, 2**32 - 1),
)
def test_under_any_faults_of_frames_each_row_is_its_sample(
    struck: Any, samples: int, first_index: int
) -> None:
    counts = taps(400, seed=2)

    def mangle(number: int, frame: bytes) -> list[bytes]:
        return MANGLED[struck[number]]([], frame) if number in struck else [frame]

    device = silent_behind(counts, mangle=mangle, samples=samples, first_index=first_index)
    thread, end = ran(device, batch_samples=samples, lost_after_ns=1000 * PERIOD_NS)
    rows = rows_of(thread)
    place = rows["sample_index"] - first_index
    if len(rows):
        place -= (place[0] // 2**32) * 2**32  # the very first may come behind the wrap
    assert rows["count"].tolist() == [counts[k] for k in place]
    assert rows["elapsed_ticks"].tolist() == np.diff(place, prepend=-1).tolist()
    assert end.counters["lost"] == rows["elapsed_ticks"].sum() - len(rows)
    if len(rows):
        assert_replays(rows, controlled())


def test_ticks_that_the_device_missed_are_gaps_too() -> None:
    counts = taps(100)
    device = silent_behind(counts, missing=[20, 21, 22, 50])
    thread, end = ran(device)
    rows = rows_of(thread)
    assert rows["elapsed_ticks"][[20, 47]].tolist() == [4, 2]
    assert end.counters["lost"] == 4
    sampled = [count for k, count in enumerate(counts) if k not in (20, 21, 22, 50)]
    assert rows["count"].tolist() == sampled[: len(rows)]
    assert len(rows) > 90


@pytest.mark.parametrize("first_index", [2**32 - 7, 2**32 - 1, 0])
def test_index_and_time_continue_behind_32_bits(first_index: Any) -> None:
    device = silent_behind(taps(50), first_index=first_index)
    device._next_ns = 268_435_456_000 - 9 * PERIOD_NS  # nine ticks before the clock wraps
    device.clock.sleep_until(device._next_ns - 1)
    thread, _ = ran(device)
    rows = rows_of(thread)
    assert rows["sample_index"].tolist() == list(range(first_index, first_index + 50))
    assert (np.diff(rows["device_time"]) == PERIOD_NS).all()


def test_the_period_need_not_be_a_whole_number_of_the_devices_units() -> None:
    device = silent_behind([0] * 90, period_ns=333_333, samples=15)
    thread, _ = ran(device, period_ns=333_333, batch_samples=15)
    time = rows_of(thread)["device_time"]
    assert np.abs(time - time[0] - np.arange(90) * 1e9 / 3000).max() < 200


# ---------------------------------------------------------------------- endings


def test_the_run_ends_when_its_own_law_is_done() -> None:
    device = BatchDevice([0] * 200)
    thread, end = ran(device, controlled(trial_ticks=30, release_ticks=5))
    assert end.reason == EndReason.FINISHED
    rows = rows_of(thread)
    assert rows["phase"][-1] == Phase.DONE
    assert (rows["phase"] == Phase.TRIAL).sum() == 30
    assert rows["current_sent"][-1] == 0
    assert_ends_with_stops(device)


@pytest.mark.parametrize("tick", [0, 3, 4, 17])
def test_a_fault_of_the_device_ends_the_run_with_every_sample_up_to_it(tick: int) -> None:
    device = BatchDevice([0] * 100)
    device.faults_at[tick] = int(Fault.ENCODER)
    thread, end = ran(device)
    assert end.reason == EndReason.DEVICE_FAULT
    assert thread.fault == Fault.ENCODER
    rows = rows_of(thread)
    assert rows["sample_index"].tolist() == list(range(100, 101 + tick))
    assert rows["fault"].tolist() == [0] * tick + [Fault.ENCODER]
    assert rows["current_sent"][-1] == 0
    assert_ends_with_stops(device)
    assert thread.handover()["state"] == State.FAULT


def test_the_stop_word_stops_and_samples_on_the_link_are_stored() -> None:
    memory = Ring.allocate(8192)
    device = BatchDevice(taps(300))
    device.at[42] = lambda: memory.put(control_words.STOP, 1)
    thread, end = ran(device, memory=memory)
    assert end.reason == EndReason.STOPPED
    stopped = next(at for at, c in device.received if isinstance(c, m.Command) and c.mode == m.Mode.STOP)
    assert stopped <= 48 * PERIOD_NS, "within the time between two commands"
    rows = rows_of(thread)
    assert len(rows) == device.played, "also the samples of the frame that was not full"
    assert (rows["elapsed_ticks"] == 1).all()
    assert device.clock.now_ns() <= stopped + 25 * PERIOD_NS
    assert_ends_with_stops(device)


def test_a_device_without_any_frame_is_silent() -> None:
    device = BatchDevice([0] * 10)
    device.silent = True
    thread, end = ran(device)
    assert (end.reason, end.counters["ticks"]) == (EndReason.LINK_SILENT, 0)
    assert device.clock.now_ns() <= 60 * PERIOD_NS
    handed = thread.handover()
    assert handed == {
        "next_command": len(device.commands()),
        "newest_state": 0xFFFF,
        "state": State.RUNNING,
        "nonce": 0,
    }


def test_a_device_without_a_law_of_its_own_is_silent_though_its_states_come() -> None:
    device = BatchDevice([0] * 300)
    device.mangle = lambda number, frame: []
    _, end = ran(device)
    assert end.reason == EndReason.LINK_SILENT


def test_a_broken_link_ends_the_run_with_its_error_number_and_all_samples() -> None:
    device = BatchDevice([0] * 100)
    device.at[41] = lambda: setattr(device, "error", -errno.EIO)
    thread, end = ran(device)
    assert (end.reason, end.counters["errno"]) == (EndReason.LINK_CLOSED, errno.EIO)
    assert len(rows_of(thread)) == 40
    assert_ends_with_stops(device)


def test_a_link_that_takes_no_command_is_closed() -> None:
    device = BatchDevice([0] * 100)
    device.write_error = -errno.EPIPE
    thread, end = ran(device)
    assert (end.reason, end.counters["errno"], end.counters["unsent"]) == (
        EndReason.LINK_CLOSED,
        errno.EPIPE,
        1,
    )
    assert thread.handover()["next_command"] == 1 + STOP_FRAMES


@pytest.mark.parametrize(
    ("control", "reason"),
    [({}, EndReason.DEVICE_ENDED), ({"trial_ticks": 60, "release_ticks": 1000}, EndReason.FINISHED)],
)
def test_a_device_whose_law_ended_is_not_followed_for_ever(control: Any, reason: Any) -> None:
    device = BatchDevice([0] * 500)
    device.at[100] = lambda: setattr(device, "phase", int(Phase.DONE))
    thread, end = ran(device, controlled(**control))
    assert end.reason == reason
    assert 140 <= len(rows_of(thread)) <= 170
    assert_ends_with_stops(device)


# ---------------------------------------------------------------------- agreement of device and law


def run_with_current_errors(changes: dict[int, int]) -> SupervisedThread:
    """Run a device whose current differs from the law's by these amounts (tick → quanta)."""
    counts = taps(400)
    currents = rows_on_host(counts, controlled())["current_sent"]
    for tick, amount in changes.items():
        currents[tick] += amount
    device = silent_behind(counts, currents.tolist())
    return ran(device)[0]


def test_a_device_that_rounds_otherwise_agrees_and_the_difference_is_counted() -> None:
    found = run_with_current_errors(dict.fromkeys(range(0, 380, 3), 1)).agreement()
    assert (found.greatest_quanta, found.beyond, found.holds) == (1, 0, True)
    assert 120 <= found.differing <= 127


def test_a_device_with_another_current_disagrees() -> None:
    found = run_with_current_errors(dict.fromkeys(range(100, 120), -40)).agreement()
    assert (found.greatest_quanta, found.beyond, found.holds) == (40, 20, False)
    assert plain(found)["bound_quanta"] == 1


def test_an_active_limit_excludes_a_sample_from_the_comparison() -> None:
    counts = taps(400)
    currents = rows_on_host(counts, controlled())["current_sent"]
    currents[200:220] = 0
    device = silent_behind(counts, currents.tolist())
    for tick in range(199, 222):
        device.at[tick] = lambda: setattr(device, "limits", int(LimitFlag.RAMPING))
    found = ran(device)[0].agreement()
    assert (found.differing, found.beyond) == (0, 0)
    assert 20 <= found.excluded <= 40
    assert found.compared + found.excluded == 399


def test_after_a_gap_nothing_is_compared_until_the_estimators_have_forgotten_it() -> None:
    """The device used samples that the host lost, so their velocities differ for a while."""
    counts = taps(2000)
    currents = rows_on_host(counts, controlled())["current_sent"].tolist()
    device = silent_behind(
        counts, currents, mangle=lambda number, frame: [] if 20 <= number < 24 else [frame]
    )
    thread, _ = ran(device)
    rows = rows_of(thread)
    found = thread.agreement()
    assert np.abs(rows["current_applied"][101:150] - rows["current_sent"][100:149]).max() > 1
    assert (found.beyond, found.holds) == (0, True)
    assert 50 * 10 <= found.excluded <= 50 * 10 + 20


# ---------------------------------------------------------------------- new walls


def wall_values(bundle: Any, stiffness: float) -> list[float]:
    values = [0.0, *bundle.law.parameters.tolist()]
    values[1] = stiffness
    return values


def as_device_parameters(values: Sequence[float]) -> dict[str, float]:
    """Replace `rig.config.device_law.live_parameters`: ten parameters, so that the block needs two chunks."""
    return {
        "float_stiffness": values[1], "float_damping": values[2], "float_surface_fraction": values[0],
        "float_surface": 7, "fixed_surface": 1, "fixed_stiffness": 2, "fixed_damping": 3, "fixed_shift": 4,
        "fixed_constant_high": -5, "fixed_constant_low": 2**32 - 6,
    }  # fmt: skip


class Changing:
    def __init__(self, counts: Sequence[int], *sets: tuple[int, float]) -> None:
        self.bundle = controlled()
        self.memory = Ring.allocate(16384)
        self.device = BatchDevice(counts)
        self.device.at[len(counts)] = lambda: setattr(self.device, "silent", True)
        for tick, stiffness in sets:
            self.device.at[tick] = lambda stiffness=stiffness: self.post(stiffness)

    def post(self, stiffness: float) -> None:
        self.memory.post(wall_values(self.bundle, stiffness))
        self.thread._attend()

    def run(self, **changes: Any) -> Any:
        self.thread = SupervisedThread(
            self.device, self.bundle, loop_settings(**changes), self.memory, live=as_device_parameters
        )
        self.thread.start()
        self.thread._thread.join(WAIT_S)
        assert self.thread._ended.is_set()
        self.rows = rows_of(self.thread)
        return self.thread.end()

    def replay(self) -> np.ndarray:
        fresh = controlled()
        sets = np.array(
            [[one["tick"], one["wall_position"], *one["parameters"]] for one in self.thread.parameter_sets()]
        )
        again = self.rows.copy()
        replay_rows(fresh.arguments(), self.rows, again, sets.reshape(len(sets), -1))
        return again


TAP = [*[-3] * 60, *[4] * 60, *[-3] * 60]


def test_a_new_wall_becomes_active_on_both_sides_at_the_same_sample() -> None:
    run = Changing(TAP, (22, 1.0), (30, 2.5))
    run.run()
    (first, block), (second, _) = run.device.commits
    assert decode_block(block) == as_device_parameters(wall_values(run.bundle, 1.0))
    index, sets = run.rows["sample_index"], run.rows["parameter_set"]
    assert (sets == np.where(index >= second, 2, np.where(index >= first, 1, 0))).all()
    inside = run.rows["penetration"] > 0.0
    stiffness = -run.rows["effort_wall"][inside] / run.rows["penetration"][inside]
    assert len(stiffness) == 60
    assert [one["number"] for one in run.thread.parameter_sets()] == [1, 2]
    again = run.replay()
    for name in COMPUTED:
        assert again[name].tobytes() == run.rows[name].tobytes(), name
    assert not [text for text in run.thread.messages() if "parameter set" in text]
    assert run.memory.get(control_words.PARAMETER_SET) == 2
    assert run.thread.handover()["parameters_crc"] > 0


def test_the_wall_waits_until_the_handle_is_outside_and_the_newest_one_is_taken() -> None:
    run = Changing(TAP, (70, 1.0), (80, 2.0))
    run.run()
    ((index, block),) = run.device.commits
    assert index >= 220
    assert decode_block(block)["float_stiffness"] == 2.0
    assert [one["number"] for one in run.thread.parameter_sets()] == [2]


def test_a_device_that_finds_the_handle_inside_is_asked_again() -> None:
    run = Changing(TAP, (20, 1.0))
    refused = iter([Status.INSIDE_WALL] * 3)
    run.device.commit = lambda: next(refused, Status.OK)
    run.run()
    assert len(run.device.commits) == 1
    assert [one["number"] for one in run.thread.parameter_sets()] == [1]
    nonces = {c.nonce for _, c in run.device.received if isinstance(c, m.SetCommit)}
    assert len(nonces) == 4, "each time a new conversation"


def test_a_wall_that_the_device_refuses_is_a_message_and_leaves_the_old_one() -> None:
    run = Changing(TAP, (20, 1.0))
    run.device.commit = lambda: Status.INCONSISTENT
    run.run()
    assert run.thread.parameter_sets() == []
    assert (run.rows["parameter_set"] == 0).all()
    (message,) = (text for text in run.thread.messages() if "parameter set" in text)
    assert "parameter set 1" in message
    assert Status.INCONSISTENT.text in message


def test_a_wall_that_cannot_be_computed_is_a_message() -> None:
    def refuses(values: Any) -> None:
        raise PlanError("stiffness does not fit", remedy="choose less")

    bundle, memory = controlled(), Ring.allocate(8192)
    device = BatchDevice(TAP)
    thread = SupervisedThread(device, bundle, loop_settings(), memory, live=refuses)
    memory.post(wall_values(bundle, 1.0))
    thread._attend()
    assert "stiffness does not fit" in thread.messages()[0]


@pytest.mark.parametrize("lost", ["ack", "request"])
@pytest.mark.parametrize("kind", [m.SetBegin, m.SetChunk, m.SetCommit])
def test_a_lost_frame_of_an_update_is_sent_again_and_the_sample_stays_exact(lost: str, kind: Any) -> None:
    """A commit may be active on the device although its reply is lost: the host holds samples until it knows."""
    run = Changing([*TAP, *TAP], (20, 1.0))
    device = run.device
    struck = []

    answer = device._answer

    def once(message: Any) -> None:
        if isinstance(message, kind) and not struck:
            struck.append(message)
            if lost == "ack":
                before = device.arrived
                answer(message)
                device.arrived = before
            return
        answer(message)

    device._answer = once
    run.run()
    assert struck
    ((index, _),) = device.commits
    assert (run.rows["parameter_set"] == (run.rows["sample_index"] >= index)).all()
    assert len(run.rows) == 360
    again = run.replay()
    assert all(again[name].tobytes() == run.rows[name].tobytes() for name in COMPUTED)


def test_a_device_that_never_answers_a_commit_does_not_hold_up_the_rows_for_ever() -> None:
    run = Changing([*TAP * 60], (20, 1.0))
    answer = run.device._answer
    run.device._answer = lambda message: None if isinstance(message, m.SetCommit) else answer(message)
    end = run.run()
    assert end.reason == EndReason.LINK_SILENT
    assert len(run.rows) == len(TAP) * 60
    assert (run.rows["elapsed_ticks"] == 1).all()
    assert run.thread.parameter_sets() == []


def test_too_many_parameters_for_an_update_are_refused() -> None:
    with pytest.raises(ConfigError, match="too many for a running loop"):
        update_of(1, bytes(102), [0.0])
    with pytest.raises(ConfigError, match="too many for a running loop"):
        update_of(1, bytes(12), [0.0] * 60)
