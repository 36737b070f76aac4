"""A recorder between a loop that never waits and a disk that stalls: which rows arrive, which are counted as lost.

The disk is a pipe to a separate process, which pauses on request, checks every block and stores none, so that a long
run needs no more space than a short one. The loop is a compiled producer at a fixed rate, which drops rows when the
ring is full, as the real loop does. Meanwhile Python holds the GIL while the disk pauses.
"""

import ctypes
import gc
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import types

from rig.core.sample import ROW
from rig.loop.layout import ROWS_TYPE
from rig.realtime import control_words
from rig.realtime.atomics import load_word, store_word
from rig.realtime.kernel import kernel
from rig.realtime.ring import Ring
from rig.realtime.system import monotonic_now, sleep_until
from rig.recording._capture import BLOCK_ROWS, pack_header
from rig.recording.recorder import _HEAD_WORDS, _ROW_WORDS, FLUSH_S, POLL_NS, SYNC_NS, record
from tests.conformance.recording import example_header
from tests.conformance.started import started

# The disk. Arguments: bytes of the header, bytes and dtype of a row, the pauses. It prints "ready", then what it got.
DISK = """
import json, struct, sys, time, zlib
import numpy as np

header, row_bytes, dtype, pauses = int(sys.argv[1]), int(sys.argv[2]), eval(sys.argv[3]), json.loads(sys.argv[4])
ROW, source = np.dtype(dtype, align=True), sys.stdin.buffer
print("ready", flush=True)
found = {"rows": 0, "blocks": 0, "missing": 0, "bad": 0, "bytes": len(source.read(header)), "last": -1}
started = time.monotonic()
while head := source.read(48):
    magic, number, first, count, size, crc = struct.unpack("<8s5q", head)
    body, end = source.read(size), source.read(8)
    bad = magic != b"\\x89RIGROWS" or crc != zlib.crc32(head[:40]) or number != found["blocks"]
    bad |= first != found["rows"] or size != count * row_bytes
    bad |= struct.unpack("<q", end)[0] != zlib.crc32(head + body)
    rows = np.frombuffer(body, ROW)
    tick = rows["tick"]
    steps = np.diff(tick, prepend=found["last"])
    bad |= bool((steps < 1).any() or (rows["count"] != -3 * tick).any())
    bad |= bool((rows["position"] != 0.5 * tick).any() or (rows["applied_at"] != tick + 7).any())
    found["bad"] += bad
    found["missing"] += int((steps - 1).sum())
    found["last"] = int(tick[-1])
    found["rows"] += count
    found["blocks"] += 1
    if pauses and time.monotonic() - started > pauses[0][0]:
        time.sleep(pauses.pop(0)[1])
print(json.dumps(found), flush=True)
"""


@dataclass(frozen=True, slots=True)
class DiskRun:
    """The result of a run.

    Attributes
    ----------
    made
        Ticks of the producer.
    dropped
        Rows that it counted as lost because the ring was full.
    arrived, missing, bad
        Rows that the disk received, ticks that it did not receive, invalid blocks.
    recorded
        Rows that the recorder reports as written.
    error
        Errno of the recorder.
    fullest
        Largest number of rows that waited in the ring.
    worst_late_s
        Largest delay of a wake-up of the producer.
    longest_hold_s
        Longest time for which the GIL was held.
    grown_bytes
        Resident memory after the run less that before.
    """

    made: int
    dropped: int
    arrived: int
    missing: int
    bad: int
    recorded: int
    error: int
    fullest: int
    worst_late_s: float
    longest_hold_s: float
    grown_bytes: int


@kernel(types.int64(types.uintp, ROWS_TYPE, types.int64, types.int64, types.uintp))
def produce(control: Any, rows: Any, period_ns: Any, count: Any, found: Any) -> Any:  # type: ignore[no-untyped-def]
    """Write a row each period; count it as dropped if the ring is full. Results go to the words at `found`."""
    start = monotonic_now(0) + period_ns
    fullest = latest = 0
    for n in range(count):
        due = start + n * period_ns
        now = monotonic_now(0)
        if now < due:
            sleep_until(due)
            now = monotonic_now(0)
        latest = max(latest, now - due)
        head = load_word(control + 8 * control_words.HEAD)
        waiting = head - load_word(control + 8 * control_words.TAIL)
        if waiting >= len(rows):
            store_word(
                control + 8 * control_words.DROPPED, load_word(control + 8 * control_words.DROPPED) + 1
            )
        else:
            row = rows[head % len(rows)]
            row["tick"] = n
            row["count"] = -3 * n
            row["position"] = 0.5 * n
            row["applied_at"] = n + 7
            store_word(control + 8 * control_words.HEAD, head + 1)
            fullest = max(fullest, waiting + 1)
        store_word(control + 8 * control_words.TICKS, n + 1)
    store_word(found, fullest)
    store_word(found + 8, latest)
    store_word(control + 8 * control_words.LOOP_DONE, 1)
    return 0


