"""``rig show``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig.cli import options, output


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--plot", type=click.Path(path_type=Path), help="Also draw it into this PNG.")
@options.json_option
def show(recording: Path, plot: Path | None, as_json: bool) -> None:
    """Show what RECORDING holds: rig, wall, why it ended, verdict, losses, columns."""
    from rig.experiments.judgement import experiment_of, judge  # noqa: PLC0415
    from rig.recording.reader import open_recording  # noqa: PLC0415

    opened = open_recording(recording)
    experiment = experiment_of(opened)
    verdict, true = judge(opened)
    if plot is not None:
        from rig.plots.hit import draw_hit  # noqa: PLC0415

        draw_hit(recording, plot)
    if as_json:
        output.print_json(_facts(opened, verdict, true))
        return
    click.echo(output.headline(experiment))
    header, trailer = opened.header, opened.trailer or {}
    pairs = [
        ("created", str(header.get("created"))),
        ("device", f"{header['identity']['device']} at {header['identity']['url']}"),
        ("law ran on", str(header["extra"].get("loop", "host"))),
        ("ended", str(trailer.get("reason", "not cleanly: the writer died"))),
        ("rows", f"{len(opened.rows)}{'' if opened.complete else ', incomplete'}"),
    ]
    pairs += [("lost", str(loss)) for loss in opened.lost]
    if trailer.get("error"):
        pairs.append(("error", trailer["error"]))
    output.print_pairs([*pairs, *output.verdict_pairs(experiment, verdict, true)])
    click.echo("columns")
    output.print_pairs([(n, f"{opened.units[n]:<8} {opened.descriptions[n]}") for n in opened.names])


def _facts(opened: Any, verdict: Any, true: Any) -> dict[str, Any]:
    from rig.experiments.judgement import as_trailer  # noqa: PLC0415

    return {
        "header": opened.header,
        "trailer": {**(opened.trailer or {}), **as_trailer(verdict, true)},
        "rows": len(opened.rows),
        "complete": opened.complete,
        "lost": [str(loss) for loss in opened.lost],
        "columns": {name: opened.units[name] for name in opened.names},
    }
