"""The recorder beside a running producer: no row lost or torn, however the loop or the process ends."""

import os
import resource
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.core.errors import LawError, RecordingError
from rig.core.sample import ROW
from rig.experiments.trials.recover import recover
from rig.realtime.control_words import DROPPED, HEAD, LOOP_DONE, TAIL, TICKS
from rig.realtime.ring import Ring
from rig.realtime.running import running
from rig.recording._capture import pack_header
from rig.recording.reader import open_recording
from rig.recording.recorder import AT_RISK_S, Recorder, write_all
from tests.conformance.recording import example_header, example_rows
from tests.conformance.started import forked

HEADER = example_header()


def produce(ring: Ring, rows: NDArray[np.void], at_once: int) -> None:
    """Put rows into the ring as a loop in virtual time does: wait for room, write, publish."""
    done = 0
    while done < len(rows):
        head, tail = ring.get(HEAD), ring.get(TAIL)
        count = min(at_once, ring.capacity - (head - tail), len(rows) - done)
        ring.rows[(head + np.arange(count)) % ring.capacity] = rows[done : done + count]
        ring.put(HEAD, head + count)
        done += count
        if count == 0:
            time.sleep(0)
    ring.put(TICKS, len(rows))
    ring.put(LOOP_DONE, 1)


@pytest.mark.parametrize("virtual", [True, False])
@pytest.mark.parametrize(("capacity", "block_rows"), [(64, 1000), (1000, 64), (7, 7), (1, 3)])
def test_recorder_keeps_every_row_of_a_faster_producer(
    tmp_path: Path, virtual: bool, capacity: int, block_rows: int
) -> None:
    """If a block is larger than the ring, rows must leave the ring before their block is full."""
    rows = example_rows(120 if capacity > 1 else 20)  # one by one they take long
    ring = Ring.allocate(capacity)
    path = tmp_path / "trial.rigcap"
    with Recorder(path, HEADER, ring, virtual=virtual, block_rows=block_rows) as recorder:
        produce(ring, rows, at_once=50)
        trailer = recorder.finish({"reason": "finished", "peak": 0.1})
    found = open_recording(path)
    assert found.rows.tobytes() == rows.tobytes()
    assert found.complete
    assert found.lost == ()
    assert found.header == HEADER
    assert found.trailer == trailer
    assert trailer["peak"] == 0.1
    assert trailer["recorder"] | {"blocks": 0} == {
        "rows": len(rows), "blocks": 0, "ticks": len(rows), "dropped": 0,
    }  # fmt: skip
    assert recorder.rows == len(rows)
    assert recorder.error == 0


def test_equal_virtual_runs_give_equal_files(tmp_path: Path) -> None:
    """Files are equal bit for bit after the header, however the threads were scheduled."""
    rows = example_rows(5000)
    bodies = []
    for run, at_once in enumerate((1000, 37)):
        ring = Ring.allocate(256)
        header = example_header(host={"run": run})
        path = tmp_path / f"{run}.rigcap"
        with Recorder(path, header, ring, virtual=True, block_rows=300) as recorder:
            produce(ring, rows, at_once)
            recorder.finish({"reason": "finished"})
        data = path.read_bytes()
        assert data.startswith(pack_header(header))
        bodies.append(data[len(pack_header(header)) :])
    assert bodies[0] == bodies[1]


def test_rows_reach_the_file_while_the_loop_runs(tmp_path: Path) -> None:
    """In real time a row is readable soon after it was made, before its block is full."""
    rows = example_rows(3)
    ring = Ring.allocate(16)
    path = tmp_path / "trial.rigcap"
    with Recorder(path, HEADER, ring, flush_s=0.01) as recorder:
        ring.rows[:3] = rows
        ring.put(HEAD, 3)
        deadline = time.monotonic() + 30
        while recorder.rows < 3 and time.monotonic() < deadline:
            time.sleep(0.005)
        found = open_recording(path)
        assert found.rows.tobytes() == rows.tobytes()
        assert not found.complete
        assert found.lost == ()
    assert open_recording(path).complete


def test_an_empty_trial_is_a_recording_that_counts_what_was_dropped(tmp_path: Path) -> None:
    ring = Ring.allocate(4)
    with Recorder(tmp_path / "trial.rigcap", HEADER, ring):
        ring.put(DROPPED, 17)
    found = open_recording(tmp_path / "trial.rigcap")
    assert (len(found), found.complete) == (0, True)
    assert found.trailer is not None
    assert (found.trailer["reason"], found.trailer["recorder"]["dropped"]) == ("finished", 17)


def test_an_exception_of_the_loop_ends_the_recording_and_passes(tmp_path: Path) -> None:
    path = tmp_path / "trial.rigcap"
    ring = Ring.allocate(16)

    def fail() -> None:
        with Recorder(path, HEADER, ring):
            ring.rows[:5] = example_rows(5)
            ring.put(HEAD, 5)
            raise LawError("effort is not finite")

    with pytest.raises(LawError, match="not finite"):
        fail()
    found = open_recording(path)
    assert len(found) == 5
    assert found.complete
    assert found.trailer is not None
    assert found.trailer["reason"] == "LawError: effort is not finite"


