"""Write the controller that `rig design` found as one HTML page: wishes, search, [controller] section, margins."""

from pathlib import Path

from rig.experiments.design import RULES, Design
from rig.recording.files import whole_file
from rig.views.report import data_uris, fill

TEMPLATE, PAGE = "design.html.j2", "design.html"


def render(found: Design, command: str, picture: bytes | None) -> str:
    """Return as HTML the page about a designed controller: `command` computed it, `picture` is a PNG or missing."""
    return fill(
        TEMPLATE,
        found=found,
        command=command,
        rules=RULES,
        pictures=data_uris({} if picture is None else {"design": picture}),
        data=found.as_mapping(),
    )


def write_design_report(found: Design, command: str, picture: bytes | None, directory: Path) -> Path:
    """Write the HTML page about a designed controller and return its path; raise `RecordingError` if this fails."""
    path = directory / PAGE
    with whole_file(path, overwrite=True) as file:
        file.write(render(found, command, picture).encode())
    return path
