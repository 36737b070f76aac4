"""Measure the memory of a console's server and of its page in a browser over ten simulated hours.

    python -m tests.benchmarks.console_memory                        ten hours at 1 kHz in twelve minutes
    python -m tests.benchmarks.console_memory --hours 2 --minutes 2

A simulated loop writes all rows of that time, in runs of 100 s, and a simulated hand its motions. Server and page read
them as in real time, but faster: the server polls the loop 240 times a second, and the browser draws as often as it
can; the number of drawn frames is printed. Meanwhile the views are visited: new recordings and maps are opened (the
oldest are deleted, so that lists keep their length), devices are listed, and sometimes a hit is run and judged. Eight
times a minute the page collects its garbage, and memory is measured: resident memory of the server and its errands,
heap of the page with its arrays, and nodes of the page. Each is printed over time, and as growth in ten hours after the
first eighth, a robust slope (Theil and Sen) with its 95 % interval. The last line is JSON; the exit code is 0 when no
upper end of an interval exceeds `MOST`.
"""

import argparse
import asyncio
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import theilslopes

from rig.config import presets
from rig.core.sample import ROW, Phase
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.mapping import _maps as maps
from rig.realtime import control_words
from rig.realtime.hand import HandMotion, SharedHand
from rig.realtime.ring import Ring
from tests.conformance.maps import short_map
from tests.conformance.tree import ROOT

RATE_HZ = 1000
RUN_S = 100.0
TABLE = 100_000  # rows that come again and again
FASTER = 4  # factor of the rate at which the server polls a loop and reports its state
LOOK_S = 7.5
KEPT = 20  # recordings and maps in their lists
HIT_EACH = 8  # visits
PATIENCE_MS = 120_000.0
MOST = {"server": 20.0, "heap": 2.0, "nodes": 100.0}  # in ten hours: MB, MB, and their number
SERVER = """
from rig.extras.console import live
from rig.cli import main
live.FRAME_S, live.STATE_S, live.SEARCH_S = (one / {faster} for one in (live.FRAME_S, live.STATE_S, live.SEARCH_S))
main()
"""
COUNTS = (
    "rigConsole.framesSeen = 0; "
    "rigConsole.scope.link.addEventListener('frame', () => { rigConsole.framesSeen++; })"
)
UNCHAINED = ("--disable-frame-rate-limit", "--disable-gpu-vsync")


@dataclass(frozen=True)
class Look:
    """The memory at one time of the simulated day (MB), and the number of nodes of the page."""

    hours: float
    server: float
    heap: float
    nodes: int


