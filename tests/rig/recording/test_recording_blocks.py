"""The recorder's compiled parts against the readable description of the format; also run without the compiler."""

import numpy as np

from rig.core.sample import ROW
from rig.recording._capture import HEAD_BYTES, ROWS_MAGIC, pack_block
from rig.recording.recorder import close_block, take_rows
from tests.conformance.recording import example_rows


def test_compiled_blocks_equal_the_readable_ones() -> None:
    rows = example_rows(9)
    ring = np.ascontiguousarray(rows).view(np.int64)
    block = np.zeros(HEAD_BYTES // 8 + 5 * ROW.itemsize // 8 + 1, dtype=np.int64)
    assert take_rows(ring, 25, 28, block, 0) == 3
    assert take_rows(ring, 28, 60, block, 3) == 2
    taken = np.concatenate([rows[25 % 9 :], rows[:3]])
    assert taken.tobytes() == rows[np.arange(25, 30) % 9].tobytes()
    for count in (5, 3):
        size = close_block(block, 4, 1000, count)
        expected = pack_block(ROWS_MAGIC, 4, 1000, count, taken[:count].tobytes())
        assert block.tobytes()[:size] == expected
