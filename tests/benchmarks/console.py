"""Measure how much a console delays a real-time loop; `console_flood.py` measures how long STOP takes through it.

    python -m tests.benchmarks.console                       10 pairs of hits each: a device at 10 kHz, a host at 4
    python -m tests.benchmarks.console --minutes 30          as many pairs as half an hour permits

Each pair is one hit with a console and four pages, one of which reads nothing, and one hit without; every second pair
runs in reverse order, so that a changing load of the machine has no effect. Printed are rows that the console missed,
rows and samples that the loop lost, and the 99.9th percentile of the ticks' lateness: the median difference of the
pairs with its 95 % bootstrap interval, the usual difference between consecutive hits without a console, and the number
of pairs that would detect a tenth of the value without a console. An interval that contains zero shows no cost, but
excludes none below its upper end. The last line is JSON. The pages are not browsers.
"""

import argparse
import asyncio
import json
import math
import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager, nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

LOOPS: dict[str, dict[str, Any]] = {
    "device, 10 kHz": {
        "controller.loop": "device", "controller.position_rate": 10_000, "controller.velocity_rate": 1000,
    },
    "host, 4 kHz": {"controller.position_rate": 4000, "controller.velocity_rate": 1000},
}  # fmt: skip
PAGES = 4
DRAWS = 10_000
FEWEST = 6  # pairs: of fewer no interval of a median has 95 % (1 - 2 · 0.5^n)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--minutes", type=float, help="in place of --pairs, for both loops together")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each hit")
    return parser.parse_args()


def serve_console(line: Any, place: str, pid: int) -> None:
    """Serve a console and its pages in a separate process, on request; return the rows that it missed."""
    from tests.conformance.console import served  # noqa: PLC0415

    async def once() -> None:
        async with AsyncExitStack() as stack:
            console = await stack.enter_async_context(served(Path(place)))
            pages = [
                await stack.enter_async_context(console.page(f"page-number-{i}")) for i in range(PAGES - 1)
            ]
            await stack.enter_async_context(console.socket(client="a-stalled-page"))
            await pages[0].ask("look", pid=pid)
            line.send("ready")
            while not line.poll():
                await asyncio.sleep(0.05)
            line.recv()
            loop = (pages[0].newest("state") or {}).get("loop") or {}
            line.send({"unseen": loop.get("unseen"), "frames": min(len(page.frames) for page in pages)})

    while line.recv() == "look":
        asyncio.run(once())


@contextmanager
def pages_beside(line: Any, found: dict[str, Any]) -> Iterator[None]:
    """Run a console and its pages during the block; afterwards `found` contains what they received."""
    line.send("look")
    line.recv()
    yield
    line.send("end")
    found |= line.recv()


def hit(changes: dict[str, Any], seconds: float, place: Path) -> dict[str, float]:
    """Run one hit in real time; return its losses and the lateness of its ticks (µs, 99.9th percentile)."""
    from rig.config import presets  # noqa: PLC0415
    from rig.experiments.hits.admission import admit  # noqa: PLC0415
    from rig.experiments.hits.hit import HitRequest  # noqa: PLC0415
    from rig.experiments.hits.hit import hit as run  # noqa: PLC0415

    wanted = {"trial.duration_s": seconds, "wall.stiffness": 10.0, "wall.damping": 0.02, **changes}
    request = HitRequest(experiment=presets.load("koul-rigid"), realtime=True, changes=wanted, output=place)
    (result,) = run(request, admit)
    rows = result.recording.rows
    result.path.unlink()
    lost = sum(result.counters[name] for name in ("lost", "skipped", "dropped") if name in result.counters)
    return {"lost": lost, "late_us": float(np.percentile(rows["lateness"], 99.9)) * 1e-3, "rows": len(rows)}


def run_pair(
    changes: dict[str, Any], seconds: float, place: Path, line: Any, *, console_first: bool
) -> dict[str, Any]:
    """Run one hit with a console and one without."""
    results: dict[str, Any] = {}
    for beside in (console_first, not console_first):
        with pages_beside(line, results) if beside else nullcontext():
            results["with" if beside else "without"] = hit(changes, seconds, place)
    return results


def run_pairs(changes: dict[str, Any], options: argparse.Namespace, place: Path) -> list[dict[str, Any]]:
    """Run the requested number of pairs, or as many as the time permits."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve_console, args=(there, str(place), os.getpid()), daemon=True)
    process.start()
    hit(changes, 0.5, place)  # compiles
    found: list[dict[str, Any]] = []
    until = time.monotonic() + 60.0 * (options.minutes or 0.0) / len(LOOPS)
    while len(found) < options.pairs if options.minutes is None else time.monotonic() < until:
        found.append(run_pair(changes, options.seconds, place, here, console_first=len(found) % 2 == 1))
    here.send("done")
    process.join()
    return found


def median_interval(values: list[float]) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a median."""
    drawn = np.random.default_rng(0).choice(values, (DRAWS, len(values)))
    low, high = np.percentile(np.median(drawn, axis=1), (2.5, 97.5))
    return float(low), float(high)


def summarise(pairs: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the pairs: losses, lateness, and the effect that this number of pairs can detect."""
    without = [one["without"]["late_us"] for one in pairs]
    differences = [one["with"]["late_us"] - one["without"]["late_us"] for one in pairs]
    low, high = median_interval(differences)
    usual = statistics.median(without)
    between = [abs(one - next_one) for one, next_one in pairwise(without)]
    return {
        "pairs": len(pairs),
        "rows": sum(one["with"]["rows"] for one in pairs),
        "unseen": sum(one["unseen"] or 0 for one in pairs),
        "lost_with": sum(one["with"]["lost"] for one in pairs),
        "lost_without": sum(one["without"]["lost"] for one in pairs),
        "late_us_without": usual,
        "between_hits_us": statistics.median(between) if between else None,
        "difference_us": statistics.median(differences),
        "interval_us": (low, high),
        "shows_a_cost": low > 0.0 if len(pairs) >= FEWEST else None,
        "pairs_for_a_tenth": math.ceil(len(pairs) * (0.5 * (high - low) / (0.1 * usual)) ** 2),
        "frames": min(one["frames"] for one in pairs),
    }


def main() -> int:
    """Run the measurement and print it."""
    options = arguments()
    results: dict[str, Any] = {"pages": PAGES, "load": os.getloadavg()[0]}
    with tempfile.TemporaryDirectory() as directory:
        place = Path(directory)
        for name, changes in LOOPS.items():
            results[name] = found = summarise(run_pairs(changes, options, place))
            low, high = found["interval_us"]
            cost = (
                "shows a cost"
                if found["shows_a_cost"]
                else "shows no cost, and excludes none below its upper end"
            )
            print(
                f"{name}: p99.9 of the lateness {found['late_us_without']:.0f} µs without a console; "
                f"with it {low:+.0f} to {high:+.0f} µs, which {cost}. {found}",
                flush=True,
            )
    print(json.dumps(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
