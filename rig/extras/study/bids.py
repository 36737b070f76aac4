"""Export a study's raw data as a BIDS-motion dataset, so that common tools can read it (BIDS 1.10).

One recording is one run of the task ``wallhit``, numbered by its trial. The scans file of a participant contains the
wall and verdict of each run, also of practice, redone and invalid trials. From the session's log only walls, verdicts
and answers to the questionnaire are exported; the operator's notes are free text and are not exported.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError
from rig.core.sample import Motion, unit_of
from rig.extras.study import bids_motion
from rig.extras.study.bids_motion import EVENTS, MISSING, TASK, TRACKSYS, Channel
from rig.extras.study.rows import TrialRow
from rig.extras.study.study import Study, StudySession
from rig.extras.study.trial_facts import FACTS, facts_of, unusable
from rig.extras.study.trials import trials_of
from rig.recording.data import Recording
from rig.recording.files import whole_directory
from rig.recording.header import checkout
from rig.recording.reader import open_recording
from rig.session.finished import END, distinct_names

BIDS_VERSION = "1.10.0"
SHIFTED_TO = datetime(1925, 1, 1, tzinfo=UTC)  # BIDS: shifted dates are in 1925 or earlier
_STEM = f"task-{TASK}_tracksys-{TRACKSYS}"

Watch = Callable[[int, int], None]
Row = Mapping[str, Any]

_TAKEN = ("participant_id", "HED")  # BIDS gives these columns a content of their own
_EVENT_COLUMNS: Mapping[str, Mapping[str, Any]] = {
    "trial_type": {"LongName": "Kind of event", "Description": "what began", "Levels": dict(EVENTS)},
    "trial": {"Description": FACTS["trial"].meaning},
    "verdict": {
        "Description": FACTS["verdict"].meaning,
        "Levels": {
            "stable": "the wall stayed still",
            "buzz": "vibration of the wall could be felt or heard",
            "unstable": "the wall threw the hand back",
            "unsure": "the participant could not decide",
        },
    },
    "judged_by": {"Description": FACTS["judged_by"].meaning},
    "response_time": {"Description": FACTS["response_time"].meaning, "Units": "s"},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class BidsOptions:
    """Options of an export to BIDS.

    Attributes
    ----------
    every
        Keep only every n-th row of a recording; nothing is filtered. 1 keeps all rows.
    shift_dates
        Move the dates of each participant so that the first recording was made on 1 January 1925.
    authors, licence
        Authors and licence of the dataset.
    """

    every: int = 1
    shift_dates: bool = False
    authors: Sequence[str] = ()
    licence: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Dataset:
    """A written dataset: directory, number of participants and recordings, and a sentence for each trial left out."""

    directory: Path
    participants: int
    recordings: int
    left_out: tuple[str, ...]


def export_bids(
    study: Study, directory: Path, options: BidsOptions | None = None, watch: Watch | None = None
) -> Dataset:
    """Write a BIDS-motion dataset into a new directory, which appears only when it is complete.

    `watch` is called with the number of finished recordings and the total. Raise `ConfigError` if two participant codes
    are equal in BIDS or `every` is below 1; `RecordingError` if the directory exists, or a file cannot be read or
    written. Recordings that are missing or changed raise no error; they are listed in `Dataset.left_out`.
    """
    options = options or BidsOptions()
    if options.every < 1:
        raise ConfigError(
            f"every = {options.every} is not possible", remedy="give 1 (all rows) or n, for every n-th row"
        )
    labels = _labels(study)
    trials = [row for row in trials_of(study) if row.recorded != "none"]
    with whole_directory(directory) as draft:
        writer = _Writer(draft, options, watch, len(trials))
        for session in study.sessions:
            theirs = [row for row in trials if row.participant == session.code]
            writer.participant(session, theirs, labels[session.code])
        writer.dataset(study, labels)
    return Dataset(
        directory=directory,
        participants=len(study.sessions),
        recordings=writer.written,
        left_out=tuple(writer.left_out),
    )


def label_of(code: str) -> str:
    """Return a participant's BIDS label, the letters and digits of the code; raise `ConfigError` if it is empty."""
    label = re.sub(r"[^0-9A-Za-z]", "", code)
    if not label:
        raise ConfigError(
            f"participant code {code!r} is not possible in BIDS: it contains no letter A to Z and no digit",
            remedy="use a code of letters and digits",
        )
    return label


