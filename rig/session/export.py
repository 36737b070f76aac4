"""The recordings of a study for other programs, one file a trial, and a table that says what each was."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.sample import unit_of
from rig.recording.export import export
from rig.recording.files import whole_directory
from rig.session.analysis.study import Study
from rig.session.trial_facts import FACTS, facts_of, file_name, unusable

INDEX, MEANINGS = "trials.csv", "columns.csv"

Watch = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """What was written: where, how many recordings, and which trials were left out, as sentences."""

    directory: Path
    recordings: int
    left_out: tuple[str, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "directory": str(self.directory),
            "recordings": self.recordings,
            "left_out": list(self.left_out),
        }


def export_trials(study: Study, directory: Path, kind: str, watch: Watch | None = None) -> Exported:
    """Write each recording as ``CODE/t0001.…`` in a directory of its own, which appears when all of it is there.

    Parameters
    ----------
    study
        Whose.
    directory
        Made; must not exist.
    kind
        One of `rig.recording.export.EXPORTERS`.
    watch
        Told how many recordings are done, and of how many.

    Raises
    ------
    RecordingError
        The directory exists, there is no such format, a recording cannot be read, or the disk refuses. What is missing
        or was changed is left out and said.
    """
    total = sum(len(session.recordings) for session in study.sessions)
    rows: list[list[Any]] = []
    left_out: list[str] = []
    with whole_directory(directory) as draft:
        for session in study.sessions:
            place = file_name(session.code)
            (draft / place).mkdir()
            for trial in session.state.trials:
                if trial.trial not in session.recordings:
                    continue
                problem = unusable(session, trial)
                if problem is not None:
                    left_out.append(problem)
                else:
                    name = f"{place}/t{trial.trial:04d}.{kind}"
                    export(session.directory / str(trial.recording), draft / name, kind)
                    told = facts_of(trial, session.voided.get(trial.trial, ""))
                    rows.append([session.code, name, *(_cell(told[fact]) for fact in FACTS)])
                if watch is not None:
                    watch(len(rows) + len(left_out), total)
        _write(draft / INDEX, [["participant", "file", *FACTS], *rows])
        meanings = [[name, text, unit_of(unit, study.motion)] for name, (text, unit) in FACTS.items()]
        _write(draft / MEANINGS, [["column", "meaning", "unit"], *meanings])
    return Exported(directory=directory, recordings=len(rows), left_out=tuple(left_out))


def _cell(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def _write(path: Path, rows: list[list[Any]]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
