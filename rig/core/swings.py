"""When a wall that beats ends a run, unless an experiment says otherwise: the defaults of `rig.control.watch`.

Here and not beside the compiled code, so that whoever only reads or writes an experiment loads none.
"""

from __future__ import annotations

SWINGS, SWING_S = 10, 0.02  # in a row, each within this time of the one before (s)
