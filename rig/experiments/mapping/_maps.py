"""Run a map of walls as one sweep, and store everything that belongs to one plan in one directory.

`rig zwidth`, `rig impedance map`, `rig.experiments.lab` and the console use this module. Files: ``plan.json`` (the
plan, written first), ``journal`` (finished tasks), ``hits.parquet`` or ``walls.parquet`` (a row for each trial, with
units), ``map.json`` (plan and results). A map of a device has its recordings in the directory ``hits``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from rig import config
from rig.config import Experiment
from rig.core.errors import RecordingError, RigError
from rig.core.present import plain
from rig.core.regular_file import TABLE_BYTES, read_regular
from rig.experiments import sweep
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, Recorded, hit, left_by
from rig.experiments.hits.hit_simulator import start_of
from rig.experiments.mapping._zwidth_rig import DeviceMap, zwidth_on_rig
from rig.experiments.mapping.table_one import table_one
from rig.experiments.mapping.zwidth import MapPlan, Series, ZWidth
from rig.experiments.mapping.zwidth_frequency import FrequencyMap, FrequencyPlan, run_column
from rig.experiments.trials.results import make_directory, write_document, write_table
from rig.recording.files import plain_errors
from rig.recording.seal import SEALED_SUFFIX

JOURNAL, SUMMARY, RECORDINGS, PLAN = "journal", "map.json", "hits", "plan.json"
VERSION = 2  # of `PLAN`


class Map(Protocol):
    """An interface of a finished map: which walls are stable (by hits) or passive (by impedances)."""

    table_name: ClassVar[str]

    def table(self) -> Iterator[dict[str, Any]]:
        """Return the rows of the map's table: for each trial a mapping from column name to value."""
        ...

    def units(self) -> Mapping[str, str]:
        """Return the unit of each column of the table by name, without the columns that have no unit."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return the results as JSON values by name, without the single trials."""
        ...


M = TypeVar("M", bound=Map)
M_co = TypeVar("M_co", bound=Map, covariant=True)


class Plan(Protocol[M_co]):
    """An interface of the plan of a map: its tasks, and the function that computes the map from the tasks' results."""

    unit: ClassVar[str]  # number in each row of a result that the progress counts

    @property
    def experiment(self) -> Experiment:
        """Return the experiment; the name of its rig is part of the directory's name."""
        ...

    @property
    def tasks(self) -> Sequence[sweep.Task]:
        """Return the tasks of the map, created at the first access; raise `PlanError` if one is not permitted."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan as JSON values by name, for the file ``plan.json``."""
        ...

    def found(self, results: Sequence[Any]) -> M_co:
        """Return the finished map, computed from the results of all tasks, which have the order of `tasks`."""
        ...


