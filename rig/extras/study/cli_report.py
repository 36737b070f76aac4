"""Draw the pictures and write the HTML report of a study, for `rig session analyse`."""

from collections.abc import Callable
from pathlib import Path

from rig.cli import output
from rig.extras.study import StudyAnalysis
from rig.extras.study.plots import draw_study
from rig.extras.study.report import write_session_report
from rig.recording.files import plain_errors

PICTURES = "pictures"


def write_report(
    found: StudyAnalysis, directory: Path, ending: str, watch: Callable[[str, int, int], None]
) -> tuple[dict[str, Path], Path]:
    """Draw all pictures and write the report; return the paths of the pictures by name, and the path of the report.

    Each picture is written as PNG, which the report contains, and in the format `ending`. Raises `RecordingError` if a
    file cannot be written.
    """
    place = directory / PICTURES
    with plain_errors("make", place):
        place.mkdir(parents=True, exist_ok=True)
    drawn = draw_study(
        found,
        place,
        ("png", ending),
        watch=lambda done, total: watch("pictures drawn", done, total),
        on_failure=output.no_picture,
    )
    pngs = {path.stem: path.read_bytes() for path in drawn.values() if path.suffix == ".png"}
    page, _ = write_session_report(found, pngs, directory)
    return drawn, page
