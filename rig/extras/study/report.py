"""Write a study as one HTML page for print: results, plan, deviations from the plan, and the methods.

The file contains everything: pictures inline, all numbers as JSON in the element ``numbers``. The text is in
``session.html.j2``.
"""

import hashlib
import json
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from rig import config
from rig.config import Experiment
from rig.core.present import plain
from rig.extras.study import report_tables as tables
from rig.extras.study.analyse import StudyAnalysis
from rig.extras.study.plots import tracks_name
from rig.extras.study.report_events import deviations, invalid_trials, notes
from rig.extras.study.report_methods import MEASURES, analysed_with, effective, first_experiment, methods
from rig.extras.study.study import LOG
from rig.recording.files import whole_file
from rig.views.report import data_uris, fill, provenance_lines

TEMPLATE = "extras/study/session.html.j2"
PAGE, NUMBERS = "report.html", "report.json"
_FIRST = 6  # differences in the summary


def render(found: StudyAnalysis, pictures: Mapping[str, bytes]) -> str:
    """Return the HTML page; `pictures` has PNG data by name, and the page states which pictures are missing."""
    model, _ = tables.first_contrasts(found)
    searched = {run.participant for run in found.runs}
    codes = [session.code for session in found.study.sessions if session.code in searched]
    return fill(
        TEMPLATE,
        found=found,
        tables=tables,
        measures=MEASURES,
        bounds=tables.BOUNDS,
        model=model,
        summarised=list(islice(tables.summarise_differences(found), _FIRST)),
        judged=first_experiment(found).verdict,
        track_names={code: tracks_name(code) for code in codes},
        deviations=deviations(found.study),
        invalid=invalid_trials(found.study),
        notes=notes(found.study),
        methods=methods(found),
        pictures=data_uris(pictures),
        provenance=provenance_lines(provenance(found)),
        numbers=numbers(found),
    )


def write_session_report(
    found: StudyAnalysis, pictures: Mapping[str, bytes], directory: Path
) -> tuple[Path, Path]:
    """Write the HTML page and a JSON file with its numbers into an existing directory; return both paths.

    Existing files are replaced. Raises `rig.core.errors.RecordingError` if a file cannot be written.
    """
    page = render(found, pictures).encode()
    data = json.dumps(numbers(found), ensure_ascii=False, allow_nan=False, indent=1).encode()
    paths = directory / PAGE, directory / NUMBERS
    for path, content in zip(paths, (page, data), strict=True):
        with whole_file(path, overwrite=True) as file:
            file.write(content)
    return paths


def numbers(found: StudyAnalysis) -> dict[str, Any]:
    """Return everything that the page reports, for JSON; numbers that are not finite become None."""
    report: dict[str, Any] = plain(
        {
            **found.as_mapping(),
            "methods": methods(found),
            "deviations": deviations(found.study),
            "invalid_trials": invalid_trials(found.study),
            "notes": notes(found.study),
            "provenance": provenance(found),
        }
    )
    return report


def provenance(found: StudyAnalysis) -> dict[str, Any]:
    """Return what the numbers come from: logs with their hashes, devices, versions, seeds, protocol, experiments."""
    sessions = found.study.sessions
    return {
        "logs": {
            session.code: {
                "events": len(session.events),
                "sha256": _sha256(session.directory / LOG),
                "protocol_sha256": session.began.get("protocol_sha256"),
            }
            for session in sessions
        },
        "devices": {
            session.code: [dict(event.content) for event in session.of_kind("opened")] for session in sessions
        },
        "versions of the sessions": {session.code: session.began.get("versions") for session in sessions},
        "versions of the analysis": analysed_with(),
        "seed of the study": found.study.protocol.study.seed,
        "seed of the bootstraps": found.options.seed,
        "protocol": sessions[0].began.get("protocol"),
        "experiment that the study changes": sessions[0].began.get("experiment"),
        "experiments": {
            name: config.as_mapping(x) if isinstance(x, Experiment) else {"not available here": x.message}
            for name, x in effective(found).items()
        },
    }


def _sha256(path: Path) -> str | None:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return None
