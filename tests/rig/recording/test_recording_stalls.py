"""The disk stalls while Python holds the GIL: the ring stores every row, or counts it as dropped."""

import ctypes
import gc
import os
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import types

from rig.loop.layout import ROWS_TYPE
from rig.realtime import control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.kernel import kernel, prepare
from rig.realtime.ring import Ring
from rig.realtime.system import monotonic_now, sleep_until
from rig.recording._capture import BLOCK_ROWS, pack_header
from rig.recording.reader import open_recording
from rig.recording.recorder import _HEAD_WORDS, _ROW_WORDS, FLUSH_S, POLL_NS, SYNC_NS, record
from tests.conformance.recording import example_header
from tests.conformance.started import started
from tests.conformance.tiers import first_by_default

RATE = 10_000
MEMORY = 32_000_000  # far less than the rows of a run; garbage and stacks of threads


@kernel(types.int64(types.uintp, ROWS_TYPE, types.int64, types.int64, types.uintp))
def produce(control: Any, rows: Any, period_ns: Any, count: Any, found: Any) -> Any:  # type: ignore[no-untyped-def]
    """Write a row each period as a loop does, or count it as dropped if the ring is full.

    The most rows that waited in the ring and the latest wake-up (ns) go to the words at `found`.
    """
    start = monotonic_now(0) + period_ns
    fullest = latest = dropped = 0
    for n in range(count):
        due = start + n * period_ns
        sleep_until(due)
        latest = max(latest, monotonic_now(0) - due)
        head = load_word(control + 8 * control_words.HEAD)
        waiting = head - load_word(control + 8 * control_words.TAIL)
        if waiting >= len(rows):
            dropped += 1
            store_word(control + 8 * control_words.DROPPED, dropped)
            continue
        row = rows[head % len(rows)]
        row["tick"] = n
        row["count"] = -3 * n
        row["position"] = 0.5 * n
        row["applied_at"] = n + 7
        store_word(control + 8 * control_words.HEAD, head + 1)
        fullest = max(fullest, waiting + 1)
    store_word(found, fullest)
    store_word(found + 8, latest)
    store_word(control + 8 * control_words.LOOP_DONE, 1)
    return 0


@dataclass(frozen=True)
class DiskRun:
    dropped: int
    fullest: int  # rows that waited in the ring
    worst_late_s: float  # wake-up of the producer: on a machine that stood still, rows come in a burst


def record_beside_a_stall(
    path: Path, seconds: float, stall_s: float, *, ring_s: float = 5.0, shared: bool = True
) -> DiskRun:
    """Stop the disk, a process behind a pipe, and hold the GIL meanwhile; check that each row is whole or counted."""
    prepare(produce, record)
    count, measured = round(seconds * RATE), np.zeros(2, np.int64)
    block = np.zeros(_HEAD_WORDS + BLOCK_ROWS * _ROW_WORDS + 1, np.int64)
    with (
        Ring.allocate(round(ring_s * RATE), shared=shared) as ring,
        open(path, "wb") as file,
        started("cat", stdin=subprocess.PIPE, stdout=file, bufsize=0) as disk,
    ):
        ring.rows.view(np.uint8)[:] = 0  # every page is there before memory is looked at
        words, pipe = ring.words.ctypes.data, disk.stdin.fileno()
        times = (round(FLUSH_S * 1e9), SYNC_NS, POLL_NS)
        producing = (words, ring.rows, round(1e9 / RATE), count, measured.ctypes.data)
        recording = (words, ring.rows.view(np.int64), pipe, block, *times)
        recorder = threading.Thread(target=record, args=recording, daemon=True)
        producer = threading.Thread(target=produce, args=producing, daemon=True)
        os.write(pipe, pack_header(example_header()))
        before = resident_bytes()
        recorder.start()
        producer.start()
        time.sleep(0.06)
        disk.send_signal(signal.SIGSTOP)
        assert ctypes.PyDLL(None).usleep(round(stall_s * 1e6)) == 0  # unlike CDLL, PyDLL keeps the GIL
        disk.send_signal(signal.SIGCONT)
        while producer.is_alive():
            rubbish: list[object] = []
            for _ in range(1000):
                rubbish = [rubbish]
            gc.collect(0)
        recorder.join(60.0)
        assert not recorder.is_alive()
        assert resident_bytes() - before < MEMORY
        disk.stdin.close()
        disk.wait(60.0)
        dropped = ring.get(control_words.DROPPED)
        recorded, error = ring.get(control_words.RECORDED), ring.get(control_words.RECORDER_ERROR)
    found = open_recording(path)
    assert (recorded, len(found), found.lost, error) == (count - dropped, count - dropped, (), 0)
    tick = found.column("tick")
    assert (np.diff(tick, prepend=-1) > 0).all()
    assert (found.column("count") == -3 * tick).all()
    assert (found.column("position") == 0.5 * tick).all()
    assert (found.column("applied_at") == tick + 7).all()
    return DiskRun(dropped, int(measured[0]), 1e-9 * measured[1])


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.parametrize("shared", first_by_default([False, True]))
def test_a_stall_of_the_disk_and_of_python_costs_no_row(shared: bool, tmp_path: Path) -> None:
    """The loop runs at 10 kHz with a trial's usual ring of 5 s."""
    run = record_beside_a_stall(tmp_path / "one.rigcap", 0.5, 0.35, shared=shared)
    if run.worst_late_s < 1.0:
        assert run.dropped == 0
    if run.worst_late_s < 0.1:
        assert run.fullest > 0.2 * RATE  # the ring did carry the stall


@pytest.mark.exhaustive(
    "tests/rig/loop/test_loop.py::test_in_real_time_a_full_ring_drops_rows_and_counts_them"
)
def test_a_stall_longer_than_the_ring_costs_what_the_ring_cannot_hold_and_no_more(tmp_path: Path) -> None:
    """Scaled down from a stall of 6 s with a ring of 5 s: rows that fit arrive, the others are counted."""
    run = record_beside_a_stall(tmp_path / "one.rigcap", 0.95, 0.7, ring_s=0.15)
    assert run.fullest == 0.15 * RATE
    # Of the stall's rows the ring holds a fifth; a block, the pipe and its reader hold some thousands more.
    if run.worst_late_s < 0.1:
        assert 0 < run.dropped < 0.55 * RATE
