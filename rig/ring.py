"""One block of memory between the loop, the recorder and whoever supervises them.

Layout (version 1): `WORDS` int64 control words, then `capacity` rows of `rig.sample.ROW`. Every word has
one writer; all sides load and store words through `rig.words`. The block is one contiguous buffer, so that
it can become shared memory without a change of layout.

The loop writes row ``HEAD % capacity`` and then publishes HEAD + 1; the recorder copies rows up to HEAD and
publishes TAIL. When the ring is full the loop either drops the row and counts it (real time: the recorder
must never delay a tick) or waits for room (virtual time: nothing is ever lost, and runs are repeatable).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.sample import ROW
from rig.words import read_word, write_word

LAYOUT_VERSION = 2
WORDS = 64

# word                 writer       meaning
VERSION = 0  # creator     layout version
HEAD = 1  # loop        rows written so far
TAIL = 2  # recorder    rows drained so far
STOP = 3  # anybody     non-zero: the loop ends within one tick (a StopReason)
DROPPED = 4  # loop        rows lost because the ring was full
TICKS = 5  # loop        steps of the law so far
PHASE = 6  # loop        rig.sample.Phase now
LOOP_DONE = 7  # loop        1 when the loop has returned and will write nothing more
HEARTBEAT = 8  # supervisor  time (ns, loop's clock) until which the loop may run; 0 switches the check off
RECORDER_ERROR = 9  # recorder    0, or the errno that stopped the recorder
RECORDED = 10  # recorder    rows that are in the file
END_REASON = 11  # loop        why the loop ended (rig.loop.host.EndReason)
END_ERRNO = 12  # loop        errno behind a broken link, else 0
# Counters of the link, written by the loop.
FRAMES = 16  # frames received whole
BAD_FRAMES = 17  # frames with a wrong checksum, encoding or length
OTHER_FRAMES = 18  # frames that were not STATE of this session
DUPLICATED = 19  # samples received twice
REORDERED = 20  # samples older than one already seen
LOST = 21  # samples that never arrived
COMMANDS = 22  # commands sent
UNSENT = 23  # commands that the link did not take whole
LATE = 24  # samples received more than one period after the grid
SKIPPED = 25  # samples that arrived, but behind a newer one that the law saw instead
STALE = 26  # ticks of a host-paced loop, or periods of waiting, without a fresh sample
OVERRUNS = 27  # grid points of a host-paced loop that passed before it woke
EXCHANGES = 28  # clock exchanges completed
PARAMETER_SET = 29  # number of the parameter set in force


@dataclass(frozen=True, slots=True)
class Ring:
    """The block and its two views: `words` (int64) and `rows` (`rig.sample.ROW`)."""

    buffer: NDArray[np.uint8]
    words: NDArray[np.int64]
    rows: NDArray[np.void]

    @classmethod
    def allocate(cls, capacity: int) -> Ring:
        """Make a zeroed ring for `capacity` rows."""
        buffer = np.zeros(WORDS * 8 + capacity * ROW.itemsize, dtype=np.uint8)
        words = buffer[: WORDS * 8].view(np.int64)
        rows = buffer[WORDS * 8 :].view(ROW)
        words[VERSION] = LAYOUT_VERSION
        return cls(buffer, words, rows)

    @property
    def capacity(self) -> int:
        """Rows that fit."""
        return len(self.rows)

    def get(self, word: int) -> int:
        """Load a control word."""
        return int(read_word(self.words.ctypes.data + 8 * word))

    def put(self, word: int, value: int) -> None:
        """Store a control word."""
        write_word(self.words.ctypes.data + 8 * word, value)

    def last_rows(self, count: int) -> NDArray[np.void]:
        """Copy the newest `count` rows, oldest first: the black box that an error carries."""
        head = self.get(HEAD)
        first = max(0, head - min(count, self.capacity))
        return self.rows[np.arange(first, head) % self.capacity].copy()
