"""A map of walls: a plan's tasks run as one sweep, and everything kept in one directory for one plan.

``journal`` holds the finished tasks while the map grows, so that the same command resumes what was stopped;
``hits.parquet`` or ``walls.parquet`` every trial with its units; ``map.json`` the plan and what came out of it. A map
of a device has its recordings in ``hits``. The plan is one of hits (`rig.experiments.zwidth`) or of impedances
(`rig.experiments.zwidth_frequency`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from rig.config import Experiment
from rig.core.present import plain
from rig.experiments import sweep
from rig.experiments.results import make_directory, write_document, write_table
from rig.experiments.table_one import table_one
from rig.experiments.zwidth import MapPlan, ZWidth
from rig.experiments.zwidth_frequency import FrequencyMap
from rig.experiments.zwidth_rig import Session, zwidth_on_rig

JOURNAL, SUMMARY, RECORDINGS = "journal", "map.json", "hits"


class Map(Protocol):
    """A finished map."""

    table_name: ClassVar[str]

    def table(self) -> Iterator[dict[str, Any]]:
        """Every trial as a flat row."""
        ...

    def units(self) -> Mapping[str, str]:
        """Unit of each column that has one."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON, without the single trials."""
        ...


M = TypeVar("M", bound=Map)
M_co = TypeVar("M_co", bound=Map, covariant=True)


class Plan(Protocol[M_co]):
    """What to map: tasks of one kind of work, and what their results are."""

    work: ClassVar[str]
    unit: ClassVar[str]  # number in each row of a result that the progress counts

    @property
    def experiment(self) -> Experiment:
        """Its rig gives the directory its name."""
        ...

    def tasks(self) -> list[sweep.Task]:
        """The independent parts."""
        ...

    def check(self) -> None:
        """Raise `PlanError` for what must not run."""
        ...

    def found(self, results: Sequence[Any]) -> M_co:
        """The map that the results of all tasks make."""
        ...


def zwidth(
    plan: Plan[M],
    *,
    journal: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> M:
    """Map a simulated rig without bytes.

    Parameters
    ----------
    plan
        What to map: `rig.experiments.zwidth.MapPlan` or `rig.experiments.zwidth_frequency.FrequencyPlan`.
    journal
        File that keeps finished tasks; a run of the same plan resumes from it.
    scheduler, workers, watch
        As in `rig.experiments.sweep.run`.

    Raises
    ------
    ConfigError
        A scheme that cannot run on this rig, or a journal of another plan.
    PlanError
        An excitation that is too large: nothing was run.
    StoppedError
        Ctrl-C; what is done stays in the journal.
    """
    plan.check()
    results = sweep.run(
        plan.work,
        plan.tasks(),
        journal=None if journal is None else Path(journal),
        scheduler=scheduler,
        workers=workers,
        unit=plan.unit,
        watch=watch,
    )
    return plan.found(results)


def directory_for(plan: Plan[Map], where: Path, name: str, device: str = "") -> Path:
    """Directory of a plan: its name carries a digest of everything that decides the results, this package included.

    `device` names what is mapped, if not the simulation (`rig.experiments.zwidth_rig.work_of`).
    """
    described = [sweep.code_version(), device, [[task.key, task.payload] for task in plan.tasks()]]
    digest = sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:8]
    return where / f"{name}-{plan.experiment.rig.name}-{digest}"


def map_into(
    plan: Plan[M],
    directory: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> M:
    """Map a simulated rig and keep everything in a directory; a finished map is read. Errors as `zwidth`."""
    make_directory(directory)
    found = zwidth(plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch)
    write_map(found, directory)
    return found


def map_on_rig(plan: MapPlan, directory: Path, session: Session) -> ZWidth:
    """Map a device and keep everything in a directory; errors as `rig.experiments.zwidth_rig.zwidth_on_rig`."""
    make_directory(directory)
    found = zwidth_on_rig(plan, session, journal=directory / JOURNAL)
    write_map(found, directory)
    return found


def write_map(found: Map, directory: Path) -> None:
    """Write the table of trials and the summary; `RecordingError` when the disk refuses."""
    document = summary(found)
    write_table(directory / found.table_name, found.table(), found.units(), document)
    write_document(directory / SUMMARY, document)


def summary(found: Map) -> dict[str, Any]:
    """Plain values, for JSON: everything but the single trials; of impedances with Table I."""
    more = {"table_one": plain(table_one(found))} if isinstance(found, FrequencyMap) else {}
    return {**found.as_mapping(), **more}
