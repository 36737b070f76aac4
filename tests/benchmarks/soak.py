"""Run a hit in real time for a long time, and report losses and lateness every minute.

    python -m tests.benchmarks.soak --minutes 10                   a simulated rig behind a pseudo-terminal
    python -m tests.benchmarks.soak --busy                         beside a busy interpreter and processor
    python -m tests.benchmarks.soak --rate 4000                    on an idle machine
    python -m tests.benchmarks.soak --url serial:///dev/ttyACM0 --verified

It is one long hit, with the device's limits and all parts of `rig hit`. The last line is one JSON object; the exit code
is 0 when the loop ran to the end and the recorder lost no row.
"""

import argparse
import contextlib
import json
import math
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig import config
from rig.config import presets
from rig.core.errors import RigError
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.loop._run import COUNTERS
from rig.realtime import control_words
from rig.realtime._anonymous_memory import LINK
from rig.realtime.ring import Ring
from tests.benchmarks.realtime import workbench

PRIORITY, LOOK_S = 80, 0.5
BEFORE_THE_END_S = 0.3
MINUTE_S = 60.0
COLUMNS = (
    "minute", "ticks", "lost", "skipped", "overruns", "late", "stale", "bad", "dropped",
    "p50 µs", "p99", "p99.9", "max", "ring %", "RSS MB", "CPU %",
)  # fmt: skip


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=int, help="ticks a second (default: the preset's)")
    parser.add_argument("--url", default="sim://", help="a device (default: a simulated one)")
    parser.add_argument("--preset", default="koul-compliant", help="experiment")
    parser.add_argument("--verified", action="store_true", help="as rig hit --verified, for a real rig")
    parser.add_argument("--busy", action="store_true", help="a GIL, a garbage and a CPU hog beside it")
    parser.add_argument("--output", type=Path, help="directory of the recording, which is kept then")
    return parser.parse_args()


# What is watched --------------------------------------------------------------------------------------------


