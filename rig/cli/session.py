"""``rig session``: experiments with people, from a protocol file to a table."""

from __future__ import annotations

import click

from rig.cli.lazy import LazyGroup

# Command → module:attribute, and the line that `rig session --help` shows without importing it.
COMMANDS: dict[str, tuple[str, str]] = {
    "new": ("rig.cli.session_protocol:new", "Write a commented protocol file to start from."),
    "check": (
        "rig.cli.session_protocol:check",
        "Show what a protocol will do, and check it, before anyone touches the handle.",
    ),
    "run": ("rig.cli.session_run:run", "Run a participant's session, or rehearse it on a simulated rig."),
    "resume": ("rig.cli.session_run:resume", "Resume a session that was left, whatever ended it."),
    "show": ("rig.cli.session_run:show", "Show where a session stands, and list its log."),
    "amend": ("rig.cli.session_run:amend", "Record a correction in a session's log; nothing is erased."),
    "analyse": (
        "rig.cli.session_analyse:analyse",
        "Z-width with intervals, statistics, pictures and a report of a study.",
    ),
    "export": ("rig.cli.session_export:export", "Write a study's raw data as BIDS-motion or CSV."),
    "schema": ("rig.cli.session_protocol:schema", "Print the JSON schema of protocol files, for editors."),
}


@click.group(cls=LazyGroup, table=COMMANDS)
def session() -> None:
    """Run wall-hit experiments with people: protocol, sessions, analysis.

    Without hardware: `rig session new study.toml`, then `rig session run study.toml P01 --rehearse`.
    """