def test_recordings_are_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "trial.rigcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="File exists"), Recorder(path, HEADER, Ring.allocate(4)):
        pass
    assert path.read_text() == "precious"


def test_a_missing_directory_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "trial.rigcap"
    with (
        pytest.raises(RecordingError, match="make the directory first") as caught,
        Recorder(path, HEADER, Ring.allocate(4)),
    ):
        pass
    assert str(path) in str(caught.value)


def test_rows_of_another_kind_are_refused(tmp_path: Path) -> None:
    header = {**HEADER, "schema": {"row_bytes": ROW.itemsize + 8, "columns": []}}
    with pytest.raises(RecordingError, match="does not describe the rows"):
        Recorder(tmp_path / "trial.rigcap", header, Ring.allocate(4))


def test_partial_writes_are_continued() -> None:
    """A pipe accepts as many bytes as fit; all must come out complete and in order."""
    data = np.random.default_rng(1).integers(0, 256, 300_000).astype(np.uint8)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    taken = bytearray()

    def take() -> None:
        while chunk := os.read(reading, 10_000):
            taken.extend(chunk)

    reader = threading.Thread(target=take)
    reader.start()
    assert write_all(writing, data.ctypes.data, len(data)) == 0
    os.close(writing)
    reader.join()
    os.close(reading)
    assert bytes(taken) == data.tobytes()


class Producer:
    def __init__(self, ring: Ring) -> None:
        self.ring, self.rows, self.written = ring, example_rows(ring.capacity), 0

    def put(self, recorder: Recorder, count: int, received_at: int = 0) -> None:
        while self.ring.get(HEAD) + count - self.ring.get(TAIL) > self.ring.capacity:
            time.sleep(0.001)
            if recorder.error:
                return
        place = (self.written + np.arange(count)) % self.ring.capacity
        self.ring.rows[place] = self.rows[place]
        self.ring.rows["tick"][place] = np.arange(self.written, self.written + count)
        self.ring.rows["received_at"][place] = received_at
        self.written += count
        self.ring.put(HEAD, self.written)


def record_for_ever(parent: Connection, path: Path) -> None:
    ring = Ring.allocate(4096, info={"recording": str(path)}, shared=True)
    producer, now, pause = Producer(ring), time.monotonic_ns(), 0
    with Recorder(path, HEADER, ring) as recorder:
        while True:
            before, now = now, time.monotonic_ns()
            pause = max(pause, now - before)
            producer.put(recorder, 10, now)
            parent.send((now, recorder.rows, pause))
            time.sleep(0.002)


@pytest.mark.exhaustive("::test_rows_reach_the_file_while_the_loop_runs")
def test_kill_costs_at_most_the_last_second(tmp_path: Path) -> None:
    """The ring is in shared memory as in a real-time loop; the age of rows is measured by their own times."""
    path = tmp_path / "trial.rigcap"
    with forked(record_for_ever, path) as (process, messages):
        first, recorded, pause = messages.recv()
        newest = first
        while newest - first < 1_200_000_000 * AT_RISK_S or not recorded:
            newest, recorded, pause = messages.recv()
        (loop,) = [loop for loop in running() if loop.pid == process.pid]
        process.kill()
        process.join()
        assert loop.pid not in [other.pid for other in running(done=True)]
    found = open_recording(path)
    assert not found.complete
    assert len(found) >= recorded > 0
    assert found.column("tick").tolist() == list(range(len(found)))
    if pause < 200_000_000:  # else the machine stood still, perhaps for the recorder too
        assert newest - found.column("received_at")[-1] < 1_000_000_000 * AT_RISK_S
    (recovered,) = recover([tmp_path])
    assert recovered.outcome == "sealed"
    assert recovered.rows == len(found)


def fill_the_disk(parent: Connection, path: Path) -> None:
    """A file size limit stands in for a full disk: it gives EFBIG where that gives ENOSPC, on the same path."""
    producer = Producer(Ring.allocate(4096))
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, 300_000))
    try:
        with Recorder(f"{path}0", HEADER, producer.ring) as recorder:
            producer.put(recorder, 1)
    except RecordingError as error:
        parent.send(str(error))
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
    try:
        with Recorder(path, HEADER, producer.ring, block_rows=200, flush_s=10.0) as recorder:
            while not recorder.error:
                producer.put(recorder, 100)
            recorder.finish({"reason": "finished"})
    except RecordingError as error:
        parent.send(f"{error}; {recorder.rows}")


def test_full_disk_keeps_the_rows_before_and_leaves_no_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "trial.rigcap"
    with forked(fill_the_disk, path) as (_, messages):
        header_refused, rows_refused = messages.recv(), messages.recv()
    assert header_refused.startswith(f"cannot write {path}0: File too large; free some space")
    assert list(tmp_path.iterdir()) == [path]
    message, _, rows = rows_refused.rpartition("; ")
    assert message.startswith(f"cannot write after row {rows} of {path}: File too large; free some space")
    found = open_recording(path)
    assert len(found) == int(rows) > 500
    assert found.column("tick").tolist() == list(range(len(found)))
    assert not found.complete
    assert [loss.reason for loss in found.lost] == ["torn tail"]
