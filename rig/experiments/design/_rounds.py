"""Find the stable walls of many sampling schemes in one parallel run; each result equals that of a single `MapPlan`.

`_search`, `_margin` and `_whole` call this module.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.experiments import sweep
from rig.experiments.mapping._maps import Map, Plan
from rig.experiments.mapping._searches import StiffnessSearch
from rig.experiments.mapping.zwidth import MapPlan, ZWidth
from rig.experiments.trials.results import make_directory

M = TypeVar("M", bound=Map)
Watch = Callable[[str, sweep.Progress], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class WallGrid:
    """Walls to test by hits: dampings, search over stiffness, encoder offsets (counts), and repeats of each search."""

    dampings: tuple[float, ...]
    search: StiffnessSearch
    offsets: tuple[float, ...]
    repeats: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweeper:
    """Runs the stages of a design in parallel, each with its own journal, so that a stopped design can resume.

    Attributes
    ----------
    directory
        Directory of the journals (files of finished results); None: nothing is stored.
    scheduler, workers
        Address of a Dask scheduler, or number of threads; None: a thread for each core.
    watch
        Called with the name of the stage and its progress.
    hits
        Number of hits in each finished stage, by the stage's name.
    """

    directory: Path | None = None
    scheduler: str | None = None
    workers: int | None = None
    watch: Watch | None = None
    hits: dict[str, int] = field(default_factory=dict)

    def run(self, stage: str, tasks: Sequence[sweep.Task], unit: str | None = None) -> sweep.Results:
        """Run the function calls `tasks` of a stage in parallel; return their results, stored ones included."""
        journal = None
        if self.directory is not None:
            make_directory(self.directory)
            journal = self.directory / f"{stage.replace(' ', '-')}.journal"
        watch = self.watch
        return sweep.run(
            tasks,
            journal=journal,
            scheduler=self.scheduler,
            workers=self.workers,
            unit=unit,
            watch=None if watch is None else lambda progress: watch(stage, progress),
        )

    def map_each(self, stage: str, work: Sequence[tuple[Experiment, Scheme, WallGrid]]) -> list[ZWidth]:
        """Find by simulated hits the stable walls of each experiment with its sampling scheme, in given order."""
        plans = [
            MapPlan(
                experiment=experiment,
                schemes=(scheme,),
                dampings=grid.dampings,
                search=grid.search,
                offsets=grid.offsets,
                repeats=grid.repeats,
                # A design uses only the criterion *any* of the three ripples: the separate limits of *felt* and *heard*
                # would need most of the hits.
                criteria=("any",),
            )
            for experiment, scheme, grid in work
        ]
        maps = self.each(stage, plans)
        self.hits[stage] = sum(found.hits for found in maps)
        return maps

    def each(self, stage: str, plans: Sequence[Plan[M]]) -> list[M]:
        """Compute several maps of walls in one parallel run, and return the map of each plan."""
        of_plan = [
            [replace(task, key=f"{number}/{task.key}") for task in plan.tasks]
            for number, plan in enumerate(plans)
        ]
        if not plans:
            return []
        tasks = [task for some in of_plan for task in some]
        done: Sequence[Any] = self.run(stage, tasks, plans[0].unit)
        found, first = [], 0
        for plan, some in zip(plans, of_plan, strict=True):
            found.append(plan.found(done[first : first + len(some)]))
            first += len(some)
        return found


def columns_to(reach: float, columns: int) -> tuple[float, ...]:
    """Return as many dampings as `columns` from 0 to `reach` (N·m·s/rad or N·s/m), denser near zero."""
    # Squared: denser near zero, where the curve of stiffness limits has its largest curvature.
    return tuple((reach * np.linspace(0.0, 1.0, columns) ** 2).tolist())
