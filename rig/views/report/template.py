"""Filling templates: pages and texts in jinja2, one style sheet, nothing fetched from anywhere.

A template is a file ending in ``.j2``, named by its path in the package. It has the words, the result that it is given
has the numbers, and the filters here write them: a text is edited without touching Python. A name that a template
calls for and does not get is an error. What ends in ``.html.j2`` is escaped.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from rig.core.deferred import jinja2, markupsafe

STYLE_SHEET = "views/report/page.css"


def fill(template: str, **values: Any) -> str:
    """Return the text of a template.

    Parameters
    ----------
    template
        Path of a file below ``rig``, like ``views/report/page.html.j2``.
    values
        What it calls for; `css` is there already.
    """
    text: str = environment().get_template(template).render(values)
    return text


@cache
def environment() -> Any:
    """Loader, filters and rules of all templates."""
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("rig", "."),
        autoescape=jinja2.select_autoescape(("html.j2",), default=False),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    css = files("rig").joinpath(STYLE_SHEET).read_text(encoding="utf-8")
    made.globals |= {"css": markupsafe.Markup(css), "each": each}
    made.filters |= FILTERS
    return made


def each(items: Iterable[Any], between: str = "; ", *, caller: Callable[..., str]) -> str:
    """Join what a call block writes of each item: ``{% call(name, value) each(some.items()) %}…{% endcall %}``."""
    written = [caller(*item) if isinstance(item, tuple) else caller(item) for item in items]
    return type(written[0])(between).join(text.strip() for text in written) if written else ""


# --- numbers as a text has them --------------------------------------------------------------------------------


def shown(value: float | None, digits: int = 3) -> str:
    """Return a number with three significant digits, or so many; an en dash when there is none."""
    if value is None or not math.isfinite(value):
        return "∞" if value == math.inf else "–"
    if value != 0.0 and 1.0 <= abs(value) < 10.0**6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{decimals}f}"
    return f"{value:.{digits}g}"


def plainly(value: float, digits: int = 6) -> str:
    """Return a number that somebody chose, without trailing zeros."""
    return f"{value:.{digits}g}"


def limit(value: float, capped: object) -> str:
    """Return a limit; ``≥`` when the search ended before the wall did."""
    return f"{'≥ ' if capped else ''}{shown(value)}"


def times(ratio: float | None) -> str:
    """Return a ratio, like ``× 1.25``."""
    return f"× {shown(ratio)}"


def percent(share: float) -> str:
    """Return a share, like ``12 %``."""
    return f"{100 * share:.0f} %"


def step(ratio: float) -> str:
    """Return how far two values of a ratio are apart, like ``1.5 %``."""
    return f"{100 * (ratio - 1):.2g} %"


def change(ratio: float) -> str:
    """Return a ratio as a change, like ``-12 %``."""
    return f"{100 * (ratio - 1):+.0f} %" if math.isfinite(ratio) else "from nothing"


def khz(rate_hz: float) -> str:
    """Return a rate, like ``20 kHz``."""
    return f"{rate_hz / 1e3:g} kHz"


def cell(value: Any) -> str:
    """Return what stands in a cell of a table: a number with three digits, anything else as it is."""
    number = isinstance(value, float) or value is None
    return shown(value) if number else value  # a Markup stays one


FILTERS: Mapping[str, Callable[..., str]] = {
    "n": shown, "g": plainly, "limit": limit, "times": times, "percent": percent, "step": step, "change": change,
    "khz": khz, "cell": cell,
}  # fmt: skip

# --- what every page has -----------------------------------------------------------------------------------------


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
