"""Measure in a real browser the delay from a row in the ring to its pixels, and from the STOP key to the stop word.

    python -m tests.benchmarks.console_page                    half a minute at 20 kHz, 40 stops
    python -m tests.benchmarks.console_page --seconds 120

A simulated loop writes 20,000 rows a second in real time; the page draws the default scope of two seconds. The age of
a row is measured when the page has drawn the frame that contains it, for the newest row, the oldest row and eight
between them (ms, the resolution of the browser's clock). The delay of the compositor and the screen is not included.
STOP is the Escape key: its delay is from the browser's time stamp of the key to the stop word in another process. The
last line is JSON; the exit code is 0 when median and 99th percentile of the ages and the median of STOP are within
`MARKS`, which are for an otherwise idle machine.
"""

import argparse
import asyncio
import json
import math
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from rig.realtime import control_words
from rig.realtime.hand import SharedHand
from tests.benchmarks.console_memory import Day, open_console_page, served

RATE_HZ = 20_000
STOPS = 40
SETTLE_S = 0.3  # a page sends STOP on both of its sockets; the second must not stop the next loop
MARKS = {"row_to_pixel_ms": 50.0, "row_to_pixel_p99_ms": 120.0, "stop_ms": 20.0}
LISTENS = """
rigConsole.ages = [];
rigConsole.waiting = [];
rigConsole.scope.link.addEventListener("frame", ({ detail: { newest } }) => {
  if (rigConsole.last) rigConsole.waiting.push([rigConsole.last, newest]);
  rigConsole.last = newest;
});
const drawn = () => {
  requestAnimationFrame(drawn);
  const now = Date.now();
  for (const [oldest, newest] of rigConsole.waiting.splice(0)) rigConsole.ages.push([now - newest, now - oldest]);
};
requestAnimationFrame(drawn);
// The origin of event times is as old as the page, and drifts from the clock of others.
const press = ({ timeStamp }) => { rigConsole.pressed = Date.now() - performance.now() + timeStamp; };
addEventListener("keydown", press, true);
"""


async def write_rows(day: Any, seconds: float) -> None:
    """Write the rows of a simulated loop for some seconds."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        day.continue_run()
        await asyncio.sleep(0.002)


async def measure_stop(page: Any, day: Any) -> float:
    """Press Escape while a loop runs; return the time until the loop received STOP (ms)."""
    await write_rows(day, SETTLE_S)
    ring = day.begin()
    await page.evaluate(f"rigConsole.scope.link.ask('look', {{ pid: {os.getpid()} }})")
    await write_rows(day, SETTLE_S)
    assert ring.get(control_words.STOP) == 0
    pressed = asyncio.create_task(page.keyboard.press("Escape"))
    while ring.get(control_words.STOP) == 0:
        await asyncio.sleep(0)
    reached_ms = time.time() * 1e3
    await pressed
    return float(reached_ms - await page.evaluate("rigConsole.pressed"))


async def measure_delays(seconds: float, place: Path) -> tuple[list[float], list[float], int]:
    """Return the ages of rows (ms), the times of STOP (ms) and the number of frames."""
    with served(place, faster=1) as (_, url, hand):
        async with open_console_page(url) as page:
            day = Day(1.0, SharedHand.open(hand), RATE_HZ, run_s=math.inf)
            day.begin()
            await page.evaluate(f"rigConsole.scope.link.ask('look', {{ pid: {os.getpid()} }})")
            await write_rows(day, 3.0)
            await page.evaluate(LISTENS)
            await write_rows(day, seconds)
            frames = await page.evaluate("rigConsole.ages")
            stops = [await measure_stop(page, day) for _ in range(STOPS)]
            day.close()
    return [age for newest, oldest in frames for age in np.linspace(newest, oldest, 10)], stops, len(frames)


def main() -> int:
    """Run the measurement and print it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        ages, stops, frames = asyncio.run(measure_delays(options.seconds, Path(directory)))
    summary = {
        "row_to_pixel_ms": float(np.median(ages)),
        "row_to_pixel_p99_ms": float(np.percentile(ages, 99)),
        "stop_ms": float(np.median(stops)),
        "stop_longest_ms": max(stops),
        "frames_a_second": frames / options.seconds,
        "load": os.getloadavg()[0],
    }
    within = all(summary[name] <= most for name, most in MARKS.items())
    print(json.dumps({**summary, "within": within}))
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main())