class _Writer:
    """Writer of one dataset; it counts the recordings and collects the trials that are left out."""

    def __init__(self, root: Path, options: BidsOptions, watch: Watch | None, total: int) -> None:
        self._root = root
        self._options = options
        self._watch = watch
        self._total = total
        self._seen = count(1)
        self.written = 0
        self.left_out: list[str] = []

    def participant(self, session: StudySession, trials: Iterable[TrialRow], label: str) -> None:
        name = f"sub-{label}"
        place = self._root / name / "motion"
        place.mkdir(parents=True)
        scans: list[Row] = []
        shift: timedelta | None = None
        devices = session.devices()
        for row in trials:
            problem = unusable(row)
            if problem is not None:
                self.left_out.append(problem)
            else:
                recording = open_recording(session.directory / row.recording)
                stem = f"{name}_{_STEM}_run-{row.trial:04d}"
                number = devices.get(row.trial, {}).get("serial_number")
                known = {"DeviceSerialNumber": number} if number else {}
                self._run(place, stem, session, row, recording, known)
                acquired = _acquisition_time(recording)
                if shift is None and acquired is not None:
                    shift = SHIFTED_TO - acquired.replace(hour=0, minute=0, second=0, microsecond=0)
                date = _date(acquired, shift if self._options.shift_dates else None)
                scans.append({"filename": f"motion/{stem}_motion.tsv", "acq_time": date, **facts_of(row)})
                self.written += 1
            if self._watch is not None:
                self._watch(next(self._seen), self._total)
        _write_table(self._root / name / f"{name}_scans.tsv", ("filename", "acq_time", *FACTS), scans)
        motion = session.state.experiment["rig"]["motion"]
        _write_json(self._root / name / f"{name}_scans.json", _scans_sidecar(motion))

    def _run(
        self, place: Path, stem: str, session: StudySession, trial: TrialRow, recording: Recording, known: Row
    ) -> None:
        every, protocol = self._options.every, session.state.protocol
        motion: Motion = recording.header["motion"]
        columns = bids_motion.channels(motion, recording.experiment["controller"]["estimator"])
        extra = {
            "TaskDescription": "A hit against a virtual wall, rendered by a motor on the handle, in the search for "
            "the stiffest stable wall.",
            "Instructions": protocol.trial.say,
            "Recording": {"file": trial.recording, "sha256": trial.sha256},
            **known,
        }
        _write_json(place / f"{stem}_motion.json", bids_motion.sidecar(recording, columns, every, extra))
        with open(place / f"{stem}_motion.tsv", "wb") as file:
            bids_motion.write_motion(file, recording, columns, every)
        _write_table(place / f"{stem}_channels.tsv", tuple(columns[0].as_row()), _channel_rows(columns))
        _write_table(
            place / f"{stem}_events.tsv", ("onset", "duration", *_EVENT_COLUMNS), _events(trial, recording)
        )

    def dataset(self, study: Study, labels: Mapping[str, str]) -> None:
        described: dict[str, Any] = {
            "Name": study.protocol.study.title,
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "haptic-rig", "Version": _version()}],
        }
        if self._options.authors:
            described["Authors"] = list(self._options.authors)
        if self._options.licence:
            described["License"] = self._options.licence
        _write_json(self._root / "dataset_description.json", described)
        (self._root / "README.md").write_text(_readme(study, self._options), encoding="utf-8")
        columns, rows, sidecar = _participants(study, labels)
        _write_table(self._root / "participants.tsv", columns, rows)
        _write_json(self._root / "participants.json", sidecar)
        _write_json(self._root / f"{_STEM}_channels.json", bids_motion.frame(study.motion))
        _write_json(
            self._root / f"{_STEM}_events.json",
            {
                **_EVENT_COLUMNS,
                "StimulusPresentation": {"SoftwareName": "haptic-rig", "SoftwareVersion": _version()},
            },
        )


def _labels(study: Study) -> dict[str, str]:
    codes = [session.code for session in study.sessions]
    return distinct_names(codes, label_of, "BIDS keeps only letters and digits")


def _scans_sidecar(motion: Motion) -> Row:
    described = {
        name: {"Description": one.meaning}
        | ({"Units": bids_motion.unit(unit_of(one.unit, motion))} if one.unit else {})
        for name, one in FACTS.items()
    }
    return {"acq_time": {"Description": "when the recording began, in UTC"}, **described}


