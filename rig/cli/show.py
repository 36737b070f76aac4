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
        ("law ran on", _where(header["extra"])),
        ("ended", str(trailer.get("reason", "not cleanly: the writer died"))),
        ("rows", f"{len(opened.rows)}{'' if opened.complete else ', incomplete'}"),
    ]
    pairs += [("lost", str(loss)) for loss in opened.lost]
    if trailer.get("law_agreement"):
        pairs.append(("beside the host's law", _agreement(trailer["law_agreement"])))
    if trailer.get("error"):
        pairs.append(("error", trailer["error"]))
    output.print_pairs([*pairs, *output.verdict_pairs(experiment, verdict, true)])
    click.echo("columns")
    output.print_pairs([(n, f"{opened.units[n]:<8} {opened.descriptions[n]}") for n in opened.names])


def _where(extra: dict[str, Any]) -> str:
    """Where the law ran, in words; recordings of the first version do not say, and were the host's."""
    from rig.experiments.plan import ARITHMETIC_WORDS  # noqa: PLC0415

    if extra.get("loop", "host") == "host":
        return "the host"
    arithmetic = str(extra.get("arithmetic", ""))
    return f"the device, in {ARITHMETIC_WORDS.get(arithmetic, arithmetic)}"


def _agreement(found: dict[str, Any]) -> str:
    """How the device's current followed the law that this computer ran on the same samples."""
    return (
        f"{found['differing']} of {found['compared']} currents differ, by {found['greatest_quanta']} quanta at most"
        + (
            ""
            if found["holds"]
            else f"; {found['beyond']} by more than {found['bound_quanta']}: not the same law"
        )
    )


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