def zwidth(
    plan: Plan[M],
    *,
    journal: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> M:
    """Run all tasks of a map of a simulated rig, without the byte link, and return the map.

    Parameters
    ----------
    plan
        Plan of the map: `rig.experiments.mapping.zwidth.MapPlan` or
        `rig.experiments.mapping.zwidth_frequency.FrequencyPlan`.
    journal
        File that stores finished tasks; a later run of the same plan resumes from this file. None: not stored.
    scheduler, workers, watch
        Address of a Dask scheduler, number of threads, and progress function (as in `rig.experiments.sweep.run`).

    Raises
    ------
    ConfigError
        A sampling scheme cannot run on this rig, or the journal belongs to another plan.
    PlanError
        The excitation exceeds a limit; nothing was run.
    StoppedError
        Ctrl-C was pressed; finished tasks stay in the journal.
    """
    results = sweep.run(
        plan.tasks,
        journal=None if journal is None else Path(journal),
        scheduler=scheduler,
        workers=workers,
        unit=plan.unit,
        watch=watch,
    )
    return plan.found(results)


def directory_for(plan: Plan[Map], where: Path, name: str, device: str = "") -> Path:
    """Return the directory of a plan inside `where`; its name has `name` and a hash of all tasks and the code version.

    `device` names the mapped device (`rig.experiments.mapping._zwidth_rig.work_of`); empty for the simulation.
    """
    # The code's version is part of the hash: a map of another version must not be resumed.
    described = [sweep.code_version(), device, [[task.key, task.payload] for task in plan.tasks]]
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
    """Find the stable or passive walls of a simulated rig, and store plan, journal and results in a directory.

    Raise the errors of `zwidth`. Tasks whose results are in the directory's journal (file of finished tasks) are not
    run again.
    """
    _write_plan(plan, directory)
    found = zwidth(plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch)
    write_map(found, directory)
    return found


def map_on_rig(plan: MapPlan, directory: Path, session: DeviceMap) -> ZWidth:
    """Find the stable walls of a device by hits, and store all in a directory; raise the errors of `zwidth_on_rig`."""
    _write_plan(plan, directory, session.where.url)
    found = zwidth_on_rig(plan, session, journal=directory / JOURNAL)
    write_map(found, directory)
    return found


def _write_plan(plan: Plan[Any], directory: Path, device: str = "") -> None:
    make_directory(directory)
    document = {
        "version": VERSION,
        "work": plan.tasks[0].work_name,
        "device": device,
        "plan": plan.as_mapping(),
    }
    write_document(directory / PLAN, document)


def read_plan(directory: Path) -> tuple[MapPlan | FrequencyPlan, str]:
    """Return the plan in a map's directory, and the URL of the mapped device ("" for the simulation).

    The map may be unfinished.

    Raises
    ------
    RecordingError
        The directory has no map, or has a map of another version.
    ConfigError
        This version cannot read the experiment.
    """
    path = directory / PLAN
    with plain_errors("read", path):
        text = read_regular(path, TABLE_BYTES)
    try:
        saved = json.loads(text)
        if saved["version"] == VERSION:
            # The name of the task function shows if the plan is of hits (`zwidth`) or impedances (`zwidth_frequency`).
            kind = FrequencyPlan if saved["work"].endswith(f":{run_column.__name__}") else MapPlan
            return kind.from_mapping(saved["plan"], str(path)), str(saved["device"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RecordingError(f"{path} is damaged: {error!r}", remedy="run the map's command again") from None
    raise RecordingError(
        f"{path} has the format version {saved['version']}; this haptic-rig can read only version {VERSION}",
        remedy="read the map with the version of haptic-rig that wrote it, or run the map's command again",
    )


def recorded_hit(plan: MapPlan, series: Series, stiffness: float, output: Path) -> Path:
    """Simulate one hit of a map again over the byte link, and return the path of the new recording in `output`.

    The recorded rows equal the hit of the map to the last bit. If the recording exists already, it is not made again.

    Raises
    ------
    PlanError
        A recorded trial may not hit this wall, although a map may: in a soft wall the handle would leave its window.
    """
    experiment = config.override(plan.experiment_of(series), {"wall.stiffness": stiffness}, "the map")
    experiment = config.override(experiment, {"rig.simulation.initial_position": start_of(experiment)})
    described = json.dumps([sweep.code_version(), config.as_mapping(experiment)], sort_keys=True)
    digest = sha256(described.encode()).hexdigest()[:8]
    name = f"{experiment.rig.name}-K{stiffness:.4g}-B{series.damping:.4g}-{digest}"
    there = output / f"{name}{SEALED_SUFFIX}"
    if there.exists():
        return there
    request = HitRequest(experiment=experiment, output=output, name=name, changes={"trial.repeats": 1})
    try:
        (result,) = hit(request, admit)
    except RigError as error:
        # An unstable wall ends the hit early, as in the map: its recording is the result.
        left: Recorded | None = left_by(error)
        if left is None:
            raise
        return left.path
    return result.path


def write_map(found: Map, directory: Path) -> None:
    """Write the table of trials and the summary of a map; raise `RecordingError` if a file cannot be written."""
    document = summary(found)
    write_table(directory / found.table_name, found.table(), found.units(), document)
    write_document(directory / SUMMARY, document)


def summary(found: Map) -> dict[str, Any]:
    """Return a map's results as JSON values by name, without the single trials; for impedances also Table I."""
    more = {"table_one": plain(table_one(found))} if isinstance(found, FrequencyMap) else {}
    return {**found.as_mapping(), **more}
