"""The command ``rig stop``: stop control loops that run in real time.

`rig.__main__` requests the stop before it imports this file, which waits for the loops and prints which have ended.
"""

import time
from typing import Any

import click

from rig.cli import output
from rig.cli.command import command, json_option  # not `options`: their experiments take 0.3 s to load
from rig.core.errors import RigError
from rig.realtime import running
from rig.realtime.memories import LoopMemory


@command()
@click.argument("pid", required=False, type=click.IntRange(1))
@click.option("--list", "only_list", is_flag=True, help="List the loops that run; stop none.")
@json_option
@click.pass_obj
def stop(asked: list[LoopMemory] | None, pid: int | None, only_list: bool, as_json: bool) -> None:
    """Stop the loops that run in real time, all of this user or that of process PID: zero effort within a tick.

    Their programs then bring the handle to rest, close their recordings and end.
    """
    if only_list:
        loops = [loop for loop in running.running() if pid is None or loop.pid == pid]
        _show([loop.as_mapping() for loop in loops], "no loop runs in real time", as_json)
        return
    stopped = running.stop(pid, asked=asked)
    nothing = "no loop runs in real time: nothing to stop"
    _show([one.as_mapping() for one in stopped], nothing, as_json)
    silent = [str(one.loop.pid) for one in stopped if not one.ended]
    if silent:
        error = RigError(
            f"process {', '.join(silent)} has not confirmed the stop request",
            remedy=f"cut the motor's power; then kill -9 {' '.join(silent)}, and the device's watchdog takes over",
        )
        error.reported = as_json
        raise error


def _show(loops: list[dict[str, Any]], nothing: str, as_json: bool) -> None:
    """Print the loops (without loops: the text `nothing`), and a note if loops of other users may exist."""
    hidden = running.hidden()
    if as_json:
        output.print_json({"loops": loops, "hidden": hidden})
        return
    for loop in loops:
        click.echo(_line(loop))
    if not loops:
        click.echo(nothing)
    for pid in hidden:
        click.echo(
            f"rig: process {pid} may run a loop too, but belongs to another user: sudo rig stop", err=True
        )


def _line(loop: dict[str, Any]) -> str:
    did = {None: "runs,", True: "stopped after", False: "asked to stop after"}[loop.get("ended")]
    parts = [f"process {loop['pid']}: {did} {loop['ticks']:,} ticks ({loop['phase']})"]
    if loop["since"]:
        parts.append(f"since {time.strftime('%H:%M:%S', time.localtime(loop['since']))}")
    parts += [loop[key] for key in ("url", "recording") if loop[key]]
    return ", ".join(parts)
