"""Pictures and page of a study, as `rig session analyse` writes them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rig.core.errors import ConfigError
from rig.recording.files import plain_errors
from rig.session.analysis import Analysis
from rig.views.plots.session import draw_session
from rig.views.report.session import write_session_report
from rig.views.report.template import check_installed

PICTURES = "pictures"


def write_report(
    found: Analysis, directory: Path, watch: Callable[[str, int, int], None]
) -> tuple[dict[str, Path], Path | None, str]:
    """Draw all pictures, and print the page where that is possible.

    Returns
    -------
    tuple
        Paths of the pictures by name; path of the page, None without jinja2; and then what to do about it.

    Raises
    ------
    RecordingError
        The disk refuses.
    """
    place = directory / PICTURES
    with plain_errors("make", place):
        place.mkdir(parents=True, exist_ok=True)
    drawn = draw_session(found, place, watch=lambda done, total: watch("pictures drawn", done, total))
    try:
        check_installed()
    except ConfigError as error:
        return drawn, None, f"{error.message}: {error.remedy}"
    pngs = {path.stem: path.read_bytes() for path in drawn.values() if path.suffix == ".png"}
    page, _ = write_session_report(found, pngs, directory)
    return drawn, page, ""
