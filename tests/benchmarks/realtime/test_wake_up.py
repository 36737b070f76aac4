"""Compare the wake-up latency of the loop with cyclictest and with a plain Python loop.

The shipped loop (`rig.loop`), paced by the host, does its complete tick against a far end of negligible cost.
cyclictest runs at the same interval, priority and processor with locked memory; the Python loop only records the time
and sleeps with `time.sleep`. They run in turn; the medians of the rounds and the largest latency are printed.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.benchmarks.realtime.workbench import (
    CPUS,
    FULL,
    LOOP_CPU,
    PRIORITY,
    NearLink,
    compile_c,
    cyclictest_latency,
    find_cyclictest,
    may_be_realtime,
    medians,
    print_table,
    processor_hogs,
    python_lateness,
    quantiles,
    running_loop,
)

RATES = (1000, 2000, 5000, 10_000) if FULL else (10_000,)
ROUNDS, SECONDS = (7, 1.0) if FULL else (3, 0.3)
SPIN_NS = 30_000
SPINNING = f"rig, awake for the last {SPIN_NS // 1000} µs"
GOAL = 1.25  # p99 of the loop over that of cyclictest
MOST = 3.0  # what a disturbed machine may make of it

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not may_be_realtime():
        pytest.skip("SCHED_FIFO is not granted here (CAP_SYS_NICE, or rtprio in limits.conf)")
    return compile_c(tmp_path_factory.mktemp("c"), "near", "-fPIC", "-shared")


def loop_lateness(near: Path, rate: int, spin_ns: int) -> np.ndarray:
    """Return the lateness of each tick of the loop against the grid point that it slept for (ns)."""
    ring = Ring.allocate(round(2 * SECONDS * rate))
    with running_loop(NearLink(near, rate), rate, ring, host_paced=True, spin_ns=spin_ns):
        time.sleep(SECONDS)
    return ring.rows["lateness"][: ring.get(control_words.HEAD)].copy()


@pytest.mark.parametrize("load", ["idle", "loaded"])
def test_the_loop_wakes_as_cyclictest_does(near: Path, tmp_path: Path, load: str) -> None:
    cyclictest = find_cyclictest()
    if cyclictest is None:
        pytest.skip("cyclictest is not installed (package rt-tests)")
    rows, ratios = [], []
    for rate in RATES:
        contestants: dict[str, Callable[[], np.ndarray]] = {
            "cyclictest": lambda rate=rate: cyclictest_latency(cyclictest, rate, SECONDS, tmp_path),
            "rig": lambda rate=rate: loop_lateness(near, rate, 0),
            SPINNING: lambda rate=rate: loop_lateness(near, rate, SPIN_NS),
            "plain Python": lambda rate=rate: python_lateness(rate, SECONDS),
        }
        found: dict[str, list[tuple[float, ...]]] = {name: [] for name in contestants}
        with processor_hogs(len(CPUS) if load == "loaded" else 0):
            for number in range(ROUNDS):
                names = list(contestants)
                for k in range(len(names)):
                    name = names[(number + k) % len(names)]
                    late = contestants[name]()
                    found[name].append(quantiles(late // 1000))
        for name, rounds in found.items():
            *middle, _ = medians(rounds)
            pairs = zip(rounds, found["cyclictest"], strict=True)
            ratio = statistics.median(mine[1] / max(other[1], 1.0) for mine, other in pairs)
            if name == "rig":
                ratios.append(ratio)
            greatest = max(one[3] for one in rounds)
            over = "" if name == "cyclictest" else f"{ratio:.2f}"
            rows.append([f"{rate / 1000:g} kHz {name}", *(f"{us:.0f}" for us in (*middle, greatest)), over])
    head = ["wake-up latency", "p50 µs", "p99", "p99.9", "max of all", "p99 / cyclictest"]
    title = f"{load}, SCHED_FIFO {PRIORITY} on processor {LOOP_CPU}, medians of {ROUNDS} × {SECONDS:g} s"
    print_table(title, head, rows)
    print(f"  p99 of the loop over cyclictest's: {', '.join(f'{r:.2f}' for r in ratios)} (goal {GOAL})")
    assert statistics.median(ratios) < MOST
