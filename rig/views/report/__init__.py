"""Write reports as a single HTML file without external references, for phone, print, mail and archive.

Commands and extras fill their own templates with `fill` and `fill_text`; the filters of `_writing` format the numbers.
This package must not import a result: the template of the command contains the text about the result.
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
