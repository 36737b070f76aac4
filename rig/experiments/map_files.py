"""A map on disk: one directory for one plan, so that the same command goes on with what it left.

``journal`` holds the finished climbs while the map grows, ``hits.parquet`` every hit with its units, ``map.json`` the
plan, the boundaries and the widths. A map of a device has its recordings in ``hits``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.experiments import sweep
from rig.experiments.executors import code_version
from rig.experiments.results import write_table
from rig.experiments.zwidth import TRUE, MapPlan, ZWidth, zwidth
from rig.measure import UNITS
from rig.recording.files import plain_errors, whole_file
from rig.sample import unit_of

if TYPE_CHECKING:
    from rig.experiments.zwidth_rig import Session

JOURNAL, TABLE, SUMMARY, RECORDINGS = "journal", "hits.parquet", "map.json", "hits"


def directory_for(plan: MapPlan, where: Path, name: str, device: str = "") -> Path:
    """Directory of a plan: its name carries a digest of everything that decides the map, this package included.

    `device` names what is mapped, when it is not the simulation without bytes (`zwidth_rig.work_of`).
    """
    described = json.dumps(
        [code_version(), device, [[task.key, task.payload] for task in plan.tasks()]], sort_keys=True
    )
    return where / f"{name}-{plan.experiment.rig.name}-{sha256(described.encode()).hexdigest()[:8]}"


def map_into(
    plan: MapPlan,
    directory: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> ZWidth:
    """Map a simulated rig and keep everything in a directory; errors as `rig.experiments.zwidth.zwidth`.

    A map that was stopped goes on; a finished one is read.
    """
    _make(directory)
    found = zwidth(plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch)
    write_map(found, directory)
    return found


def map_on_rig(plan: MapPlan, directory: Path, session: Session) -> ZWidth:
    """Map a device and keep everything in a directory; errors as `rig.experiments.zwidth_rig.zwidth_on_rig`."""
    from rig.experiments.zwidth_rig import zwidth_on_rig  # noqa: PLC0415  (recordings and links, not for a simulation)

    _make(directory)
    found = zwidth_on_rig(plan, session, journal=directory / JOURNAL)
    write_map(found, directory)
    return found


def _make(directory: Path) -> None:
    with plain_errors("make", directory):
        directory.mkdir(parents=True, exist_ok=True)


def write_map(found: ZWidth, directory: Path) -> None:
    """Write the table of hits and the summary; `RecordingError` when the disk refuses."""
    summary = found.as_mapping()
    write_table(directory / TABLE, found.table(), _units(found), summary)
    with whole_file(directory / SUMMARY, overwrite=True) as file:
        file.write(json.dumps(summary, ensure_ascii=False, indent=1).encode())


def _units(found: ZWidth) -> Mapping[str, str]:
    motion = found.plan.experiment.rig.motion
    quantities: dict[str, Any] = {"damping": "damping", "stiffness": "stiffness", "offset": "count"}
    for name, quantity in UNITS.items():
        quantities[name] = quantities[name + TRUE] = quantity
    return {name: unit_of(quantity, motion) for name, quantity in quantities.items()}