def _events(trial: TrialRow, recording: Recording) -> list[Row]:
    rows: list[Row] = [
        {"onset": f"{onset:.6f}", "duration": f"{duration:.6f}", "trial_type": kind, "trial": trial.trial}
        for kind, onset, duration in bids_motion.spans(recording)
    ]
    if trial.verdict:
        rows.append(
            {
                "onset": f"{float(recording.time_s[-1]):.6f}",
                "duration": 0,
                "trial_type": "verdict",
                **{name: value for name, value in facts_of(trial).items() if name in _EVENT_COLUMNS},
            }
        )
    return rows


def _channel_rows(columns: Iterable[Channel]) -> list[Row]:
    return [channel.as_row() for channel in columns]


def _participants(study: Study, labels: Mapping[str, str]) -> tuple[tuple[str, ...], list[Row], Row]:
    own = {
        "code": {"Description": "as in the study's own files"},
        "row": {"Description": "row of the order of conditions, from 0"},
        "simulated": {"Description": "1 where a simulated person took part (a rehearsal)"},
        "trials": {"Description": "number of recorded trials of any kind"},
        "ended": {"Description": "how the session ended"},
    }
    answers: dict[str, dict[str, Any]] = {}
    rows: list[Row] = []
    for session in study.sessions:
        state = session.state
        row: dict[str, Any] = {
            "participant_id": f"sub-{labels[session.code]}",
            "code": session.code,
            "row": state.row,
            "simulated": state.rehearsal is not None,
            "trials": len(state.trials),
            "ended": state.ended or state.stopped or "not ended",
        }
        items = {item.name: item for item in state.protocol.question}
        for (name, block), answer in state.answered.items():
            item = items.get(name)
            column = name if block in {0, END} else f"{name}_block{block}"
            while column in own or column in _TAKEN:
                column += "_answer"
            answers.setdefault(column, {"Description": item.text if item else name})
            if item is not None and item.kind == "scale":
                answers[column]["Minimum"], answers[column]["Maximum"] = item.lowest, item.highest
            row[column] = answer
        rows.append(row)
    return ("participant_id", *own, *answers), rows, {**own, **answers}


def _readme(study: Study, options: BidsOptions) -> str:
    lines = [
        f"# {' '.join(study.protocol.study.title.split())}",
        "",
        "Hits against virtual walls on a haptic rig with one degree of freedom, in a search for the stiffest "
        "stable wall (Z-width). One run of the task `wallhit` is one trial: the motor brings the handle to its start, "
        "the wall is switched on, the handle hits it, and a person or the program judges whether the wall was stable.",
        "",
        "Each participant's `_scans.tsv` contains the wall of each run (condition, stiffness, damping) and the "
        "verdicts; each run's `_events.tsv` contains the times of events within it. Positions and efforts are those "
        "that the rig's device measured and applied in each tick of its control loop"
        + (f"; only every {options.every}th tick is included, unfiltered." if options.every > 1 else "."),
        "",
        "Runs that do not count (practice, redone, of a restarted block) are included; the column "
        "`counts` is 0 for them.",
    ]
    if study.rehearsed:
        lines += ["", "The participants were simulated: no person moved the handle or judged a wall."]
    if options.shift_dates:
        lines += ["", "Dates are shifted by whole days so that each participant begins on 1 January 1925."]
    return "\n".join(lines) + "\n"


def _acquisition_time(recording: Recording) -> datetime | None:
    try:
        return datetime.fromisoformat(str(recording.header.get("created"))).astimezone(UTC)
    except ValueError:
        return None


def _date(acquired: datetime | None, shift: timedelta | None) -> str | None:
    if acquired is None:
        return None
    return (acquired + (shift or timedelta())).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _cell(value: Any) -> str:
    if value is None or value == "":
        return MISSING
    if isinstance(value, bool):
        return str(int(value))
    return " ".join(str(value).split()) or MISSING


def _write_table(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    lines = ["\t".join(columns), *("\t".join(_cell(row.get(name)) for name in columns) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_json(path: Path, content: Row) -> None:
    path.write_text(
        json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n", encoding="utf-8"
    )


def _version() -> str:
    try:
        return " ".join([version("haptic-rig"), *(f"({name} {text})" for name, text in checkout().items())])
    except PackageNotFoundError:
        return "not installed"
