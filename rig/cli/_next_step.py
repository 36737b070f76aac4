"""Print at the end of a command which command usually follows, from the description of a rig to its map."""

import shlex
from collections.abc import Mapping

import click

from rig.cli import options, output

# Command → the next one:{rig} is the rig of this one (of identify the file that it wrote), {device} its device.
NEXT: Mapping[str, str] = {
    "experiment new": "rig experiment plan{rig}",
    "experiment plan": "rig hit{rig}{device}",
    "hit": "rig theory walls{rig}",
    "theory walls": "rig zwidth{rig} --ratio 1.3",
    "zwidth": "rig design{rig}",
    "design": "rig identify{rig}{device} -o identified.toml",
    "device check": "rig identify{rig}{device} -o identified.toml",
    "identify": "rig hit{rig}{device}",
}


def name_next() -> None:
    """Print to standard error which command usually follows the running one, unless it prints JSON or has ``-q``."""
    context = click.get_current_context()
    given = context.params
    if given.get("as_json"):
        return
    file, url = given.get("file_out") or given.get("file"), given.get("url")
    preset = given.get("preset") or options.preset_of(url, file)
    rig = f" {shlex.quote(str(file))}" if file else f" --rig {shlex.quote(preset)}" if preset else ""
    device = "" if url is None else f" --url {shlex.quote(url)}" + " --verified" * bool(given.get("verified"))
    words = context.command_path.partition(" ")[2]
    output.note(f"next: {NEXT[words].format(rig=rig, device=device)}")
