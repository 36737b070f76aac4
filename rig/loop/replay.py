"""Replay: compute the law again on the rows of a recording, without a link.

`rig.experiments.trials.replay` and the comparison of schemes call it. It must compute a row exactly as the loop does.
"""

from typing import Any

import numpy as np
from numba import types

from rig.control.step import CONTROLLER_TYPE, ControllerArguments, step
from rig.core.sample import RowFlag
from rig.loop._parameters import activate
from rig.loop._rows import show_law
from rig.loop.layout import ROWS_TYPE
from rig.realtime.kernel import kernel

_LOOPS = int(  # noticed by the loop, not by the law
    RowFlag.LATE | RowFlag.GAP | RowFlag.CURRENT_FOLLOWS | RowFlag.CURRENT_DIFFERS | RowFlag.OTHER_CURRENT
)

NO_SETS = np.zeros((0, 1))  # for a run without parameter updates


@kernel(types.void(CONTROLLER_TYPE, ROWS_TYPE, ROWS_TYPE, types.float64[:, ::1]))
def replay_rows(controller: ControllerArguments, recorded: Any, replayed: Any, sets: Any) -> None:
    """Run the law (`rig.control.step.step`) on each row of `recorded`, and write the results into `replayed`.

    Each row of `sets` is a parameter set that became active during the run: first tick, wall position (rad or m), and
    the law's parameters.
    """
    due = 0
    for i in range(len(recorded)):
        source = recorded[i]
        while due < len(sets) and sets[due, 0] <= source["tick"]:
            activate(controller, sets[due, 1:])
            due += 1
        step(
            controller,
            source["count"],
            source["edge_age"] * 1e-9,
            source["elapsed_ticks"],
            source["current_applied"],
        )
        show_law(replayed, i, controller.memory)
        replayed[i]["flags"] |= source["flags"] & _LOOPS
