"""The commands ``rig firmware …``: build an image for a board and a rig, inspect it, flash it, and test a device.

`rig.firmware.interface` does the work; this file parses options and prints.
"""

from dataclasses import replace
from pathlib import Path

import click

from rig import config
from rig.cli import _values as values
from rig.cli import options, output
from rig.cli._keyword_options import gathered_options
from rig.cli.command import command, option
from rig.config import amplifiers as profiles
from rig.config import presets
from rig.config.checked import read_toml
from rig.core.errors import IncompatibleDeviceError
from rig.devices import open_device, open_link
from rig.firmware.interface import (
    DEVICE,
    PORT_CHECK,
    BuildRequest,
    PortCheckRequest,
    SelfTestRequest,
    boards,
    broken_duties,
    draw,
    failure,
)
from rig.firmware.interface import build as build_image
from rig.firmware.interface import check_port as try_port
from rig.firmware.interface import flash as copy_image
from rig.firmware.interface import info as look
from rig.firmware.interface import selftest as run
from rig.firmware.interface import wiring as wired

DEFAULT_BOARD = "rp2040"
_LISTED = ("name", "description", "rate_maximum", "settings")


board_option = option(
    "--board",
    default=DEFAULT_BOARD,
    show_default=True,
    help="Name or directory of the board; list: list all boards.",
)
pins_option = option(
    "--set",
    "sets",
    multiple=True,
    metavar="NAME=VALUE",
    help="A pin or scale of the board: --set enable_pin=6.",
)


@command()
@options.rig_option(given=True)
@board_option
@pins_option
@click.option(
    "--settings",
    "settings_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="TOML file of such settings; --set wins.",
)
@click.option(
    "--amplifier",
    help="Amplifier profile, instead of the rig's rig.amplifier.profile; rig firmware amplifiers lists them.",
)
@click.option(
    "--check-port",
    "for_check",
    is_flag=True,
    help="Build the program that tests the board's port, instead of the firmware.",
)
@options.output_option("firmware", "Directory of the image.", "directory")
@options.json_option
def build(
    preset: str,
    board: str,
    amplifier: str | None,
    directory: Path,
    sets: tuple[str, ...],
    settings_file: Path | None,
    for_check: bool,
    as_json: bool,
) -> None:
    """Build the firmware of a board for one rig: ELF, BIN, UF2 if the board accepts it, and a description as JSON.

    Needs the cross compiler of the distribution (gcc-arm-none-eabi, libnewlib-arm-none-eabi). The same inputs give the
    same bytes.
    """
    if board == "list":
        found = [boards.load(name) for name in boards.names()]
        if as_json:
            output.print_json([{name: getattr(one, name) for name in _LISTED} for one in found])
        else:
            output.show(item for one in found for item in one.items())
        return
    chosen = {**(read_toml(settings_file, "a settings") if settings_file else {}), **options.key_values(sets)}
    experiment = presets.load_named(preset)
    if amplifier is not None:
        experiment = config.override(experiment, {"rig.amplifier.profile": amplifier}, "--amplifier")
    request = BuildRequest(
        model=config.rig_model(experiment),
        board=board,
        output=directory,
        settings=chosen,
        application=PORT_CHECK if for_check else DEVICE,
        controller=experiment.controller,
    )
    with output.StatusLine(quiet=as_json) as status:
        built = build_image(request, status.on_progress)
    for warning in built.warnings:
        click.echo(f"rig: {warning}", err=True)
    if as_json:
        output.print_json(built)
        return
    output.print_rows(built.rows())
    for path in (built.elf, built.bin, built.uf2, built.facts):
        if path is not None:
            click.echo(str(path))
    if built.uf2 is not None:
        output.note(f"rig: next: rig firmware flash {built.uf2}")


@command()
@options.json_option
def amplifiers(as_json: bool) -> None:
    """List the known amplifiers: keys of a rig and a board that each one needs, and what to set in the amplifier."""
    found = [profiles.load(name) for name in profiles.names()]
    if as_json:
        output.print_json(found)
    else:
        output.show(item for one in found for item in one.items())


