"""Filling a page's template: jinja2 escapes all text, one style sheet for all pages, nothing fetched from anywhere.

jinja2 comes with the extra ``haptic-rig[report]`` and is imported on use.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from rig.core.deferred import jinja2, markupsafe
from rig.core.errors import ConfigError
from rig.views.report.writing import FILTERS, FUNCTIONS

STYLE_SHEET = "page.css"


def check_installed() -> None:
    """Raise `ConfigError` when jinja2 is missing: better before the work than after it."""
    try:
        bool(jinja2.Environment)
    except ImportError:
        raise ConfigError(
            "a report needs jinja2, which is not installed", remedy="pip install 'haptic-rig[report]'"
        ) from None


def fill(template: str, **values: Any) -> str:
    """Return a page.

    Parameters
    ----------
    template
        Name of a file of this package; it may import macros of others.
    values
        What the template calls for; `css` is there already.

    Raises
    ------
    ConfigError
        jinja2 is not installed.
    """
    check_installed()
    css = markupsafe.Markup(_text(STYLE_SHEET))
    page: str = _environment(html=True).get_template(template).render(css=css, **values)
    return page


def fill_text(template: str, **values: Any) -> str:
    """Return plain text; as `fill`, but nothing is escaped."""
    check_installed()
    text: str = _environment(html=False).get_template(template).render(**values)
    return text


def _environment(*, html: bool) -> Any:
    environment = jinja2.Environment(
        autoescape=html,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(_text),
    )
    environment.filters |= FILTERS
    environment.globals |= FUNCTIONS
    return environment


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
    return files("rig.views.report").joinpath(name).read_text(encoding="utf-8")
