"""``rig plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig import config
from rig.cli import hit_output, options, output
from rig.cli.command import command
from rig.core.check import refused
from rig.core.errors import PlanError
from rig.experiments.plan import make_plan


@command()
@options.experiment_options
@options.realtime_option("Plan what runs in real time: the [realtime] variant.")
@options.json_option
def plan(file: Path | None, preset: str | None, realtime: bool, as_json: bool, **changed: Any) -> None:
    """List what an experiment will do and check it against its limits; no device is touched.

    Exits with an error when something is refused.
    """
    experiment = options.chosen_experiment(file, preset)
    changes = options.changes(**changed)
    if realtime:
        experiment = config.with_realtime(experiment, changes)
    elif changes:
        experiment = config.override(experiment, changes)
    config.check_plugins(experiment, str(file or preset or options.DEFAULT_PRESET))
    planned = make_plan(experiment)
    if as_json:
        output.print_json(planned)
    else:
        output.show([hit_output.headline(experiment), *planned.items()])
    if not planned.ok:
        names = ", ".join(check.name for check in refused(planned.checks))
        raise PlanError(f"refused: {names}", remedy="see the checks")