@command()
@board_option
@pins_option
@options.output_option("wiring.svg", "File of the drawing (SVG).", "drawing")
@options.json_option
def wiring(board: str, sets: tuple[str, ...], drawing: Path, as_json: bool) -> None:
    """Draw the wiring of a board's reference rig, with the pins of its settings, and list the wires."""
    known = boards.load(board)
    found = wired(known, boards.settings_of(known, options.key_values(sets)))
    path = draw(found, drawing)
    if as_json:
        output.print_json({"parts": found.parts, "nets": found.nets(), "drawing": path})
        return
    output.print_pairs([(net, ", ".join(pins)) for net, pins in found.nets().items()])
    click.echo(str(path))


@command()
@click.argument("source", metavar="FILE|URL", type=values.URL)
@options.json_option
def info(source: str, as_json: bool) -> None:
    """Identify an image, or the firmware of the device at a URL, and check whether this package supports it.

    Exits with 4 if the firmware is not supported.
    """
    found = look(source)
    if as_json:
        output.print_json(found)
    else:
        output.show(found.items())
    if not found.compatible:
        refused = IncompatibleDeviceError(
            f"this package cannot run the firmware of {source}",
            remedy="build it again with this package (rig firmware build) and flash it (rig firmware flash)",
        )
        refused.reported = as_json
        raise refused


@command()
@click.argument("image", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--drive",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where the board's drive is mounted. [searched]",
)
@options.url_option(
    "the board is already in its boot loader; else: URL of a disarmed device, which restarts into "
    "its boot loader"
)
@options.json_option
def flash(image: Path, drive: Path | None, url: str | None, as_json: bool) -> None:
    """Copy an image (.uf2) to the drive of a board in its boot loader, and wait until the board has started it.

    Hold BOOTSEL while you connect the board, or name the device with --url: then the drive appears. Motor power must be
    off.
    """
    with output.StatusLine(quiet=as_json) as status:
        done = copy_image(image, drive, status.on_progress, url=url)
    if as_json:
        output.print_json(done)
        return
    click.echo(
        f"the drive at {done.drive} took the image: {done.board}, {done.firmware}, for the rig "
        f"{done.rig}. Next, check that it runs: rig firmware info URL"
    )
    click.echo("next: rig device list (it must appear there); then rig firmware selftest URL")


@command()
@click.argument("url", type=values.URL)
@options.rig_option("any")
@click.option(
    "--rate", type=options.Hertz(50, 200_000), help="Tick rate to test (Hz). [the device's maximum]"
)
@gathered_options(SelfTestRequest, "request")
@options.json_option
def selftest(url: str, preset: str | None, rate: int | None, request: SelfTestRequest, as_json: bool) -> None:
    """Test the device at URL and its link. Nothing moves: no command requests a current.

    Exits with 5 if a check fails.
    """
    experiment = None if preset is None else presets.load_named(preset)
    if request.move and not as_json:
        click.echo("move the handle by hand until the test has ended", err=True)
    request = replace(request, experiment=experiment, rate=rate)
    with open_device(url, request.model) as device, output.StatusLine(quiet=as_json) as status:
        found = run(device, request, status.on_progress)
    if as_json:
        output.print_json(found)
    else:
        output.show(found.items())
    error = failure(found)
    if error is not None:
        error.reported = as_json
        raise error


@command("check-port")
@click.argument("url", type=values.URL)
@gathered_options(PortCheckRequest, "request")
@options.json_option
def check_port(url: str, request: PortCheckRequest, as_json: bool) -> None:
    """Test each hardware function (duty) that firmware needs on the board at URL, with a special program.

    `rig firmware build --check-port` builds the program.

    Without --current no motor current is switched on. The watchdog resets the board twice. Exits with 5 if a function
    fails.
    """
    with output.StatusLine(quiet=as_json) as status:
        found = try_port(lambda: open_link(url), request, status.on_progress)
    if as_json:
        output.print_json(found)
    else:
        output.show(found.items())
    error = broken_duties(found)
    if error is not None:
        error.reported = as_json
        raise error
