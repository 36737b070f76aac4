"""Export the recordings of a study for other programs: one file for each trial, and a table of the trials.

`rig session export` uses it. It must not overwrite a directory.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.sample import unit_of
from rig.extras.study.study import Study
from rig.extras.study.trial_facts import FACTS, facts_of, file_name, unusable
from rig.extras.study.trials import trials_of
from rig.recording.export import export
from rig.recording.files import whole_directory
from rig.session.finished import distinct_names

INDEX, MEANINGS = "trials.csv", "columns.csv"

Watch = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A written export: directory, number of recordings, and a sentence for each trial left out."""

    directory: Path
    recordings: int
    left_out: tuple[str, ...]


def export_trials(study: Study, directory: Path, kind: str, watch: Watch | None = None) -> Exported:
    """Write each recording as ``CODE/t0001.…`` into a new directory, which appears only when it is complete.

    `kind` is the format, one of `rig.recording.export.EXPORTERS`; `watch` is called with the number of finished
    recordings and the total. Raise `ConfigError` if two participant codes would share a directory; `RecordingError` if
    the directory exists, the format is unknown, or a file cannot be read or written. Recordings that are missing or
    changed raise no error; they are listed in `Exported.left_out`.
    """
    trials = [row for row in trials_of(study) if row.recorded != "none"]
    sources = {session.code: session.directory for session in study.sessions}
    places = distinct_names(sources, file_name, "directories keep only letters, digits and . _ + -")
    rows: list[list[Any]] = []
    left_out: list[str] = []
    with whole_directory(directory) as draft:
        for place in places.values():
            (draft / place).mkdir()
        for number, row in enumerate(trials, start=1):
            source, place = sources[row.participant], places[row.participant]
            problem = unusable(row)
            if problem is not None:
                left_out.append(problem)
            else:
                name = f"{place}/t{row.trial:04d}.{kind}"
                export(source / row.recording, draft / name, kind)
                rows.append([row.participant, name, *map(_cell, facts_of(row).values())])
            if watch is not None:
                watch(number, len(trials))
        _write(draft / INDEX, [["participant", "file", *FACTS], *rows])
        meanings = [[name, one.meaning, unit_of(one.unit, study.motion)] for name, one in FACTS.items()]
        _write(draft / MEANINGS, [["column", "meaning", "unit"], *meanings])
    return Exported(directory=directory, recordings=len(rows), left_out=tuple(left_out))


def _cell(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def _write(path: Path, rows: list[list[Any]]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
