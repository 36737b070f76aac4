"""Command ``rig console``: operate a rig in the browser."""

import json
from pathlib import Path

import click

from rig.cli import options
from rig.cli.command import command
from rig.core import program


@command(quiet=False)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="On loopback. [any that is free]")
@click.option(
    "--allow-host",
    "hosts",
    multiple=True,
    metavar="NAME:PORT",
    help="Another host name under which a browser reaches this page, such as the local end of an ssh tunnel.",
)
@options.verified_option
@click.option("--own", is_flag=True, help="Show only runs that are started on this page.")
@options.output_option("recordings", "Directory of the recordings.")
@options.json_option
def console(
    port: int, hosts: tuple[str, ...], verified: bool, own: bool, output: Path, as_json: bool
) -> None:
    """Operate a rig in the browser: a live scope, the wall's sliders, a handle to drag, STOP.

    Prints one URL to open; a browser with this URL may operate. Without a rig it offers the simulated one. It shows any
    loop that runs on this computer in real time, and starts runs itself, each in its own process. A real rig is armed
    only after a word typed in this terminal. Ctrl-C ends the console and the runs that it started.

    From another computer: ssh -L 8765:127.0.0.1:8765 HOST, and rig console --port 8765 there.
    """
    from rig.extras.console.open import open_console  # noqa: PLC0415  (needs the extra, and --help does not)

    def announce(url: str) -> None:
        click.echo(json.dumps({"url": url}) if as_json else f"rig console: {url}")
        program.stay()

    open_console(port=port, hosts=hosts, verified=verified, own=own, output=output, announce=announce)
