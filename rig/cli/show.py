"""The command ``rig recording show``: print the content of a recording, and draw it.

`rig.experiments.trials.judgement` computes the verdict. This file must not write to the recording.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rig.cli import _hit_output as hit_output
from rig.cli import _values as values
from rig.cli import options, output
from rig.cli.command import RESULT, command, option
from rig.config import Experiment
from rig.core.present import Row, plain
from rig.core.sample import unit_of
from rig.experiments.trials.judgement import JUDGED, Verdicts, experiment_of, unexpected, verdicts_of
from rig.experiments.trials.planned import ARITHMETIC_WORDS
from rig.recording.counts import count_rows
from rig.recording.data import Recording
from rig.recording.marks import Mark
from rig.recording.marks import marks as marks_of
from rig.recording.origin import counts_facts, cut_facts, refuse_counts
from rig.recording.reader import open_facts, open_recording
from rig.views.plots import style
from rig.views.plots.hit import DRAWN, hit_figure, xy_figure


@command()
@click.argument("recording", type=values.RECORDING)
@option("--marks", is_flag=True, help="Also list the times of trial, contacts and sync edges.")
@options.picture_options("Also draw it.", default=False, place="RECORDING.png, or RECORDING-xy.png")
@option("--xy", group=RESULT, is_flag=True, help="Draw force over penetration instead of both over time.")
@options.expect_option(options.VERDICTS)
@options.json_option
def show(
    recording: Path,
    marks: bool,
    picture: options.PictureOption,
    xy: bool,
    expected: tuple[str, ...],
    as_json: bool,
) -> None:
    """Show the content of RECORDING: rig, wall, reason of the end, verdict, lost samples, columns."""
    opened = _open(recording, every_column=marks)
    if (facts := counts_facts(opened)) is not None:
        if xy or expected:
            refuse_counts(opened)
        _draw(recording, opened, picture, xy=False)
        if as_json:
            output.print_json({**_facts(opened, {}), **picture.facts()})
        else:
            _print_counts(opened, facts, picture.drawn)
        return
    experiment = experiment_of(opened)
    verdicts = verdicts_of(opened, experiment)
    picture.wanted |= xy
    _draw(recording, opened, picture, xy=xy)
    happened = marks_of(opened) if marks else None
    if as_json:
        also = {} if happened is None else {"marks": happened}
        output.print_json({**_facts(opened, verdicts), **picture.facts(), **also})
    else:
        _print(opened, experiment, verdicts, happened, picture.drawn)
    error = unexpected([verdicts.verdict], expected)
    if error is not None:
        error.reported = as_json
        raise error


def _open(path: Path, *, every_column: bool) -> Recording:
    """Open a recording with the columns for verdict and picture (or all); the header describes all columns."""
    needed = None if every_column else {*JUDGED, *DRAWN}
    return replace(open_recording(path, needed), header=open_facts(path).header)


def _draw(recording: Path, opened: Recording, picture: options.PictureOption, *, xy: bool) -> None:
    stem = recording.with_suffix("")
    figure = xy_figure if xy else hit_figure
    picture.draw(
        stem.with_name(f"{stem.name}-xy") if xy else stem, lambda path: style.save(figure(opened), path)
    )


def _print(
    opened: Recording,
    experiment: Experiment,
    verdicts: Verdicts,
    happened: list[Mark] | None,
    picture: Path | None,
) -> None:
    click.echo(hit_output.headline(experiment))
    header, trailer = opened.header, opened.trailer or {}
    rows = [
        Row("created", header.get("created")),
        Row("device", f"{header['identity'].get('device', '?')} at {header['identity'].get('url', '?')}"),
        Row("position zero", header["identity"].get("reference", "?")),
        Row("law ran on", _where(header)),
        Row(
            "ended", trailer.get("reason", "not cleanly: the writer ended before the recording was complete")
        ),
        Row("rows", len(opened.rows), note="" if opened.complete else "incomplete"),
        *(Row("lost", str(loss)) for loss in opened.lost),
    ]
    if (facts := cut_facts(opened)) is not None:
        rows.append(
            Row(
                "cut from",
                f"{facts['recording']}, {facts['first_s']:.6g} to {facts['last_s']:.6g} s, at {facts['cut_at']}",
                note=f"sha256 {facts['sha256']}" if facts.get("sha256") else "",
            )
        )
    if trailer.get("device_host_agreement"):
        rows.append(Row("beside the host's law", _agreement(trailer["device_host_agreement"])))
    if trailer.get("error"):
        rows.append(Row("error", trailer["error"]))
    if picture is not None:
        rows.append(Row("picture", str(picture)))
    output.print_rows([*rows, *verdicts.rows(experiment)])
    if happened is not None:
        click.echo("marks")
        output.print_pairs(_mark_pairs(happened))
    click.echo("columns")
    output.print_pairs([(n, f"{opened.units[n]:<8} {opened.descriptions[n]}") for n in opened.units])


def _mark_pairs(happened: list[Mark]) -> list[tuple[str, str]]:
    """Return name and text of each time mark; the text has the time (s) since the trial's start or the first mark."""
    pairs = []
    for mark in happened:
        start = next((one for one in happened if one.name == "trial"), happened[0])
        host = "unknown" if mark.host_time is None else f"{mark.host_time} ns"
        since_s = (mark.device_time - start.device_time) * 1e-9
        pairs.append(
            (mark.name, f"{since_s:+.6f} s   tick {mark.tick}, device {mark.device_time} ns, host {host}")
        )
    return pairs


def _where(header: dict[str, Any]) -> str:
    extra = header["extra"]
    if "wall" not in extra:
        return "the host"
    wall = ", ".join(
        f"{name} {value:g} {unit_of(name, header['motion'])}" for name, value in extra["wall"].items()
    )
    return f"the device, in {ARITHMETIC_WORDS.get(extra.get('arithmetic'), 'its own arithmetic')}: {wall}"


def _agreement(found: dict[str, Any]) -> str:
    return (
        f"{found['differing']} of {found['compared']} currents differ, by {found['greatest_quanta']} quanta at most"
        + (
            ""
            if found["holds"]
            else f"; {found['beyond']} by more than {found['bound_quanta']}: host and device do not "
            "run the same law"
        )
    )


def _print_counts(opened: Recording, facts: Mapping[str, Any], picture: Path | None) -> None:
    motion = opened.header["motion"]
    click.echo(f"{click.style(facts['file'], bold=True)}: counts of an encoder, without a rig")
    rows = [
        Row("created", opened.header.get("created")),
        *count_rows(facts, motion),
        Row("rows", len(opened.rows), note=f"{opened.time_s[-1]:.6g} s"),
    ]
    if picture is not None:
        rows.append(Row("picture", str(picture)))
    output.print_rows(rows)
    click.echo("columns")
    output.print_pairs([(n, f"{opened.units[n]:<8} {opened.descriptions[n]}") for n in opened.units])


def _facts(opened: Recording, verdicts: Verdicts | Mapping[str, Any]) -> dict[str, Any]:
    return {
        "header": opened.header,
        "trailer": {**(opened.trailer or {}), **plain(verdicts)},
        "rows": len(opened.rows),
        "complete": opened.complete,
        "lost": [str(loss) for loss in opened.lost],
        "columns": {name: opened.units[name] for name in opened.units},
    }
