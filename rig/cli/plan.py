"""``rig plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli import hit_output, options, output
from rig.core.errors import PlanError
from rig.experiments.plan import make_plan

_MARKS = {"ok": ("ok", "green"), "warning": ("!!", "yellow"), "refused": ("no", "red")}


@click.command()
@options.experiment_options
@click.option("--realtime", is_flag=True, help="Plan what runs in real time: the [realtime] variant.")
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
        output.print_json(planned.as_mapping())
    else:
        click.echo(hit_output.headline(experiment))
        output.print_pairs([(step.name, step.text) for step in planned.steps])
        click.echo(f"  {planned.repeats} × at most {planned.duration_s / planned.repeats:.4g} s")
        for check in planned.checks:
            mark, colour = _MARKS[check.outcome]
            remedy = "" if check.outcome == "ok" else f": {check.remedy}"
            click.echo(f"  {click.style(mark, fg=colour)} {check.name}: {check.text}{remedy}")
    if not planned.ok:
        refused = [check.name for check in planned.checks if check.outcome == "refused"]
        raise PlanError(f"refused: {', '.join(refused)}", remedy="see the checks")
