"""Parameter updates of a running loop: the loop takes a new set from a mailbox and activates it between two ticks.

A new parameter set waits until the handle is outside both the present and the new wall; a newer set replaces a waiting
one. Each set that became active is stored with its first tick, for the replay. Both loops and the replay call it. A
wall must not change while the handle is inside.
"""

from typing import Any

from numba import types

from rig.control.step import CONTROL_TYPE, CONTROLLER_TYPE, ControllerArguments, count_difference
from rig.loop.layout import BUFFERS_TYPE, FLOATS, SHARED_TYPE, WORD, Buffers, SharedRing
from rig.realtime import control_words
from rig.realtime.atomics import store_word
from rig.realtime.codec import STATE
from rig.realtime.kernel import kernel
from rig.realtime.mailbox import take


@kernel(types.boolean(CONTROL_TYPE, types.float64, types.int64))
def inside(control: Any, wall_position: float, count: int) -> bool:
    """Return True if the encoder count `count` lies inside a wall whose surface is at `wall_position` (rad or m)."""
    c = control[0]
    position = c["resolution"] * count_difference(count, c["reference_count"])
    return bool(c["wall_side"] * (position - wall_position) > 0.0)


@kernel(types.void(CONTROLLER_TYPE, FLOATS))
def activate(controller: ControllerArguments, values: Any) -> None:
    """Copy a parameter set into the law: `values` are the wall's position (rad or m) and the law's parameters."""
    controller.control[0]["wall_position"] = values[0]
    for i in range(len(controller.law_parameters)):
        controller.law_parameters[i] = values[1 + i]


@kernel(types.void(CONTROLLER_TYPE, BUFFERS_TYPE, types.int64, types.uintp))
def begin_set(controller: ControllerArguments, buffers: Buffers, tick: int, words: int) -> None:
    """Activate the waiting parameter set from tick `tick` on; store it for a replay, and its number in the ring."""
    p, waiting = buffers.progress[0], buffers.waiting
    activate(controller, waiting)
    row = buffers.sets[p["sets"]]
    row[0] = p["waiting_set"]
    row[1] = tick
    for i in range(len(waiting)):
        row[2 + i] = waiting[i]
    p["sets"] += 1
    p["parameter_set"] = p["waiting_set"]
    p["waiting_set"] = 0
    store_word(words + WORD * control_words.PARAMETER_SET, p["parameter_set"])


@kernel(types.void(CONTROLLER_TYPE, SHARED_TYPE, BUFFERS_TYPE, types.int64))
def renew_parameters(
    controller: ControllerArguments, shared: SharedRing, buffers: Buffers, tick: int
) -> None:
    """Take a new parameter set from the mailbox; activate it from the tick `tick` on if the handle is in free space."""
    if shared.mailbox == 0:
        return
    p, waiting, control = buffers.progress[0], buffers.waiting, controller.control
    number = take(shared.mailbox, buffers.mail)
    if number > 0:
        p["waiting_set"] = number
    if p["waiting_set"] == 0 or p["sets"] == len(buffers.sets):
        return
    # Inside the wall, a step of stiffness, damping or position would be a step of effort.
    count = buffers.state[STATE.count]
    if inside(control, control[0]["wall_position"], count) or inside(control, waiting[0], count):
        return
    begin_set(controller, buffers, tick, shared.words)
