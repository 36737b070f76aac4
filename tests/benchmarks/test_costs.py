"""Measure the cost of work on a whole session, as ratios within one run; absolute times are printed."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from rig.core.clock_fit import EXCHANGE, fit_clock
from rig.core.sample import ROW
from rig.recording._timing_summary import summarise
from rig.recording.timing import ledger


def clock_work(count: int) -> Callable[[], object]:
    exchanges = np.zeros(count, EXCHANGE)
    waits = np.random.default_rng(1).integers(0, 20_000, (count, 2)).cumsum(axis=1)
    sent = exchanges["host_sent"] = np.arange(count) * 100_000_000
    exchanges["device_received"] = exchanges["device_sent"] = sent + 40_000 + waits[:, 0]
    exchanges["host_received"] = sent + 100_000 + waits[:, 1]
    return lambda: fit_clock(exchanges)


def row_work(count: int) -> Callable[[], object]:
    rows = np.zeros(50 * count, ROW)
    ticks = np.arange(len(rows))
    rows["sample_index"] = rows["tick"] = ticks
    rows["device_time"], rows["received_at"] = ticks * 100_000, ticks * 100_000 + 30_000
    rows["computed_at"], rows["sent_at"] = rows["received_at"] + 3_000, rows["received_at"] + 10_000
    rows["command_sequence"], rows["command_active"] = ticks % 65536, (ticks - 2) % 65536
    exchanges = np.zeros(2, EXCHANGE)
    for number, name in enumerate(EXCHANGE.names or ()):
        exchanges[name] = (number * 20_000, number * 20_000 + rows["device_time"][-1])
    clock = fit_clock(exchanges)
    return lambda: summarise(ledger(rows, clock, 100_000.0), None)


@pytest.mark.parametrize("made", [clock_work, row_work])
def test_work_on_a_session_grows_with_its_length_alone(
    made: Callable[[int], Callable[[], object]],
) -> None:
    times = []
    for count in (2_000, 20_000):
        work, best = made(count), np.inf
        for _ in range(5):
            started = time.perf_counter()
            work()
            best = min(best, time.perf_counter() - started)
        times.append(best)
    short, long = times
    print(f"\n{made.__name__}: {1e3 * short:.1f} ms, ten times as long {1e3 * long:.1f} ms")
    assert long < 30.0 * short  # ten times; its square is a hundred
