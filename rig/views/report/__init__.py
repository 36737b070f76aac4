"""Reports: one HTML file that holds everything, to be read on a phone, printed, mailed and kept for years.

Commands and extras fill their own templates with `fill` and `fill_text`, and write numbers as the templates do. This
package must not import a result: what a page says of it stands in the template of who reports it.
"""

from rig.views.report._template import data_uris, fill, fill_text, provenance_lines
from rig.views.report._writing import (
    MINUS,
    NOTHING,
    clock,
    counted,
    interval,
    number,
    p,
    percent,
    shortest,
    signed,
)

__all__ = [
    "MINUS",
    "NOTHING",
    "clock",
    "counted",
    "data_uris",
    "fill",
    "fill_text",
    "interval",
    "number",
    "p",
    "percent",
    "provenance_lines",
    "shortest",
    "signed",
]
