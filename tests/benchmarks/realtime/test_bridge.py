"""Measure the delay that a bridge adds to a drive's round trip, and the periods that it misses.

A simulated drive of negligible cost is behind a pseudo-terminal. A C program and the bridge send it the same bytes once
a period, in turn; the ratio of their medians is asserted. Lost replies and missed periods are only printed, because any
other program can use the processor.
"""

import os
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from rig.extras.drives.library import Bridge, BridgeFacts
from tests.benchmarks.realtime.workbench import CPUS, FULL, compile_c, print_table, quantiles
from tests.conformance.bridged import bridged_rig, plain_drive

RATES = (1000, 2500)
SECONDS = 10.0 if FULL else 1.0
# About 1 on an Intel Xeon. On an AMD EPYC 1.1 to 1.8: these bytes take 21 to 32 µs there, a bridge 10 to 15 µs more.
MOST_RATIO = 2.0
TRIES = 5
QUESTION = "can send 9001 1100" + "1F01" + "130D" + "5050 BF"


@contextmanager
def drive(program: Path) -> Iterator[int]:
    """Start the simulated drive; yield the descriptor of the other end of its terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    process = subprocess.Popen([str(program), str(master)], pass_fds=(master,))
    os.close(master)
    try:
        yield slave
    finally:
        process.kill()
        process.wait()
        os.close(slave)


def run_client(client: Path, line: int, rate: int) -> tuple[np.ndarray, int]:
    """Return the round trips of a C program (µs) and the number of lost replies."""
    command = [str(client), str(line), str(rate), str(round(rate * SECONDS)), QUESTION]
    done = subprocess.run(command, pass_fds=(line,), capture_output=True, check=True)
    took = np.frombuffer(done.stdout, np.int64)
    return took[took >= 0] / 1e3, int(np.sum(took < 0))


def run_bridge(line: int, rate: int) -> BridgeFacts:
    """Run the bridge for the same number of periods, without a host; return its statistics."""
    bridge = Bridge(bridged_rig(), plain_drive(), checksum=False, rate=rate)
    host, other = os.openpty()
    ear, mouth = os.pipe()
    os.set_blocking(line, False)
    os.set_blocking(host, False)

    ends = {"host": host, "bus": line, "wake": ear, "host_stays": True}
    thread = threading.Thread(target=bridge.run, kwargs=ends)
    thread.start()
    time.sleep(SECONDS)
    os.write(mouth, b"x")
    thread.join()
    for descriptor in (host, other, ear, mouth):
        os.close(descriptor)
    os.set_blocking(line, True)
    return bridge.facts


@pytest.fixture
def one_processor() -> Iterator[None]:
    """Keep drive, client and bridge on one processor: threads and processes inherit the affinity of their creator.

    Waking a process on another virtual processor took 50 µs on one host, so that the ratio showed where the scheduler
    had put the two (20 to 30 µs on one processor, 80 on two, for either of them).
    """
    affinity = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {CPUS[-1]})
    yield
    os.sched_setaffinity(0, affinity)


@pytest.mark.usefixtures("one_processor")
@pytest.mark.parametrize("rate", RATES)
def test_a_bridge_costs_little_more_than_its_bytes(rate: int, tmp_path: Path) -> None:
    end, client = compile_c(tmp_path, "drive_end"), compile_c(tmp_path, "drive_client")
    rows, ratios = [], []
    with drive(end) as line:
        for _ in range(TRIES):
            took, lost = run_client(client, line, rate)
            facts = run_bridge(line, rate)
            ratios.append(facts.quantile_us(0.5) / float(np.median(took)))
            rows.append(("C client", *(f"{one:.0f}" for one in quantiles(took)), lost, ""))
            ours = [f"{facts.quantile_us(share):.0f}" for share in (0.5, 0.99, 0.999)]
            rows.append(("bridge", *ours, facts.longest_us, facts.lost, facts.skipped))
            if ratios[-1] <= MOST_RATIO:
                break
    head = ("", "p50", "p99", "p99.9", "max", "lost", "skipped")
    print_table(f"µs there and back at {rate} Hz", head, rows)
    assert min(ratios) <= MOST_RATIO
