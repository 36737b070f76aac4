"""Recorder: writes the rows of a control loop to disk in a thread of its own, in parallel with the loop.

`record` is one compiled function that runs in this thread; `Recorder` opens the file, starts the thread and waits for
its end. In real time, a row reaches the file within `flush_s`.

Trials start the recorder, and `rig.experiments.trials.recover` reads from this module how much a crash may cost. The
recorder must not delay a loop in real time, so its kernels run without the GIL (Python's global interpreter lock).
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from rig.core import locks
from rig.core.errors import RecordingError
from rig.core.sample import ROW
from rig.realtime.atomics import load_word, store_word
from rig.realtime.codec import crc32
from rig.realtime.control_words import DROPPED, HEAD, LOOP_DONE, RECORDED, RECORDER_ERROR, TAIL, TICKS
from rig.realtime.handlers import take_no_signals
from rig.realtime.kernel import kernel, prepare
from rig.realtime.ring import Ring
from rig.realtime.system import EIO, descriptor_sync, descriptor_write, monotonic_now, sleep_until
from rig.recording._capture import BLOCK_ROWS, CRC_BYTES, HEAD_BYTES, ROWS_MAGIC, pack_end, pack_header
from rig.recording.canonical import lossless
from rig.recording.files import disk_error, plain_errors, sync_directory

FLUSH_S = 0.25
SYNC_NS = 500_000_000
# A power cut may cost this: a flush each 0.25 s, and a sync with a flush 0.5 s after the last one.
AT_RISK_S = 1.0
POLL_NS = 2_000_000
POLL_VIRTUAL_NS = 1_000_000
# Attempts to write to a file that accepts no bytes, 2 ms apart, before the recorder reports EIO.
PATIENCE = 1000

if sys.platform == "win32":
    # Without this flag Windows writes each byte 0x0A as two bytes.
    _BINARY = os.O_BINARY
else:
    _BINARY = 0

_HEAD_WORDS = HEAD_BYTES // 8
_ROW_WORDS = ROW.itemsize // 8
_MAGIC_WORD = int.from_bytes(ROWS_MAGIC, "little")

_i64, _words, _address = types.int64, types.int64[::1], types.uintp


@kernel(_i64(_words, _i64, _i64, _words, _i64))
def take_rows(
    ring_rows: NDArray[np.int64], tail: int, head: int, block: NDArray[np.int64], filled: int
) -> int:
    """Copy rows from the ring buffer into a block of the file, as many as fit; return the number of copied rows.

    `tail` and `head` are the numbers of the first row to copy and of the first row that is not yet written by the loop.
    `filled` is the number of rows that the block already contains.
    """
    capacity = len(ring_rows) // _ROW_WORDS
    room = (len(block) - _HEAD_WORDS - 1) // _ROW_WORDS - filled
    taken = min(head - tail, room)
    for row in range(taken):
        source = ((tail + row) % capacity) * _ROW_WORDS
        target = _HEAD_WORDS + (filled + row) * _ROW_WORDS
        for word in range(_ROW_WORDS):
            block[target + word] = ring_rows[source + word]
    return taken


@kernel(_i64(_words, _i64, _i64, _i64))
def close_block(block: NDArray[np.int64], number: int, first_row: int, count: int) -> int:
    """Write head and CRC of a block of `count` rows (layout: `rig.recording._capture`); return its size in bytes."""
    size = count * _ROW_WORDS * 8
    data = block.view(np.uint8)
    block[0] = _MAGIC_WORD
    block[1] = number
    block[2] = first_row
    block[3] = count
    block[4] = size
    block[5] = crc32(data, 0, HEAD_BYTES - 8, 0)
    end = HEAD_BYTES + size
    block[end // 8] = crc32(data, 0, end, 0)
    return end + CRC_BYTES


@kernel(_i64(_i64, _address, _i64))
def write_all(descriptor: int, address: int, size: int) -> int:
    """Write `size` bytes from a memory address to a file; return 0, or the errno of the call that failed."""
    done = 0
    idle = 0
    while done < size:
        wrote = descriptor_write(descriptor, address + done, size - done)
        if wrote < 0:
            return -wrote
        idle = idle + 1 if wrote == 0 else 0
        if idle > PATIENCE:
            return EIO
        if wrote == 0:
            sleep_until(monotonic_now(0) + POLL_NS)
        done += wrote
    return 0


# Compiled: under a busy Python program a recorder written in Python lost 13 to 63 % of the rows of a 20 kHz loop.
@kernel(_i64(_address, _words, _i64, _words, _i64, _i64, _i64))
def record(
    words: int,
    ring_rows: NDArray[np.int64],
    descriptor: int,
    block: NDArray[np.int64],
    flush_ns: int,
    sync_ns: int,
    poll_ns: int,
) -> int:
    """Write the rows of the ring buffer to a file until the control loop is done; return the number of written blocks.

    On a disk error, store the errno among the control words and return; the loop then counts the rows that it cannot
    store.

    Parameters
    ----------
    words, ring_rows
        Address of the words by which loop and recorder communicate, and the rows of a `rig.realtime.ring.Ring` as
        int64.
    descriptor
        Descriptor of an open file that already contains the header.
    block
        Memory for one block: head, rows and CRC.
    flush_ns
        Age at which rows are written although their block is not full (ns); 0 (virtual time): write only full blocks.
    sync_ns
        Least time between two calls of fdatasync (ns); 0: never call it.
    poll_ns
        Time to sleep when the ring buffer is empty (ns).
    """
    block_rows = (len(block) - _HEAD_WORDS - 1) // _ROW_WORDS
    number = 0
    recorded = 0
    filled = 0
    tail = load_word(words + 8 * TAIL)
    synced_at = monotonic_now(0)
    oldest_at = synced_at
    while True:
        # LOOP_DONE before HEAD: a loop that is done has published its last row, so this HEAD is final.
        done = load_word(words + 8 * LOOP_DONE)
        head = load_word(words + 8 * HEAD)
        now = monotonic_now(0)
        if filled == 0:
            oldest_at = now
        # Rows leave the ring at once, also for a block that is not full: a slow write costs room only while it lasts.
        taken = take_rows(ring_rows, tail, head, block, filled)
        tail += taken
        filled += taken
        store_word(words + 8 * TAIL, tail)
        last = done != 0 and tail == head
        # Not by age in virtual time: a wall clock would make every file different.
        old = flush_ns > 0 and now - oldest_at >= flush_ns
        if filled == block_rows or (filled > 0 and (last or old)):
            size = close_block(block, number, recorded, filled)
            error = write_all(descriptor, block.ctypes.data, size)
            if error == 0 and sync_ns > 0 and now - synced_at >= sync_ns:
                error = descriptor_sync(descriptor)
                synced_at = now
            if error != 0:
                store_word(words + 8 * RECORDER_ERROR, error)
                return number
            number += 1
            recorded += filled
            filled = 0
            store_word(words + 8 * RECORDED, recorded)
        elif last:
            return number
        elif taken == 0:
            sleep_until(now + poll_ns)


class Recorder:
    """Context manager that writes the rows of a control loop from its ring buffer to a file.

    A recorder serves one ring buffer and one run of the loop. Leaving the context ends the recording, also after an
    exception of the loop. Call `finish` earlier to write a trailer and to make sure that all rows are on disk. Raise
    `RecordingError` if the file exists or cannot be created, or the header does not describe the loop's rows.

    Parameters
    ----------
    path
        Path of the new file. The file must not exist, its directory must exist.
    header
        Header from `rig.recording.header.make_header`, for rows of `rig.core.sample.ROW`.
    ring
        Ring buffer into which the loop writes its rows.
    virtual
        True if the loop runs in virtual time: only full blocks are written, so that equal runs give equal files.
    block_rows
        Number of rows per block.
    flush_s
        Age at which rows are written although their block is not full (s; only in real time).
    """

    def __init__(
        self,
        path: str | Path,
        header: Mapping[str, Any],
        ring: Ring,
        *,
        virtual: bool = False,
        block_rows: int = BLOCK_ROWS,
        flush_s: float = FLUSH_S,
    ) -> None:
        if header["schema"]["row_bytes"] != ROW.itemsize or sys.byteorder != "little":
            raise RecordingError(
                f"the header does not describe the rows of the loop, which have {ROW.itemsize} bytes, little-endian",
                remedy="make the header with make_header() and its default columns",
            )
        prepare(record)
        self.path = Path(path)
        self._ring = ring
        self._block = np.zeros(_HEAD_WORDS + block_rows * _ROW_WORDS + 1, dtype=np.int64)
        self._times = (0, 0, POLL_VIRTUAL_NS) if virtual else (int(flush_s * 1e9), SYNC_NS, POLL_NS)
        self._blocks = 0
        self._trailer: dict[str, Any] | None = None
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._header = pack_header(dict(header))
        self._descriptor = -1

    def __enter__(self) -> Recorder:
        """Create the file and start the thread that records."""
        self._descriptor = _create(self.path, self._header)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the recording; after an exception of the loop, write its text into the data at the file's end."""
        if error is None:
            self.finish()
            return
        try:
            self.finish({"reason": f"{type(error).__name__}: {error}"})
        except RecordingError as own:
            error.add_note(f"the recording also failed: {own}")

    @property
    def rows(self) -> int:
        """Number of rows that are in the file so far."""
        return self._ring.get(RECORDED)

    @property
    def error(self) -> int:
        """The errno of the disk error that stopped the recorder; 0 without an error."""
        return self._ring.get(RECORDER_ERROR)

    def finish(self, trailer: Mapping[str, Any] | None = None, *, timeout_s: float = 10.0) -> dict[str, Any]:
        """Write the remaining rows and the trailer, flush and close the file, and return the trailer.

        Call `finish` after the loop has returned: later rows are not recorded. A second call only returns the trailer.
        Raise `RecordingError` if the disk reports an error or takes longer than `timeout_s`; earlier rows are in the
        file.

        Parameters
        ----------
        trailer
            Reason of the end of the trial, and its statistics; the numbers of rows, blocks, ticks and dropped rows are
            added under the key ``recorder``.
        timeout_s
            Longest wait for the disk (s).
        """
        if self._trailer is not None:
            return self._trailer
        self._ring.put(LOOP_DONE, 1)
        self._thread.join(timeout_s)
        # The thread still uses the descriptor, which therefore stays open.
        if self._thread.is_alive():
            raise RecordingError(
                f"{self.path}: the disk did not accept the last rows within {timeout_s:g} s",
                remedy="check the system's log for errors of the disk; the earlier rows are in the file",
            )
        counts = {"rows": self.rows, "blocks": self._blocks}
        counts |= {"ticks": self._ring.get(TICKS), "dropped": self._ring.get(DROPPED)}
        self._trailer = {**lossless(trailer or {"reason": "finished"}), "recorder": counts}
        with plain_errors("write", self.path):
            try:
                if self.error:
                    raise disk_error(f"write after row {self.rows} of", self.path, self.error)
                _write(self._descriptor, pack_end(self._blocks, self.rows, self._trailer))
                os.fsync(self._descriptor)
            finally:
                os.close(self._descriptor)
        sync_directory(self.path.parent)
        return self._trailer

    def _run(self) -> None:
        # A signal that is handled in this thread would end its sleep early.
        take_no_signals()
        rows = self._ring.rows.view(np.int64)
        flush_ns, sync_ns, poll_ns = self._times
        words = self._ring.words.ctypes.data
        self._blocks = record(words, rows, self._descriptor, self._block, flush_ns, sync_ns, poll_ns)


def _create(path: Path, header: bytes) -> int:
    with plain_errors("write", path):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o644)
        # The lock shows other programs that the file is still being written, and was not cut off by a crash.
        with suppress(OSError):  # a file system without locks
            locks.lock(descriptor)
        try:
            _write(descriptor, header)
        except OSError:
            os.close(descriptor)
            path.unlink(missing_ok=True)
            raise
    return descriptor


def _write(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]
