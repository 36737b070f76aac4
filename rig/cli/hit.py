"""``rig hit``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig.cli import options, output


@click.command()
@options.experiment_options
@click.option("--url", help="Device: serial:///dev/ttyACM0, sim://. [simulates the rig in this process]")
@click.option(
    "--realtime", is_flag=True, help="In real time; a simulated rig then runs as a process of its own."
)
@click.option("--verified", is_flag=True, help="Encoder and motor signs of this real rig were checked.")
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(path_type=Path),
    default=Path("recordings"),
    show_default=True,
)
@click.option("--plot/--no-plot", default=True, help="Draw a picture beside the recording.")
@options.json_option
def hit(
    file: Path | None,
    preset: str | None,
    url: str | None,
    realtime: bool,
    verified: bool,
    directory: Path,
    plot: bool,
    as_json: bool,
    **changed: Any,
) -> None:
    """Hit a virtual wall: home to the start, push into the wall, judge, record and draw.

    Without arguments: the dual-rate wall of Koul et al. on the simulated rig koul-compliant, in virtual
    time. FILE is an experiment in TOML (`rig preset koul-compliant` prints one). Ctrl-C ends with zero
    effort and a valid recording.
    """
    changes = options.changes(**changed)
    experiment = options.chosen_experiment(file, preset)
    with output.compiling():
        from rig.devices import load_backend  # noqa: PLC0415  (imports compile)
        from rig.experiments import hit as hits  # noqa: PLC0415

        load_backend(url or "sim://")
    request = hits.HitRequest(
        experiment=experiment,
        url=url,
        changes=changes,
        realtime=realtime,
        verified=verified,
        output=directory,
    )
    done = []
    with output.progress_bars(quiet=as_json) as watch:
        for result in hits.hit(request, watch):
            picture = _draw(result.recording) if plot else None
            done.append({**result.as_mapping(), "picture": picture})
            if not as_json:
                _print(result, picture)
    if as_json:
        output.print_json(done)


def _draw(recording: Path) -> str | None:
    """Draw the picture; one that fails is reported and takes nothing with it, since the recording is on disk."""
    from rig.plots.hit import draw_hit  # noqa: PLC0415

    try:
        return str(draw_hit(recording))
    except Exception as error:
        click.echo(f"rig: no picture: {error}", err=True)
        return None


def _print(result: Any, picture: str | None) -> None:
    click.echo(output.headline(result.experiment))
    pairs = output.verdict_pairs(result.experiment, result.verdict, result.verdict_true)
    pairs.append(("recording", str(result.recording)))
    if picture is not None:
        pairs.append(("picture", picture))
    output.print_pairs(pairs)
