"""The command ``rig hit``: push the handle into a virtual wall, judge, record and draw.

`rig.experiments.hits.hit` runs and judges the hit; this file parses options, prints, and draws in another process. A
failed picture must not end a run.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from rig.cli import _hit_output as hit_output
from rig.cli import options, output
from rig.cli._next_step import name_next
from rig.cli.command import command
from rig.control.verdict import Verdict
from rig.core.errors import RigError
from rig.core.present import Row, plain
from rig.devices import load_backend
from rig.doctor.gate_result import Gate
from rig.experiments.hits import hit as hits
from rig.experiments.hits.admission import admit
from rig.experiments.trials.judgement import unexpected


@command()
@options.request_options(hits.HitRequest, options.experiment_options)
@options.plot_options("Draw a picture beside the recording.")
@options.expect_option(options.VERDICTS)
@options.json_option
def hit(request: hits.HitRequest, plot: str, expected: tuple[str, ...], as_json: bool) -> None:
    """Hit a virtual wall: home to the start, push into the wall, judge, record and draw.

    Without arguments: the dual-rate wall of Koul et al. on the simulated rig koul-compliant, in virtual time. FILE is
    an experiment in TOML (`rig experiment preset koul-compliant` prints one). Ctrl-C ends with zero effort and a valid
    recording.

    The last part of the trial decides the verdict: an oscillation is felt (velocity of the handle), heard (ripple of
    the effort) or moved (position, peak to peak) if it exceeds the threshold that is printed beside it.

    For scripts: with --expect stable, the exit code is 17 if a hit has another verdict.
    """
    load_backend(request.url or "sim://")
    request = replace(
        request,
        measuring=hit_output.measuring_link(quiet=as_json),
        judged_link=_print_gate,
        hands_off=lambda text: click.echo(f"rig: {text}", err=True),
    )
    done: list[dict[str, Any]] = []
    failure: RigError | None = None
    verdicts: list[Verdict] = []
    with Artist(plot) as artist, hit_output.ProgressBars(quiet=as_json) as bars:
        try:
            for result in hits.hit(request, admit, bars.watch):
                bars.stop()
                verdicts.append(result.verdict)
                picture = artist.draw(result.path)
                done.append({**plain(result), "picture": picture})
                if len(done) == 1:
                    for message in result.messages:
                        click.echo(f"rig: {message}", err=True)
                if not as_json:
                    changed = hit_output.differences(request.experiment, result.experiment, request.changes)
                    _print_result(result, picture, changed)
        except RigError as error:
            bars.stop()
            failure = error
            _show_what_was_recorded(error, artist, quiet=as_json)
    if failure is None:
        failure = unexpected(verdicts, expected)
    if as_json:
        output.print_json({"hits": done, "error": None if failure is None else output.error_facts(failure)})
    if failure is not None:
        failure.reported = as_json
        raise failure
    name_next()


class Artist:
    """A separate process that draws pictures of recordings; it imports its libraries while the trial runs."""

    def __init__(self, ending: str) -> None:
        self._ending = ending
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Artist:
        if self._ending:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "rig.views.plots.hit"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                # In its own session, so that Ctrl-C reaches only the trial and not the drawing process.
                start_new_session=True,
            )
        return self

    def __exit__(self, *error: object) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def draw(self, recording: Path) -> str | None:
        """Draw a recording; return the path of the picture, or None if no picture is requested or drawing fails."""
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return None
        try:
            picture = recording.with_suffix(f".{self._ending}")
            process.stdin.write(json.dumps([str(recording), str(picture)]) + "\n")
            process.stdin.flush()
            answer: dict[str, str] = json.loads(process.stdout.readline())
        except (OSError, ValueError):
            answer = {"error": "the process that draws ended"}
        if "picture" not in answer:
            # Report only: the recording is already on disk.
            click.echo(f"rig: no picture: {answer['error']}", err=True)
        return answer.get("picture")


def _print_result(result: Any, picture: str | None, changed: list[str]) -> None:
    if result.cleared_fault:
        click.echo(f"rig: a latched fault of the device was cleared: {result.cleared_fault}", err=True)
    click.echo(hit_output.headline(result.experiment))
    if changed:
        click.echo(f"  in effect: {', '.join(changed)}")
    _print_recorded(result.recorded, picture)


def _print_gate(gate: Gate) -> None:
    """Warn if the wall is armed although the check before arming fails: on a simulated rig, or with --arm-anyway."""
    if gate.armable:
        return
    why = "--arm-anyway" if gate.forced and not gate.simulated else "a real rig would refuse to arm"
    click.echo(f"rig: arming despite the warning ({why}): {gate.text}", err=True)


def _show_what_was_recorded(error: RigError, artist: Artist, *, quiet: bool) -> None:
    try:
        left = hits.left_by(error)
    except RigError as unreadable:
        click.echo(f"rig: {unreadable}", err=True)
        return
    if left is None:
        return
    for warning in left.recording.header["extra"].get("warnings", []):
        click.echo(f"rig: {warning}", err=True)
    picture = artist.draw(left.path)
    if quiet:
        return
    click.echo(hit_output.headline(left.experiment))
    _print_recorded(left, picture)


def _print_recorded(recorded: hits.Recorded, picture: str | None) -> None:
    rows = recorded.judgement.rows(recorded.experiment)
    rows.append(Row("recording", str(recorded.path)))
    if picture is not None:
        rows.append(Row("picture", picture))
    output.print_rows(rows)
