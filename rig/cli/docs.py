"""The command ``rig serve docs``."""

from pathlib import Path

import click

from rig.cli import options, output
from rig.cli.command import command, option
from rig.views.site import build_site


@command()
@option("--open/--no-open", "opened", default=True, help="Show the first page in the browser.")
@option("--strict", is_flag=True, help="Treat warnings and broken links as errors.")
@options.output_option("site", "Directory of the site.", "directory")
@options.json_option
def docs(opened: bool, strict: bool, directory: Path, as_json: bool) -> None:
    """Build the documents of this version as a site, and open it: tutorials, how-tos, reference, gallery.

    Needs haptic-rig[docs] and no network; with haptic-rig[page] (411 MB) the first page also has a wall to touch. The
    gallery is executed, which takes a minute.
    """
    output.note("building the documents …")
    built = build_site(directory, strict=strict)
    if as_json:
        output.print_json(built)
    else:
        output.show(built.items())
        for warning in built.warnings:
            output.note(warning)
    if opened and click.launch(str(built.index)) != 0:
        output.note(f"no browser could be opened: open {built.index}")
