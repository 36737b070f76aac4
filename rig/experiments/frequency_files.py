"""A frequency-domain map on disk: one directory for one plan, as in `rig.experiments.map_files`.

``journal`` holds the finished columns while the map grows, ``walls.parquet`` every wall by each realisation and by all
together, with units, ``map.json`` the plan, Table I and the paths of the boundary search.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from rig import config
from rig.experiments import sweep
from rig.experiments.executors import code_version
from rig.experiments.results import write_table
from rig.experiments.table_one import TableOne, table_one
from rig.experiments.zwidth_frequency import FrequencyMap, FrequencyPlan, zwidth_frequency
from rig.recording.files import plain_errors, whole_file

JOURNAL, TABLE, SUMMARY = "journal", "walls.parquet", "map.json"


def directory_for(plan: FrequencyPlan, where: Path) -> Path:
    """Directory of a plan: its name carries a digest of everything that decides the map, this package included."""
    tasks = [[task.key, task.payload] for task in plan.tasks()]
    digest = sha256(json.dumps([code_version(), tasks], sort_keys=True).encode()).hexdigest()
    return where / f"zwidth-frequency-{plan.experiment.rig.name}-{digest[:8]}"


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
    with plain_errors("make", directory):
        directory.mkdir(parents=True, exist_ok=True)
    found = zwidth_frequency(
        plan, journal=directory / JOURNAL, scheduler=scheduler, workers=workers, watch=watch
    )
    table = table_one(found)
    document = summary(found, table)
    write_table(directory / TABLE, found.table(), found.units(), document)
    with whole_file(directory / SUMMARY, overwrite=True) as file:
        file.write(json.dumps(document, ensure_ascii=False, indent=1).encode())
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
