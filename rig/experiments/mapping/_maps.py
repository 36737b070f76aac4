"""Run a map of walls as one sweep, and keep everything of one plan in one directory.

``plan.json`` states from the beginning on what is mapped; ``journal`` holds the finished tasks while the map grows;
``hits.parquet`` or ``walls.parquet`` every trial with its units; ``map.json`` the plan and the results. A map of a
device has its recordings in ``hits``.
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
    """A finished map."""

    table_name: ClassVar[str]

    def table(self) -> Iterator[dict[str, Any]]:
        """Return every trial as a flat row."""
        ...

    def units(self) -> Mapping[str, str]:
        """Return the unit of each column that has one."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON, without the single trials."""
        ...


M = TypeVar("M", bound=Map)
M_co = TypeVar("M_co", bound=Map, covariant=True)


class Plan(Protocol[M_co]):
    """Plan of a map: tasks of one kind of work, and the result that they make together."""

    unit: ClassVar[str]  # number in each row of a result that the progress counts

    @property
    def experiment(self) -> Experiment:
        """Return the experiment, whose rig names the directory."""
        ...

    @property
    def tasks(self) -> Sequence[sweep.Task]:
        """The independent parts, checked and made when first asked for; raises `PlanError` for what must not run."""
        ...

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan as plain values, for the file `PLAN`."""
        ...

    def found(self, results: Sequence[Any]) -> M_co:
        """Return the map that the results of all tasks make."""
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
        Plan of the map: `rig.experiments.mapping.zwidth.MapPlan` or
        `rig.experiments.mapping.zwidth_frequency.FrequencyPlan`.
    journal
        File that stores finished tasks; a run of the same plan resumes from it.
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
    """Directory of a plan: its name carries a digest of everything that decides the results, this package included.

    `device` names what is mapped, if not the simulation (`rig.experiments.mapping._zwidth_rig.work_of`).
    """
    # The package's version belongs to it: a map of another version must not be resumed as this one.
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
    """Map a simulated rig and keep everything in a directory; a finished map is read. Errors as `zwidth`."""
    _write_plan(plan, directory)
    found = zwidth(plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch)
    write_map(found, directory)
    return found


def map_on_rig(plan: MapPlan, directory: Path, session: DeviceMap) -> ZWidth:
    """Map a device and keep everything in a directory; errors as `zwidth_on_rig`."""
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
    """Return the plan of a map's directory, finished or not, and the URL of its device: empty for the simulation.

    Raises
    ------
    RecordingError
        It is no map, or one of another version.
    ConfigError
        This version cannot read the experiment.
    """
    path = directory / PLAN
    with plain_errors("read", path):
        text = read_regular(path, TABLE_BYTES)
    try:
        saved = json.loads(text)
        if saved["version"] == VERSION:
            # A plan is one of hits (`zwidth`) or of impedances (`zwidth_frequency`): the name of its work decides.
            kind = FrequencyPlan if saved["work"].endswith(f":{run_column.__name__}") else MapPlan
            return kind.from_mapping(saved["plan"], str(path)), str(saved["device"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RecordingError(f"{path} is damaged: {error!r}", remedy="run the map's command again") from None
    raise RecordingError(
        f"{path} is of version {saved['version']}, and this haptic-rig reads {VERSION}",
        remedy="read it with the version that wrote it",
    )


def recorded_hit(plan: MapPlan, series: Series, stiffness: float, output: Path) -> Path:
    """Return one simulated hit of a map as a recording: the same rows over the byte link, to the last bit.

    Its name says which hit it is, so that a hit that was asked for before is only found again.

    Raises
    ------
    PlanError
        A wall that a trial may not hit, though a map may: in a soft one the handle would go beyond its window.
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
        left: Recorded | None = left_by(error)  # thrown out by the wall: that is what the map has found
        if left is None:
            raise
        return left.path
    return result.path


def write_map(found: Map, directory: Path) -> None:
    """Write the table of trials and the summary; `RecordingError` when the disk refuses."""
    document = summary(found)
    write_table(directory / found.table_name, found.table(), found.units(), document)
    write_document(directory / SUMMARY, document)


def summary(found: Map) -> dict[str, Any]:
    """Return plain values, for JSON: everything but the single trials; of impedances with Table I."""
    more = {"table_one": plain(table_one(found))} if isinstance(found, FrequencyMap) else {}
    return {**found.as_mapping(), **more}
