"""New parameters for a loop that runs: from the mailbox, between two ticks, never with the hand in the wall.

A jump of stiffness, damping or place under a pressed handle is a jump of effort. So a set waits until the handle is
outside the wall that is and outside the wall that will be; a newer set takes its place meanwhile. Each set that came
in force is kept with its tick, so that a replay can do the same.
"""

from __future__ import annotations

from typing import Any

from numba import types

from rig.control.estimators.fdm import count_difference
from rig.control.step import CONTROL_TYPE
from rig.loop.layout import FLOAT_ROWS, FLOATS, PROGRESS_TYPE, WORD
from rig.realtime import ring
from rig.realtime.atomics import store_word
from rig.realtime.kernel import kernel
from rig.realtime.mailbox import take


@kernel(types.boolean(CONTROL_TYPE, types.float64, types.int64))
def inside(control: Any, wall_position: float, count: int) -> bool:
    """Whether a count lies inside a wall at a position."""
    c = control[0]
    position = c["resolution"] * count_difference(count, c["reference_count"])
    return bool(c["wall_side"] * (position - wall_position) > 0.0)


@kernel(types.void(CONTROL_TYPE, FLOATS, FLOATS))
def put_in_force(control: Any, law_parameters: Any, values: Any) -> None:
    """Make a parameter set that of the law: `values` are the wall's position and the law's parameters."""
    control[0]["wall_position"] = values[0]
    for i in range(len(law_parameters)):
        law_parameters[i] = values[1 + i]


@kernel(
    types.void(CONTROL_TYPE, FLOATS, FLOATS, FLOAT_ROWS, PROGRESS_TYPE, types.int64, types.uintp),
)
def begin_set(
    control: Any, law_parameters: Any, waiting: Any, sets: Any, progress: Any, tick: int, words: int
) -> None:
    """Put the set that waits in force from this tick on, and keep it for a replay."""
    p = progress[0]
    put_in_force(control, law_parameters, waiting)
    row = sets[p["sets"]]
    row[0] = p["waiting_set"]
    row[1] = tick
    for i in range(len(waiting)):
        row[2 + i] = waiting[i]
    p["sets"] += 1
    p["parameter_set"] = p["waiting_set"]
    p["waiting_set"] = 0
    store_word(words + WORD * ring.PARAMETER_SET, p["parameter_set"])


@kernel(
    types.void(
        types.uintp,
        CONTROL_TYPE,
        FLOATS,
        FLOATS,
        FLOAT_ROWS,
        PROGRESS_TYPE,
        types.int64,
        types.int64,
        types.uintp,
    )
)
def renew_parameters(
    mailbox: int, control: Any, law_parameters: Any, waiting: Any, sets: Any, progress: Any, count: int, tick: int,
    words: int,
) -> None:  # fmt: skip
    """Look into the mailbox, and put what waits in force if the handle is in free space.

    Parameters
    ----------
    mailbox
        Address of a `rig.realtime.mailbox`, or 0 for a loop without one.
    control, law_parameters
        What `rig.control.step` reads, changed in place.
    waiting, sets, progress
        Of `rig.loop.layout.Buffers`.
    count
        Encoder count of this tick.
    tick
        Its number.
    words
        Address of the ring's control words.
    """
    if mailbox == 0:
        return
    p = progress[0]
    number = take(mailbox, waiting)
    if number > 0:
        p["waiting_set"] = number
    if p["waiting_set"] == 0 or p["sets"] == len(sets):
        return
    if inside(control, control[0]["wall_position"], count) or inside(control, waiting[0], count):
        return
    begin_set(control, law_parameters, waiting, sets, progress, tick, words)
