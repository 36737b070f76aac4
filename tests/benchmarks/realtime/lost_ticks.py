"""Measure how many ticks a bridge loses, by rate: ``python -m tests.benchmarks.realtime.lost_ticks --seconds 10``.

A simulated drive of negligible cost is behind a pseudo-terminal; a C program and the bridge send it requests in turn,
with a board's real-time scheduling where permitted. A tick is lost when no reply arrives within its period (a reply
after three periods is three lost ticks), or when the sender woke up too late. Losses of the C program are due to the
computer: the kernel passes a terminal's bytes by an ordinary worker thread, which any program can delay. Therefore the
load is printed with the result, which is meant for an idle machine.
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from tests.benchmarks.realtime.test_bridge import AS_A_BOARD, drive, run_bridge, run_client
from tests.benchmarks.realtime.workbench import compile_c, may_be_realtime, print_table

RATES = "500,1000,1500,2000,2500"
IDLE_LOAD = 0.3  # running programs above which a machine is not idle


def cpu_pressure() -> str:
    """Return the share of the last ten seconds in which a program waited for a processor (%); "?" if unknown."""
    try:
        some = Path("/proc/pressure/cpu").read_text().split()
    except OSError:
        return "?"
    return some[1].partition("=")[2]


def measure(rates: list[int], seconds: float, *, as_a_board: bool) -> list[tuple[object, ...]]:
    """Return the rows of the table."""
    rows: list[tuple[object, ...]] = []
    before = AS_A_BOARD if as_a_board else ()
    with tempfile.TemporaryDirectory() as place:
        end, client = (compile_c(Path(place), name) for name in ("drive_end", "drive_client"))
        with drive(end, before) as line:
            for rate in rates:
                took, never = run_client(client, line, rate, seconds, before)
                lost = never + int(np.sum(took * rate // 1_000_000))
                rows.append(("C client", rate, lost, "", round(took.max()), cpu_pressure()))
                facts = run_bridge(line, rate, seconds, as_a_board=as_a_board)
                rows.append(("bridge", rate, facts.lost, facts.skipped, facts.longest_us, cpu_pressure()))
    return rows


def main() -> None:
    """Run the measurements and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--rates", default=RATES, help="Hz")
    chosen = parser.parse_args()
    load, allowed = os.getloadavg()[0], may_be_realtime()
    rates = [int(rate) for rate in chosen.rates.split(",")]
    rows = measure(rates, chosen.seconds, as_a_board=allowed)
    columns = ("", "Hz", "lost", "slept through", "longest µs", "others waited %")
    print_table(
        f"ticks lost in {chosen.seconds:g} s" + ("" if allowed else ", scheduled as any program"),
        columns,
        rows,
    )
    busy = " — not idle: this measures the others, too" if load > IDLE_LOAD else ""
    print(f"load before: {load:.2f}{busy}")


if __name__ == "__main__":
    main()
