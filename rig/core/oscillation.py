"""Defaults of the watch on violent walls (`rig.control.watch`): how many oscillations in a row end a run.

Here and not beside the compiled code, so that a program that only reads or writes an experiment loads no kernels.
"""

from __future__ import annotations

OSCILLATIONS, OSCILLATION_S = 10, 0.02  # in a row, each within this time of the one before (s)
