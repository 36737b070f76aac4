"""Filling templates: jinja2, one style sheet for all pages, nothing fetched from anywhere.

A template has the words, the result that it is given has the numbers, and the filters of `rig.views.report._writing`
write them: a text is edited without touching Python. A name that a template calls for and does not get is an error.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from rig.core.deferred import jinja2, markupsafe
from rig.views.report._writing import FILTERS, FUNCTIONS, TESTS

HERE = "views/report"
STYLE_SHEET = "page.css"


def fill(template: str, **values: Any) -> str:
    """Return a page; text that it is given is escaped.

    Parameters
    ----------
    template
        Name of a file of this folder, or a path below `rig` (``extras/papers/koul/page.html.j2``); it may extend others
        and import their macros.
    values
        Values that the template uses; `css` is added here.
    """
    page: str = _environment(html=True).get_template(template).render(**values)
    return page


def fill_text(template: str, **values: Any) -> str:
    """Return plain text; as `fill`, but nothing is escaped."""
    text: str = _environment(html=False).get_template(template).render(**values)
    return text


@cache
def _environment(*, html: bool) -> Any:
    environment = jinja2.Environment(
        autoescape=html,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(_text),
        finalize=None if html else _in_a_line,
    )
    environment.filters |= FILTERS
    environment.tests |= TESTS
    environment.globals |= {**FUNCTIONS, "css": markupsafe.Markup(_text(STYLE_SHEET))}
    return environment


def _in_a_line(value: Any) -> Any:
    """Return a text of the user's without line ends: in a plain text they part the lines of the template."""
    return value.replace("\n", " ") if isinstance(value, str) else value


def data_uris(pngs: Mapping[str, bytes]) -> dict[str, str]:
    """Return PNGs as addresses that hold them."""
    return {
        name: "data:image/png;base64," + base64.b64encode(png).decode("ascii") for name, png in pngs.items()
    }


def provenance_lines(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and value of each entry; what has parts as JSON."""
    return [
        (name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
        for name, value in provenance.items()
    ]


def _text(name: str) -> str:
    path = name if "/" in name else f"{HERE}/{name}"
    return files("rig").joinpath(path).read_text(encoding="utf-8")
