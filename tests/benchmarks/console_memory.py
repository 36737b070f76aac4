"""Ten hours of a console that stays open, in minutes: the memory of its server and of a page in a browser.

    python tests/benchmarks/console_memory.py                        ten hours at 1 kHz in twelve minutes
    python tests/benchmarks/console_memory.py --hours 2 --minutes 2

A loop that is turned by hand leaves all rows of that time, in runs of 100 s, and a simulated hand its motions. Server
and page take them in as in real time, only faster: the server looks at the loop 240 times a second, the browser draws
as often as it can; how many frames the machine had time for is told. Eight times a minute the page collects its
garbage, and memory is read: resident pages of the server with its errands, the page's heap with its arrays, and its
nodes. Told is each by time, and by how much it grows in ten hours, once the first eighth has passed: a slope that no
single value moves (Theil and Sen), with its interval at 95 %. The last line is JSON; the exit code is 0 when the upper
end of none is beyond `MOST`.
"""

from __future__ import annotations

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
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import theilslopes

from rig.core.sample import ROW, Phase
from rig.realtime import ring as words
from rig.realtime.hand import HandMotion, SharedHand
from rig.realtime.ring import Ring

ROOT = Path(__file__).resolve().parents[2]
RATE_HZ = 1000
RUN_S = 100.0
FASTER = 4  # that the server looks at a loop, and tells how it stands
LOOK_S = 7.5
MOST = {"server": 20.0, "heap": 2.0, "nodes": 100.0}  # in ten hours: MB, MB, and their number
SERVER = f"""
from rig.console import live
from rig.cli import main
live.FRAME_S, live.STATE_S, live.SEARCH_S = (one / {FASTER} for one in (live.FRAME_S, live.STATE_S, live.SEARCH_S))
main()
"""
COUNTS = (
    "rigConsole.heard = 0; rigConsole.scope.link.addEventListener('frame', () => { rigConsole.heard++; })"
)
UNCHAINED = ("--no-sandbox", "--disable-frame-rate-limit", "--disable-gpu-vsync")


@dataclass(frozen=True)
class Look:
    """Memory at a time of the simulated day (MB; nodes are counted)."""

    hours: float
    server: float
    heap: float
    nodes: int


class Day:
    """Runs of a loop, one after the other, faster than they would be."""

    def __init__(self, speed: float, hand: SharedHand) -> None:
        self._rate, self._hand = speed * RATE_HZ, hand
        time_s = np.arange(RUN_S * RATE_HZ) / RATE_HZ
        self._rows = np.zeros(len(time_s), ROW)
        self._rows["device_time"] = (time_s * 1e9).astype("<i8")
        self._rows["tick"] = self._rows["sample_index"] = np.arange(len(time_s))
        self._rows["phase"] = int(Phase.TRIAL)
        for name, size in (
            ("position", 0.01),
            ("velocity", 0.3),
            ("penetration", 0.01),
            ("effort_applied", 0.1),
        ):
            self._rows[name] = (
                size * np.sin(40.0 * time_s) + size * np.random.default_rng(0).normal(size=len(time_s)) / 50
            )
        self._ring: Ring | None = None
        self.done = self.runs = 0
        self._place = len(time_s)
        self._began = time.monotonic()

    def go_on(self) -> None:
        """Leave the rows that are due."""
        due = int((time.monotonic() - self._began) * self._rate)
        while self.done < due:
            if self._place == len(self._rows):
                self._begin()
            count = min(due - self.done, len(self._rows) - self._place, 4000)
            self._leave(self._rows[self._place : self._place + count])
            self._place += count
            self.done += count

    def _begin(self) -> None:
        self.close()
        preset = {"name": "koul-compliant", "motion": "rotary", "limits": {"effort": 1.0, "speed": 10.0}}
        wall = {"stiffness": 60.0 + self.runs % 7, "damping": 0.2, "position": 0.0, "side": 1}
        experiment = {"rig": preset, "controller": {"position_rate": RATE_HZ}, "wall": wall}
        self._ring = Ring.allocate(1 << 15, info={"url": "sim://", "experiment": experiment}, shared=True)
        self._ring.put(words.PHASE, int(Phase.TRIAL))
        self._place, self.runs = 0, self.runs + 1

    def _leave(self, rows: np.ndarray[Any, Any]) -> None:
        assert self._ring is not None
        ring, head = self._ring, self._ring.get(words.HEAD)
        ring.rows[np.arange(head, head + len(rows)) % ring.capacity] = rows
        ring.rows["received_at"][np.arange(head, head + len(rows)) % ring.capacity] = time.monotonic_ns()
        ring.put(words.HEAD, head + len(rows))
        for row in rows[::64]:
            position = float(row["position"])
            self._hand.tell(
                HandMotion(int(row["device_time"]), position + 1e-3, position, float(row["velocity"]))
            )

    def close(self) -> None:
        """End the run."""
        if self._ring is not None:
            self._ring.put(words.LOOP_DONE, 1)
            self._ring.close()


