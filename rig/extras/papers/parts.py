"""Run the work of a reproduction as one sweep: many tasks, one progress bar, one journal to resume from.

A *part* is a named group of sweep tasks that do the same kind of work.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rig.experiments import sweep
from rig.experiments.sweep import Progress, Task

Part = Sequence[Task]  # of one kind; weights in hits of a 20 kHz rig


def part(work: Callable[[Any], Any], payload: Mapping[str, Any], weight: float) -> Part:
    """Return a group of tasks (part) with a single task, which calls `work(payload)`.

    `weight` is its computing cost, for the progress display.
    """
    return (Task("all", work, payload, weight),)


@dataclass(frozen=True, slots=True)
class Parts:
    """Results of all tasks by name of their group, duration (s), and number of results from an earlier, stopped run."""

    results: Mapping[str, Sequence[Any]]
    seconds: float
    kept: int

    def one(self, name: str) -> Any:
        """Return the result of the group of tasks `name`, which must have a single task."""
        (result,) = self.results[name]
        return result


def run_parts(
    parts: Mapping[str, Part],
    *,
    journal: Path | None = None,
    workers: int | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Parts:
    """Run all groups of tasks (parts) as one sweep; a stopped sweep resumes from `journal`, a file of finished results.

    `workers` is the number of processes, `watch` receives the progress. Raise `RigError` if a task fails.
    """
    started = time.monotonic()
    tasks = [replace(task, key=f"{name}:{task.key}") for name, part in parts.items() for task in part]
    kept = 0

    def watched(progress: Progress) -> None:
        nonlocal kept
        kept = progress.kept
        if watch is not None:
            watch(progress)

    results = iter(sweep.run(tasks, journal=journal, workers=workers, watch=watched))
    by_name = {name: [next(results) for _ in part] for name, part in parts.items()}
    return Parts(by_name, time.monotonic() - started, kept)
