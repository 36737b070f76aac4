"""The command ``rig device reference``."""

import click

from rig.cli import options
from rig.cli.command import command
from rig.cli.output import print_json, show
from rig.devices import load_backend
from rig.experiments.motion.reference import ReferenceRequest, find_reference


@command()
@options.request_options(ReferenceRequest, options.free_rig_options)
@options.json_option
def reference(request: ReferenceRequest, as_json: bool) -> None:
    """Find position zero by the encoder's index, which rig.reference of FILE describes.

    After a torque pulse the handle moves to the limit switch, at the speed and with the effort of [homing], and back
    over two index marks. The first mark defines the position rig.reference.position until the device restarts or loses
    counts, so that walls are at the same mechanical position every day; each recording names the reference. Exits with
    12 if the switch, a mark or the distance between two marks is not as described; with 10 or 7 if a limit ended a
    motion.
    """
    load_backend(request.url or "sim://")
    found = find_reference(request, lambda text: click.echo(text, err=True))
    if as_json:
        print_json(found)
    else:
        show(found.rows())