@contextmanager
def served(place: Path) -> Iterator[tuple[int, str, Path]]:
    """A console in a process of its own: its number, URL, and hand."""
    temporary = place / "tmp"
    temporary.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary)}
    command = (sys.executable, "-P", "-c", SERVER, "console", "--json", "-o", str(place / "recordings"))
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
    """Of a process and its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(status["VmRSS"].split()[0]) / 1024 + sum(resident_mb(int(child)) for child in children)


async def watch(options: argparse.Namespace, place: Path) -> tuple[list[Look], dict[str, int]]:
    """Let the day pass, and look at the memory."""
    from playwright.async_api import async_playwright  # noqa: PLC0415

    looks: list[Look] = []
    speed = 60.0 * options.hours / options.minutes
    with served(place) as (pid, url, hand):
        async with async_playwright() as playwright:
            browser = await playwright.chromium.launch(
                executable_path=shutil.which("chromium"), args=UNCHAINED
            )
            page = await browser.new_page(viewport={"width": 1280, "height": 720})
            await page.goto(url)
            await page.locator(".scope").wait_for()
            glass = await page.context.new_cdp_session(page)
            await page.evaluate(COUNTS)
            await page.evaluate(f"rigConsole.scope.link.ask('look', {{ pid: {os.getpid()} }})")
            day = Day(speed, SharedHand.open(hand))
            due = LOOK_S
            while day.done < options.hours * 3600 * RATE_HZ:
                day.go_on()
                await asyncio.sleep(0.004)
                if day.done / RATE_HZ / speed >= due:
                    due += LOOK_S
                    looks.append(await look(glass, pid, day.done / RATE_HZ / 3600))
                    print(asdict(looks[-1]), flush=True)
            heard, drawn = await page.evaluate("[rigConsole.heard, rigConsole.scope.drawn.frames]")
            day.close()
            await browser.close()
    return looks, {"rows": day.done, "runs": day.runs, "frames": heard, "drawn": drawn}


async def look(glass: Any, pid: int, hours: float) -> Look:
    """Read both, after the page has collected its garbage."""
    await glass.send("HeapProfiler.collectGarbage")
    heap = await glass.send("Runtime.getHeapUsage")
    counted = await glass.send("Memory.getDOMCounters")
    used = heap["usedSize"] + heap.get("backingStorageSize", 0) + heap.get("embedderHeapUsedSize", 0)
    return Look(round(hours, 2), round(resident_mb(pid), 1), round(used / 2**20, 2), counted["nodes"])


def main() -> int:
    """Measure, and tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=12.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        looks, counts = asyncio.run(watch(options, Path(directory)))
    told: dict[str, Any] = {"hours": options.hours, "minutes": options.minutes, **counts}
    looks = looks[len(looks) // 8 :]
    for name in MOST:
        values, hours = ([getattr(one, which) for one in looks] for which in (name, "hours"))
        slope = theilslopes(values, hours)
        grows, *interval = (round(10.0 * one, 3) for one in (slope.slope, slope.low_slope, slope.high_slope))
        told[name] = {"median": statistics.median(values), "in_ten_hours": grows, "interval": interval}
    told["flat"] = all(told[name]["interval"][1] <= most for name, most in MOST.items())
    print(json.dumps(told))
    return 0 if told["flat"] else 1


if __name__ == "__main__":
    sys.exit(main())
