"""What a console costs a loop, and how long STOP takes through it: nothing that a loop would notice, and a blink.

    python tests/benchmarks/console.py                       10 pairs of hits each: a device at 10 kHz, a host at 4
    python tests/benchmarks/console.py --pairs 40 --seconds 10

Each pair is one hit with a console that four pages look through, one of which reads nothing, and one hit without, in
turn. Told: rows that the console did not see, rows and samples that the loop lost, and the 99.9th percentile of the
ticks' lateness, as the median difference of the pairs with its interval (order statistics, 95 %). Then STOP, fifty
times: from the page's word to the loop's stop word, through a console that shows a loop at 10 kHz. The last line is
JSON. No browser is among the pages: what pixels take is tests/browser's.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))  # for tests.*

LOOPS = {
    "device, 10 kHz": {
        "controller.loop": "device", "controller.position_rate": 10_000, "controller.velocity_rate": 1000,
    },
    "host, 4 kHz": {"controller.position_rate": 4000, "controller.velocity_rate": 1000},
}  # fmt: skip
PAGES = 4
STOPS = 50


def arguments() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=4.0, help="of each hit")
    return parser.parse_args()


def look(ready: Any, place: str, pid: int) -> None:
    """A console and its pages, in a process of their own, until the pipe closes; tells the rows that went unseen."""
    from tests.conformance.console import served  # noqa: PLC0415

    async def whole() -> None:
        async with AsyncExitStack() as stack:
            console = await stack.enter_async_context(served(Path(place)))
            pages = [
                await stack.enter_async_context(console.page(f"page-number-{i}")) for i in range(PAGES - 1)
            ]
            stalled = await stack.enter_async_context(console.socket())
            await stalled.send(json.dumps({"token": console.token, "client": "a-stalled-page"}))
            await pages[0].ask("look", pid=pid)
            ready.send("ready")
            while not ready.poll():
                await asyncio.sleep(0.05)
            loop = (pages[0].newest("state") or {}).get("loop") or {}
            ready.send({"unseen": loop.get("unseen"), "frames": min(len(page.frames) for page in pages)})

    asyncio.run(whole())


def hit(changes: dict[str, Any], seconds: float, place: Path) -> dict[str, float]:
    """One hit in real time: what it lost, and how late its ticks were (µs, 99.9th percentile)."""
    import numpy as np  # noqa: PLC0415

    from rig.config import presets  # noqa: PLC0415
    from rig.experiments.hit import HitRequest  # noqa: PLC0415
    from rig.experiments.hit import hit as run  # noqa: PLC0415

    wanted = {"trial.duration_s": seconds, "wall.stiffness": 10.0, "wall.damping": 0.02, **changes}
    request = HitRequest(experiment=presets.load("koul-rigid"), realtime=True, changes=wanted, output=place)
    (result,) = run(request)
    rows = result.recording.rows
    result.path.unlink()
    lost = sum(result.counters[name] for name in ("lost", "skipped", "dropped") if name in result.counters)
    return {"lost": lost, "late_us": float(np.percentile(rows["lateness"], 99.9)) * 1e-3, "rows": len(rows)}


def pair(changes: dict[str, Any], seconds: float, place: Path) -> dict[str, Any]:
    """One hit without a console, one with."""
    without = hit(changes, seconds, place)
    here, there = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=look, args=(there, str(place), os.getpid()))
    process.start()
    here.recv()
    beside = hit(changes, seconds, place)
    here.send("end")
    told = here.recv()
    process.join()
    return {"without": without, "with": beside, **told}


def interval(values: list[float]) -> tuple[float, float]:
    """Of the median, by order statistics at 95 % or as near as so few values allow."""
    from scipy.stats import binom  # noqa: PLC0415

    ordered, count = sorted(values), len(values)
    low = max(0, int(binom.ppf(0.025, count, 0.5)) - 1)
    return ordered[low], ordered[count - 1 - low]


async def stops(place: Path) -> list[float]:
    """Times from the word of a page to the stop word of a loop that leaves 10,000 rows a second (ms)."""
    from rig.realtime import ring as words  # noqa: PLC0415
    from tests.conformance.console import served  # noqa: PLC0415
    from tests.conformance.lsl_loop import HandTurnedLoop  # noqa: PLC0415

    took = []
    async with served(place) as console, console.hold() as hold, console.page() as page:
        for _ in range(STOPS):
            loop = HandTurnedLoop(1 << 14, shared=True)
            with loop.ring as ring:
                await page.ask("look", pid=os.getpid())
                loop.leave(100)
                await asyncio.sleep(0.05)
                began = time.perf_counter()
                await hold.send('{"stop":true}')
                while ring.get(words.STOP) == 0:
                    await asyncio.sleep(0)
                took.append(1e3 * (time.perf_counter() - began))
                ring.put(words.LOOP_DONE, 1)
    return took


def main() -> int:
    """Measure, and tell."""
    options = arguments()
    told: dict[str, Any] = {"pages": PAGES, "pairs": options.pairs}
    with tempfile.TemporaryDirectory() as directory:
        place = Path(directory)
        for name, changes in LOOPS.items():
            hit(changes, 0.5, place)  # compiles
            pairs = [pair(changes, options.seconds, place) for _ in range(options.pairs)]
            differences = [one["with"]["late_us"] - one["without"]["late_us"] for one in pairs]
            told[name] = {
                "rows": sum(one["with"]["rows"] for one in pairs),
                "unseen": sum(one["unseen"] or 0 for one in pairs),
                "lost_with": sum(one["with"]["lost"] for one in pairs),
                "lost_without": sum(one["without"]["lost"] for one in pairs),
                "late_us_without": statistics.median(one["without"]["late_us"] for one in pairs),
                "difference_us": statistics.median(differences),
                "interval_us": interval(differences),
                "frames": min(one["frames"] for one in pairs),
            }
            print(f"{name}: {told[name]}", flush=True)
        took = sorted(asyncio.run(stops(place)))
    told["stop_ms"] = {
        "median": statistics.median(took),
        "p90": took[int(0.9 * len(took))],
        "longest": took[-1],
    }
    print(json.dumps(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
