"""A reproduction as one HTML page: pictures inline, numbers as JSON in a script tag, nothing fetched from anywhere.

jinja2 fills the template and escapes all text; it comes with the extra ``haptic-rig[report]`` and is imported on use.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from rig.errors import ConfigError
from rig.recording.files import whole_file
from rig.reproduce.frame import Reproduction, Status

TEMPLATE = "reproduction.html.j2"
MARKS = {Status.REPRODUCED: "yes", Status.ONLY_WITH: "only", Status.NOT: "no"}  # classes of the style sheet


def check_installed() -> None:
    """Raise `ConfigError` when jinja2 is missing: better before the work than after it."""
    _jinja2()


def render(reproduction: Reproduction, pictures: Mapping[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    reproduction
        What it tells.
    pictures
        PNGs by name; one that a section names and that is not there is told of instead of shown.

    Raises
    ------
    ConfigError
        jinja2 is not installed.
    """
    jinja2 = _jinja2()
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(files("rig.report").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    page: str = template.render(
        reproduction=reproduction,
        marks=MARKS,
        pictures={name: _data_uri(picture) for name, picture in pictures.items()},
        provenance=_lines(reproduction.provenance),
        data=reproduction.as_mapping(),
    )
    return page


def write_report(
    reproduction: Reproduction, pictures: Mapping[str, bytes], directory: Path
) -> tuple[Path, Path]:
    """Write the page and its numbers into a directory; returns both paths.

    Raises
    ------
    ConfigError
        jinja2 is not installed.
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


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def _lines(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each entry; what has parts as JSON."""
    return [
        (name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
        for name, value in provenance.items()
    ]


def _jinja2() -> Any:
    try:
        import jinja2  # noqa: PLC0415  (an extra)
    except ImportError:
        raise ConfigError(
            "a report needs jinja2, which is not installed", remedy="pip install 'haptic-rig[report]'"
        ) from None
    return jinja2
