"""The law over recorded rows again: the loop without a link, for a replay."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from rig.control.step import CONTROL_TYPE, MEMORY_TYPE, step
from rig.core.sample import RowFlag
from rig.loop.layout import FLOAT_ROWS, ROWS_TYPE
from rig.loop.parameters import put_in_force
from rig.loop.rows import show_law
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR, LAW

_TIMING = int(RowFlag.LATE | RowFlag.GAP)  # noticed by the loop, not by the law

NO_SETS = np.zeros((0, 1))  # of a run whose parameters stayed as they were

_FLOATS, _INTS = types.float64[::1], types.int64[::1]


@kernel(
    types.void(
        ESTIMATOR, LAW, ROWS_TYPE, ROWS_TYPE, FLOAT_ROWS, CONTROL_TYPE, MEMORY_TYPE,
        _FLOATS, _INTS, _FLOATS, _FLOATS, _FLOATS,
    )
)  # fmt: skip
def replay_rows(
    estimator: Any, law: Any, recorded: Any, replayed: Any, sets: Any, control: Any, memory: Any,
    estimator_f: Any, estimator_i: Any, estimator_parameters: Any, law_state: Any, law_parameters: Any,
) -> None:  # fmt: skip
    """Run `step` over the samples of `recorded` and write what it computes into `replayed`.

    `sets` are the parameter sets that came in force on the way: first tick, wall position, the law's parameters.
    """
    due = 0
    for i in range(len(recorded)):
        source = recorded[i]
        while due < len(sets) and sets[due, 0] <= source["tick"]:
            put_in_force(control, law_parameters, sets[due, 1:])
            due += 1
        step(
            estimator, law, source["count"], source["edge_age"] * 1e-9, source["elapsed_ticks"], control, memory,
            estimator_f, estimator_i, estimator_parameters, law_state, law_parameters,
        )  # fmt: skip
        show_law(replayed, i, memory)
        replayed[i]["flags"] |= source["flags"] & _TIMING