@dataclass
class Watch:
    """A monitor that reads ring and process while the loop runs, and prints a line every minute."""

    late: list[np.ndarray] = field(default_factory=list)
    # By whole µs; the last: more.
    all_late: np.ndarray = field(default_factory=lambda: np.zeros(1_000_001, np.int64))
    minutes: list[dict[str, float]] = field(default_factory=list)
    totals: dict[str, Any] = field(default_factory=dict)
    seen: int = 0
    unseen: int = 0
    fullest: int = 0
    before: dict[str, int] = field(default_factory=dict)
    started: float = field(default_factory=time.monotonic)
    cpu: float = field(default_factory=time.process_time)
    minute_at: float = field(default_factory=time.monotonic)

    def read_rows(self, ring: Any, *, last: bool = False) -> None:
        """Read the lateness of the new rows; print a line after each minute and at the end."""
        head = ring.get(control_words.HEAD)
        backlog = head - ring.get(control_words.TAIL)
        self.fullest = max(self.fullest, backlog)
        first = max(self.seen, head - ring.capacity * 9 // 10)  # older ones may be overwritten meanwhile
        self.unseen += first - self.seen
        if head > first:
            self.late.append(ring.rows["lateness"][np.arange(first, head) % ring.capacity] // 1000)
        self.seen = head
        if not last and time.monotonic() - self.minute_at < MINUTE_S:
            return
        self._minute(ring)
        if last:
            self.totals = self._summary(ring)

    def _minute(self, ring: Any) -> None:
        now, cpu = time.monotonic(), time.process_time()
        counters = {name: ring.get(word) for name, word in COUNTERS.items()}
        since = {name: value - self.before.get(name, 0) for name, value in counters.items()}
        late = np.concatenate(self.late) if self.late else np.zeros(1, np.int64)
        self.all_late += np.bincount(np.clip(late, 0, len(self.all_late) - 1), minlength=len(self.all_late))
        line = {"minute": (now - self.started) / MINUTE_S}
        line |= {name: since[name] for name in ("ticks", "lost", "skipped", "overruns", "late", "stale")}
        line |= {"bad": since["bad_frames"], "dropped": since["rows_dropped"]}
        quantiles = np.quantile(late, (0.5, 0.99, 0.999, 1.0), method="higher")
        line |= dict(zip(("p50 µs", "p99", "p99.9", "max"), map(float, quantiles), strict=True))
        line |= {"ring %": 100.0 * self.fullest / ring.capacity, "RSS MB": resident_mb()}
        line["CPU %"] = 100.0 * (cpu - self.cpu) / max(now - self.minute_at, 1e-3)
        if not self.minutes:
            print("  ".join(name.rjust(8) for name in COLUMNS))
        shown = [f"{line['minute']:.1f}", *(f"{line[name]:.0f}" for name in COLUMNS[1:])]
        print("  ".join(text.rjust(8) for text in shown))
        sys.stdout.flush()
        self.minutes.append(line)
        self.late, self.before, self.cpu, self.minute_at, self.fullest = [], counters, cpu, now, 0

    def _summary(self, ring: Any) -> dict[str, Any]:
        total = np.cumsum(self.all_late)
        places = np.searchsorted(total, np.array([0.5, 0.99, 0.999]) * total[-1])
        return {
            "minutes": round((time.monotonic() - self.started) / MINUTE_S, 3),
            **{name: ring.get(word) for name, word in COUNTERS.items()},
            **dict(zip(("late_p50_us", "late_p99_us", "late_p999_us"), map(int, places), strict=True)),
            "late_max_us": int(np.flatnonzero(self.all_late)[-1]) if total[-1] else 0,
            "rows_not_looked_at": self.unseen,
            "rss_mb": [round(line["RSS MB"], 1) for line in (self.minutes[0], self.minutes[-1])],
            "cpu_percent": round(float(np.mean([line["CPU %"] for line in self.minutes])), 1),
            "ring_fullest_percent": round(max(line["ring %"] for line in self.minutes), 1),
        }


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def device_run(options: argparse.Namespace, directory: Path, watch: Watch) -> dict[str, Any]:
    """Run one long hit on a device, simulated in real time or real."""
    changes: dict[str, Any] = {"trial.duration_s": options.minutes * MINUTE_S, "host.priority": PRIORITY}
    if options.rate is not None:
        changes |= {"controller.position_rate": options.rate, "controller.velocity_rate": options.rate}
    experiment = config.override(presets.load(options.preset), changes)
    rings: list[Any] = []
    end, looked = math.inf, 0.0

    def progress(ticks: int, phase: int) -> None:
        nonlocal end, looked
        if not rings:
            rings.append(attach_ring())
        if time.monotonic() > end:  # beside the loop, not beside what follows it
            load.close()
        elif options.busy and end == math.inf and ticks > 0:
            end = time.monotonic() + max(0.0, options.minutes * MINUTE_S - BEFORE_THE_END_S)
            load.enter_context(workbench.processor_hogs(1))
            load.enter_context(workbench.interpreter_hogs())
        if time.monotonic() > looked + LOOK_S:
            looked = time.monotonic()
            watch.read_rows(rings[0])

    def watched(repeat: int, in_effect: Any) -> Any:
        found["rate"] = in_effect.controller.position_rate
        return progress

    place = {"url": options.url, "verified": options.verified, "output": options.output or directory}
    request = HitRequest(experiment=experiment, changes=changes, realtime=True, **place)
    found: dict[str, Any] = {"end": "FINISHED"}
    with contextlib.ExitStack() as load:
        try:
            for result in hit(request, admit, watched):
                found["verdict"] = result.verdict.kind
        except RigError as error:
            found |= {"end": type(error).__name__, "error": str(error)}
    if rings:
        watch.read_rows(rings[0], last=True)
        found["rows_lost"] = watch.before["rows_dropped"]
        rings[0].close()
    return found


def attach_ring() -> Any:
    """Return the ring that the trial of this process shares with others."""
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            if os.readlink(entry) == LINK:
                return Ring.attach(str(entry))
    raise LookupError("no ring here")


def main() -> int:
    """Run, print, and return exit code 0 if nothing was lost."""
    options = arguments()
    watch = Watch()
    with tempfile.TemporaryDirectory() as name:
        found = device_run(options, Path(name), watch)
    print(json.dumps({"asked": vars(options), **found, **watch.totals}, default=str))
    return 0 if found["end"] == "FINISHED" and found.get("rows_lost") == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