class Day:
    """Consecutive runs of a simulated loop, faster than real time by a factor."""

    def __init__(self, speed: float, hand: SharedHand) -> None:
        self._speed, self._hand = speed, hand
        time_s = np.arange(TABLE) / RATE_HZ
        self._rows = np.zeros(TABLE, ROW)
        self._rows["device_time"] = (time_s * 1e9).astype("<i8")
        self._rows["tick"] = self._rows["sample_index"] = np.arange(TABLE)
        self._rows["phase"] = int(Phase.TRIAL)
        sizes = {"position": 0.01, "velocity": 0.3, "penetration": 0.01, "effort_applied": 0.1}
        for name, size in sizes.items():
            noise = np.random.default_rng(0).normal(size=TABLE) / 50
            self._rows[name] = size * (np.sin(40.0 * time_s) + noise)
        self.ring: Ring | None = None
        self.done = self.runs = self._left = 0
        self._began = time.monotonic()

    def continue_run(self) -> None:
        """Write the rows that are due."""
        due = int((time.monotonic() - self._began) * self._speed * RATE_HZ)
        while self.done < due:
            if self.ring is None or self._left >= RUN_S * RATE_HZ:
                self.begin()
            passed, place = divmod(self._left, TABLE)
            count = min(due - self.done, TABLE - place, 4000)
            self._leave(self._rows[place : place + count].copy(), passed)
            self._left += count
            self.done += count

    def begin(self) -> None:
        """Begin a new run."""
        self.close()
        preset = {"name": "koul-compliant", "motion": "rotary", "limits": {"effort": 1.0, "speed": 10.0}}
        wall = {"stiffness": 60.0 + self.runs % 7, "damping": 0.2, "position": 0.0, "side": 1}
        experiment = {"rig": preset, "controller": {"position_rate": RATE_HZ}, "wall": wall}
        self.ring = Ring.allocate(1 << 15, info={"url": "sim://", "experiment": experiment}, shared=True)
        self.ring.put(control_words.PHASE, int(Phase.TRIAL))
        self._left, self.runs = 0, self.runs + 1

    def _leave(self, rows: np.ndarray[Any, Any], passed: int) -> None:
        assert self.ring is not None
        ring, head = self.ring, self.ring.get(control_words.HEAD)
        rows["device_time"] += passed * TABLE * 1_000_000_000 // RATE_HZ
        rows["received_at"] = time.monotonic_ns()
        ring.rows[np.arange(head, head + len(rows)) % ring.capacity] = rows
        ring.put(control_words.HEAD, head + len(rows))
        for row in rows[::64]:
            position = float(row["position"])
            self._hand.tell(
                HandMotion(int(row["device_time"]), position + 1e-3, position, float(row["velocity"]))
            )

    def close(self) -> None:
        """End the run."""
        if self.ring is not None:
            self.ring.put(control_words.LOOP_DONE, 1)
            self.ring.close()
            self.ring = None


class Visits:
    """A simulated user who opens the views of the page, after new files were added."""

    def __init__(self, page: Any, place: Path) -> None:
        self._page, self._recordings, self._maps = page, place / "recordings", place / "maps"
        self.made = self.hits = 0
        request = HitRequest(experiment=presets.load("koul-compliant"), output=self._recordings, name="hit-0")
        list(hit(request, admit))
        maps.map_into(short_map(0.1, 0.6), self._maps / "map-0")
        while self.made < KEPT:
            self._make()

    def _make(self) -> None:
        """Add one recording and one map, and delete the oldest; the first of each is never deleted."""
        self.made += 1
        for place, name, ending in ((self._recordings, "hit", ".parquet"), (self._maps, "map", "")):
            old = place / f"{name}-{max(1, self.made - KEPT)}{ending}"
            if self.made > KEPT:
                shutil.rmtree(old) if old.is_dir() else old.unlink()
            copy = shutil.copyfile if ending else shutil.copytree
            copy(place / f"{name}-0{ending}", place / f"{name}-{self.made}{ending}")

    async def go_through(self) -> None:
        """Open all views, then return to the scope."""
        page = self._page
        self._make()
        await self._show("Recordings")
        await page.get_by_role("searchbox").fill(f"hit-{self.made}")
        await page.get_by_role("button", name=f"hit-{self.made}", exact=True).click()
        await page.get_by_role("heading", name=f"hit-{self.made}.parquet").wait_for()
        await page.locator("section[aria-label=Recording] .u-wrap").nth(2).wait_for()
        await self._show("Maps")
        await page.get_by_role("button", name=f"map-{self.made}", exact=True).click()
        await page.get_by_text("finished: 4 of 4 columns").wait_for()
        await self._show("Devices")
        await self._show("Live")
        if self.made % HIT_EACH == 0:
            self.hits += 1
            await page.get_by_role("button", name="Automatic hit").click()
            await page.locator(".side [data-kind]:visible").first.wait_for()
            await page.locator("button.first:enabled").first.wait_for()

    async def _show(self, view: str) -> None:
        await self._page.get_by_role("button", name=view, exact=True).click()


