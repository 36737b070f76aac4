"""Fill jinja2 templates, with one style sheet for all pages; a page fetches nothing from the network.

A template contains the words, a result the numbers, and the filters of `rig.views.report._writing` format the numbers.
So a text can be edited without a change of Python code. A name that a template uses but does not receive is an error.
"""

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
    """Return a template filled with `values` and the style sheet as an HTML page; texts in the values are escaped.

    `template` is the name of a file in this folder, or a path below `rig` (``extras/papers/koul/page.html.j2``). It may
    extend other templates and import their macros.
    """
    page: str = _environment(html=True).get_template(template).render(**values)
    return page


def fill_text(template: str, **values: Any) -> str:
    """Return a template (a file in this folder or a path below `rig`) filled with values as plain text."""
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
    return value.replace("\n", " ") if isinstance(value, str) else value


def data_uris(pngs: Mapping[str, bytes]) -> dict[str, str]:
    """Return PNG images as ``data:`` URIs for an HTML page, by the image's name."""
    return {
        name: "data:image/png;base64," + base64.b64encode(png).decode("ascii") for name, png in pngs.items()
    }


def provenance_lines(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and value of each entry of the provenance (origin of a result) as text; mappings as JSON."""
    return [
        (name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))
        for name, value in provenance.items()
    ]


def _text(name: str) -> str:
    path = name if "/" in name else f"{HERE}/{name}"
    return files("rig").joinpath(path).read_text(encoding="utf-8")