def record_on_a_pausing_disk(
    seconds: float,
    *,
    rate_hz: int = 10_000,
    pauses: Sequence[tuple[float, float]] = ((1.0, 1.0),),
    ring_s: float = 5.0,
    shared: bool = True,
) -> DiskRun:
    """Run producer, recorder and disk; Python holds the GIL whenever the disk pauses.

    Parameters
    ----------
    seconds
        Length of the run.
    rate_hz
        Rows a second.
    pauses
        When the disk pauses (s from the start) and for how long (s), in order of time.
    ring_s
        Room of the ring.
    shared
        The ring in shared memory, as in real time.
    """
    header = pack_header(example_header())
    arguments = [str(len(header)), str(ROW.itemsize), repr(ROW.descr), json.dumps(list(pauses))]
    command = [sys.executable, "-c", DISK, *arguments]
    with started(*command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as disk:
        assert disk.stdout is not None
        assert disk.stdout.readline() == b"ready\n"
        with Ring.allocate(round(ring_s * rate_hz), shared=shared) as ring:
            ring.rows.view(np.uint8)[:] = 0  # every page is there before memory is looked at
            return _run(ring, header, disk, seconds, rate_hz, pauses)


def _run(
    ring: Ring,
    header: bytes,
    disk: subprocess.Popen[bytes],
    seconds: float,
    rate_hz: int,
    pauses: Sequence[tuple[float, float]],
) -> DiskRun:
    assert disk.stdin is not None
    assert disk.stdout is not None
    block = np.zeros(_HEAD_WORDS + BLOCK_ROWS * _ROW_WORDS + 1, np.int64)
    measured = np.zeros(2, np.int64)
    address, pipe = ring.words.ctypes.data, disk.stdin.fileno()
    rows = ring.rows.view(np.int64)
    times = (round(FLUSH_S * 1e9), SYNC_NS, POLL_NS)
    count = round(seconds * rate_hz)
    producer = threading.Thread(
        target=produce, args=(address, ring.rows, round(1e9 / rate_hz), count, measured.ctypes.data)
    )
    recorder = threading.Thread(target=record, args=(address, rows, pipe, block, *times))
    os.write(pipe, header)
    before, started = _resident_bytes(), time.monotonic()
    for thread in (recorder, producer):
        thread.daemon = True
        thread.start()
    longest_hold_s = _keep_python_busy(producer, started, list(pauses))
    recorder.join(60.0 + sum(length for _, length in pauses))
    assert not recorder.is_alive()
    grown = _resident_bytes() - before
    disk.stdin.close()
    found = json.loads(disk.stdout.readline())
    # What was dropped at the very end is not between two rows of the disk.
    missing = found["missing"] + count - 1 - found["last"]
    return DiskRun(
        made=ring.get(control_words.TICKS),
        dropped=ring.get(control_words.DROPPED),
        arrived=found["rows"],
        missing=missing,
        bad=found["bad"],
        recorded=ring.get(control_words.RECORDED),
        error=ring.get(control_words.RECORDER_ERROR),
        fullest=int(measured[0]),
        worst_late_s=float(measured[1] * 1e-9),
        longest_hold_s=longest_hold_s,
        grown_bytes=grown,
    )


def _keep_python_busy(producer: threading.Thread, started: float, pauses: list[tuple[float, float]]) -> float:
    """Hold the GIL while the disk pauses, else create garbage; return the longest hold (s)."""
    hold = ctypes.PyDLL(None).usleep  # unlike CDLL, a call through PyDLL keeps the lock
    longest_s = 0.0
    while producer.is_alive():
        if pauses and time.monotonic() - started > pauses[0][0]:
            _, length_s = pauses.pop(0)
            begun = time.monotonic()
            hold(round(min(length_s, 1.0) * 0.999e6))  # usleep takes less than a second
            longest_s = max(longest_s, time.monotonic() - begun)
        rubbish: list[object] = []
        for _ in range(1000):
            rubbish = [rubbish]
        gc.collect(0)
    return longest_s


def _resident_bytes() -> int:
    """Return the resident memory of this process (bytes)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