@contextmanager
def served(place: Path) -> Iterator[tuple[int, str, Path]]:
    """Serve a console in a separate process with a faster polling rate; yield its process number, URL and hand."""
    temporary = place / "tmp"
    temporary.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary)}
    code = SERVER.format(faster=FASTER)
    command = (sys.executable, "-P", "-c", code, "console", "--json", "-o", str(place / "recordings"))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=place, env=environment) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["url"]
            (hand,) = temporary.glob("rig-console-*/hand")
            yield process.pid, url, hand
        finally:
            process.terminate()
            process.wait(30.0)


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process and its children (MB)."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(status["VmRSS"].split()[0]) / 1024 + sum(resident_mb(int(child)) for child in children)


@asynccontextmanager
async def open_console_page(url: str, *arguments: str) -> AsyncIterator[Any]:
    """Open the page of a console in a browser."""
    from playwright.async_api import async_playwright  # noqa: PLC0415

    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", *arguments]
        )
        page = await browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(PATIENCE_MS)
        await page.goto(url)
        await page.locator(".scope").wait_for()
        yield page
        await browser.close()


async def simulate_day(options: argparse.Namespace, place: Path) -> tuple[list[Look], dict[str, int]]:
    """Simulate the day and measure the memory regularly."""
    looks: list[Look] = []
    speed = 60.0 * options.hours / options.minutes
    with served(place) as (pid, url, hand):
        async with open_console_page(url, *UNCHAINED) as page:
            visits = Visits(page, place)
            glass = await page.context.new_cdp_session(page)
            await page.evaluate(COUNTS)
            await page.evaluate(f"rigConsole.scope.link.ask('look', {{ pid: {os.getpid()} }})")
            day = Day(speed, SharedHand.open(hand))
            due, visit = LOOK_S, None
            while day.done < options.hours * 3600 * RATE_HZ:
                day.continue_run()
                await asyncio.sleep(0.004)
                if day.done / RATE_HZ / speed >= due and (visit is None or visit.done()):
                    due += LOOK_S
                    if visit is not None:
                        visit.result()
                    looks.append(await measure_memory(glass, pid, day.done / RATE_HZ / 3600))
                    print(asdict(looks[-1]), flush=True)
                    visit = asyncio.create_task(visits.go_through())
            if visit is not None:
                await visit
            frames, drawn = await page.evaluate("[rigConsole.framesSeen, rigConsole.scope.drawn.frames]")
            day.close()
    counts = {"rows": day.done, "runs": day.runs, "frames": frames, "drawn": drawn}
    return looks, {**counts, "visits": visits.made - KEPT, "hits": visits.hits}


async def measure_memory(glass: Any, pid: int, hours: float) -> Look:
    """Measure the memory of server and page, after the page has collected its garbage."""
    await glass.send("HeapProfiler.collectGarbage")
    heap = await glass.send("Runtime.getHeapUsage")
    counted = await glass.send("Memory.getDOMCounters")
    used = heap["usedSize"] + heap.get("backingStorageSize", 0) + heap.get("embedderHeapUsedSize", 0)
    return Look(round(hours, 2), round(resident_mb(pid), 1), round(used / 2**20, 2), counted["nodes"])


def main() -> int:
    """Run the measurement and print it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=12.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        looks, counts = asyncio.run(simulate_day(options, Path(directory)))
    summary: dict[str, Any] = {"hours": options.hours, "minutes": options.minutes, **counts}
    looks = looks[len(looks) // 8 :]
    for name in MOST:
        values, hours = ([getattr(one, which) for one in looks] for which in (name, "hours"))
        slope = theilslopes(values, hours)
        grows, *interval = (round(10.0 * one, 3) for one in (slope.slope, slope.low_slope, slope.high_slope))
        summary[name] = {"median": statistics.median(values), "in_ten_hours": grows, "interval": interval}
    summary["flat"] = all(summary[name]["interval"][1] <= most for name, most in MOST.items())
    print(json.dumps(summary))
    return 0 if summary["flat"] else 1


if __name__ == "__main__":
    sys.exit(main())
