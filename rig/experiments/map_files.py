"""A map on disk: one directory for one plan, so that the same command goes on with what it left.

``journal`` holds the finished climbs while the map grows, ``hits.parquet`` every hit with its units, ``map.json`` the
plan, the boundaries and the widths. A map of a device has its recordings in ``hits``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rig.control.measure import UNITS
from rig.core.sample import unit_of
from rig.experiments import sweep
from rig.experiments.results import make_directory, plan_directory, write_document, write_table
from rig.experiments.zwidth import TRUE, MapPlan, ZWidth, zwidth
from rig.experiments.zwidth_rig import Session, zwidth_on_rig

JOURNAL, TABLE, SUMMARY, RECORDINGS = "journal", "hits.parquet", "map.json", "hits"


def directory_for(plan: MapPlan, where: Path, name: str, device: str = "") -> Path:
    """Directory of a plan; `device` says what is mapped, if not the simulation (`zwidth_rig.work_of`)."""
    return plan_directory(where, f"{name}-{plan.experiment.rig.name}", plan.tasks(), device)


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


def write_map(found: ZWidth, directory: Path) -> None:
    """Write the table of hits and the summary; `RecordingError` when the disk refuses."""
    summary = found.as_mapping()
    write_table(directory / TABLE, found.table(), _units(found), summary)
    write_document(directory / SUMMARY, summary)


def _units(found: ZWidth) -> Mapping[str, str]:
    motion = found.plan.experiment.rig.motion
    quantities: dict[str, Any] = {"damping": "damping", "stiffness": "stiffness", "offset": "count"}
    for name, quantity in UNITS.items():
        quantities[name] = quantities[name + TRUE] = quantity
    return {name: unit_of(quantity, motion) for name, quantity in quantities.items()}
