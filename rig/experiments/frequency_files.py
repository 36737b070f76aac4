"""A frequency-domain map on disk: one directory for one plan, as in `rig.experiments.map_files`.

``journal`` holds the finished columns while the map grows, ``walls.parquet`` every wall by each realisation and by all
together, with units, ``map.json`` the plan, Table I and the paths of the boundary search.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig import config
from rig.experiments import sweep
from rig.experiments.results import make_directory, plan_directory, write_document, write_table
from rig.experiments.table_one import TableOne, table_one
from rig.experiments.zwidth_frequency import FrequencyMap, FrequencyPlan, zwidth_frequency

JOURNAL, TABLE, SUMMARY = "journal", "walls.parquet", "map.json"


def directory_for(plan: FrequencyPlan, where: Path) -> Path:
    """Directory of a plan."""
    return plan_directory(where, f"zwidth-frequency-{plan.experiment.rig.name}", plan.tasks())


def map_into(
    plan: FrequencyPlan,
    directory: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
) -> tuple[FrequencyMap, TableOne]:
    """Map a simulated rig and keep everything in a directory; errors as `zwidth_frequency`.

    A map that was stopped goes on; a finished one is read.
    """
    make_directory(directory)
    found = zwidth_frequency(
        plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch
    )
    table = table_one(found)
    document = summary(found, table)
    write_table(directory / TABLE, found.table(), found.units(), document)
    write_document(directory / SUMMARY, document)
    return found, table


def summary(found: FrequencyMap, table: TableOne) -> dict[str, Any]:
    """Plain values, for JSON: everything but the single walls."""
    plan = found.plan
    return {
        "domain": "frequency",
        "rig": plan.experiment.rig.name,
        "motion": plan.experiment.rig.motion,
        "stiffnesses": list(plan.stiffnesses),
        "dampings": list(plan.dampings),
        "judging": {
            "band_hz": list(plan.band_hz),
            "z_score": plan.judging.z_score,
            "residual_threshold": plan.judging.residual_threshold,
        },
        "excitation": {
            **config.as_mapping(plan.experiment)["excitation"],
            **config.excitation_size(plan.experiment),
        },
        "signal": plan.signal,
        "table_one": table.as_mapping(found),
        "passive": found.passive[:, -1].tolist(),
        "experiment": config.as_mapping(plan.experiment),
    }
