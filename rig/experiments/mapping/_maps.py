"""Find all stable or passive walls of one plan by parallel tasks (function calls), and store them in one directory.

`rig zwidth`, `rig impedance map`, `rig.experiments.lab` and the console use this module. Files: ``plan.json`` (the
plan, written first), ``journal`` (finished tasks), ``hits.parquet`` or ``walls.parquet`` (a row for each trial, with
units), ``map.json`` (plan and results). A map of a device has its recordings in the directory ``hits``.
"""

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
        """Yield the rows of the map's table, one for each trial, as mappings from column name to value."""
        ...

    def units(self) -> Mapping[str, str]:
        """Return the unit of each column of the map's table by name, without columns that have no unit."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return the map's results as JSON values by name, without the single trials."""
        ...


M = TypeVar("M", bound=Map)
M_co = TypeVar("M_co", bound=Map, covariant=True)


class Plan(Protocol[M_co]):
    """An interface of plans for maps of walls: independent calls (tasks), and how their results form the map."""

    unit: ClassVar[str]  # number in each row of a result that the progress counts

    @property
    def experiment(self) -> Experiment:
        """Return the experiment whose rig is mapped."""
        ...

    @property
    def tasks(self) -> Sequence[sweep.Task]:
        """Return the calls that compute the map, created at first access; `PlanError` if one is not permitted."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan of the map as JSON values by name, for the file ``plan.json``."""
        ...

    def found(self, results: Sequence[Any]) -> M_co:
        """Return the finished map of walls, computed from the results of all `tasks` in their order."""
        ...


def zwidth(
    plan: Plan[M],
    *,
    journal: str | Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> M:
    """Find the stable or passive walls of a simulated rig in parallel, without messages over a link; return the map.

    Parameters
    ----------
    plan
        Plan of the map: `rig.experiments.mapping.zwidth.MapPlan` or
        `rig.experiments.mapping.zwidth_frequency.FrequencyPlan`.
    journal
        File that stores finished results; a later run of the same plan resumes from this file. None: not stored.
    scheduler, workers, watch
        Address of a Dask scheduler, number of threads, and function that is called with the progress.

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
    """Return the directory of a map inside `where`; its name has `name` and a hash of the plan and the code version.

    `device` names the mapped device, so that maps of two devices are not mixed; empty for the simulation.
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

    Results that are in the directory's journal (file of finished tasks) already are not computed again.
    """
    _write_plan(plan, directory)
    found = zwidth(plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch)
    write_map(found, directory)
    return found


def map_on_rig(plan: MapPlan, directory: Path, session: DeviceMap) -> ZWidth:
    """Find the stable walls of a device by hits, which a person permits, and store all in a directory."""
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
    """Simulate one hit of a map again with a recording, and return the path of the recording in `output`.

    The samples equal the hit of the map to the last bit. A recording that exists already is not made again.

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
    """Return a map's results as JSON values by name, without single trials; for impedances also the paper's Table I."""
    more = {"table_one": plain(table_one(found))} if isinstance(found, FrequencyMap) else {}
    return {**found.as_mapping(), **more}
