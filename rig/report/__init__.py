"""Reports: one HTML file that holds everything, to be read on a phone, printed, mailed and kept for years."""

from rig.report.page import render, write_report

__all__ = ["render", "write_report"]
