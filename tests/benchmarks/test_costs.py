"""Measure the cost of judging and of a whole session, as ratios within one run; absolute times are printed."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rig.control.judging import recorded_signals
from rig.core.clock_fit import EXCHANGE, fit_clock
from rig.core.sample import ROW, Phase
from rig.recording._timing_summary import summarise
from rig.recording.timing import ledger


def per_call(function: Any, calls: Any, repeats: int = 5) -> Any:
    """Return the shortest mean time of a call (s) over some batches."""
    best = np.inf
    for _ in range(repeats):
        started = time.perf_counter()
        for _ in range(calls):
            function()
        best = min(best, (time.perf_counter() - started) / calls)
    return best


def test_the_signals_of_a_trial_cost_less_than_a_copy_of_its_rows() -> None:
    rows = np.zeros(20_000, ROW)
    rows["phase"] = Phase.TRIAL
    signals, copy = per_call(lambda: recorded_signals(rows, 5e-5, 1e-5), 10), per_call(rows.copy, 10)
    print(f"\n{len(rows)} rows: signals {1e3 * signals:.2f} ms, copy {1e3 * copy:.2f} ms")
    assert signals < copy


@pytest.mark.parametrize("what", ["clock fit", "latency ledger"])
def test_work_on_a_whole_session_grows_with_its_length_not_with_its_square(what: str) -> None:
    few, many = 2_000, 20_000

    def clock_work(count: int) -> Callable[[], object]:
        exchanges = np.zeros(count, EXCHANGE)
        waits = np.random.default_rng(1).integers(0, 20_000, (count, 2)).cumsum(axis=1)
        exchanges["host_sent"] = np.arange(count) * 100_000_000
        exchanges["device_received"] = exchanges["device_sent"] = (
            exchanges["host_sent"] + 40_000 + waits[:, 0]
        )
        exchanges["host_received"] = exchanges["host_sent"] + 100_000 + waits[:, 1]
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

    made = clock_work if what == "clock fit" else row_work
    short, long = (per_call(made(count), 1) for count in (few, many))
    print(f"\n{what}: {1e3 * short:.1f} ms, ten times as long {1e3 * long:.1f} ms")
    assert long < 30.0 * short  # ten times; its square is a hundred
