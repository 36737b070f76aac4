"""A reproduction as one HTML page: pictures inline, numbers as JSON in a script tag, nothing fetched from anywhere."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from rig.papers.frame import Reproduction, Status
from rig.recording.files import whole_file
from rig.views.report.template import data_uris, fill, provenance_lines

TEMPLATE = "reproduction.html.j2"
MARKS = {Status.REPRODUCED: "yes", Status.ONLY_WITH: "only", Status.NOT: "no"}  # classes of the style sheet


def render(reproduction: Reproduction, pictures: Mapping[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    reproduction
        What it tells.
    pictures
        PNGs by name; one that a section names and that is not there is told of instead of shown.
    """
    return fill(
        TEMPLATE,
        reproduction=reproduction,
        marks=MARKS,
        pictures=data_uris(pictures),
        provenance=provenance_lines(reproduction.provenance),
        data=reproduction.as_mapping(),
    )


def write_report(
    reproduction: Reproduction, pictures: Mapping[str, bytes], directory: Path
) -> tuple[Path, Path]:
    """Write the page and its numbers into a directory; returns both paths.

    Raises
    ------
    RecordingError
        The disk refuses.
    """
    page = render(reproduction, pictures).encode()
    numbers = json.dumps(reproduction.as_mapping(), ensure_ascii=False, allow_nan=False, indent=1).encode()
    paths = directory / f"{reproduction.name}.html", directory / f"{reproduction.name}.json"
    for path, content in zip(paths, (page, numbers), strict=True):
        with whole_file(path, overwrite=True) as file:
            file.write(content)
    return paths
