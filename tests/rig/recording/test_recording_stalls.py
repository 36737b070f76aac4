"""The disk stalls while Python holds the GIL: the ring stores every row, or counts it as dropped."""

import pytest

from tests.conformance.stalled_disk import DiskRun, record_on_a_pausing_disk
from tests.conformance.tiers import first_by_default

RATE = 10_000
MEMORY = 32_000_000  # far less than the rows of a run; garbage and stacks of threads


def check(run: DiskRun, made: int) -> None:
    """Assert that every row arrived, whole and in order, or was counted, on a machine of any speed."""
    assert (run.made, run.error, run.bad) == (made, 0, 0)
    assert run.arrived == run.recorded == made - run.dropped
    assert run.missing == run.dropped
    assert run.grown_bytes < MEMORY


@pytest.mark.parametrize("shared", first_by_default([False, True]))
def test_a_stall_of_the_disk_and_of_python_costs_no_row(shared: bool) -> None:
    """The loop runs at 10 kHz with a trial's usual ring of 5 s."""
    run = record_on_a_pausing_disk(0.5, rate_hz=RATE, pauses=[(0.06, 0.35)], shared=shared)
    check(run, round(0.5 * RATE))
    assert run.longest_hold_s > 0.3
    if run.worst_late_s < 1.0:  # else the machine stood still, and rows came in a burst
        assert run.dropped == 0
    if run.worst_late_s < 0.1:
        assert run.fullest > 0.2 * RATE  # the ring did carry the stall


@pytest.mark.exhaustive(
    "tests/rig/loop/test_loop.py::test_in_real_time_a_full_ring_drops_rows_and_counts_them"
)
def test_a_stall_longer_than_the_ring_costs_what_the_ring_cannot_hold_and_no_more() -> None:
    """Scaled down from a stall of 6 s with a ring of 5 s: rows that fit arrive, the others are counted."""
    run = record_on_a_pausing_disk(0.95, rate_hz=RATE, pauses=[(0.1, 0.7)], ring_s=0.15)
    check(run, round(0.95 * RATE))
    assert run.fullest == 0.15 * RATE
    # Of the stall's rows the ring holds a fifth; a block, the pipe and its reader hold some thousands more.
    if run.worst_late_s < 0.1:
        assert 0 < run.dropped < 0.55 * RATE
