"""From a controller to the law that a device runs itself: the same designs, scaled to counts, periods and quanta.

`rig.control.step` runs in SI and float64 on a host. A device runs the same law, tick for tick, in integers or in
float32 (firmware/law): lengths are counts there, velocities counts per velocity period, currents quanta, times ticks.
Everything is designed and scaled here, once, and leaves as values of `firmware_protocol.law_parameters`. The
preparation of a run, its plan and the export of an estimator call it; it sends nothing. What the device lacks is
refused with `PlanError` (`rig.control.on_device`), and `check_values` alone decides whether a value fits its parameter.
"""

from __future__ import annotations

from rig.config.device_law._batch import batch_layout, batch_samples, bytes_per_second
from rig.config.device_law._elsewhere import wall_elsewhere
from rig.config.device_law._parameters import (
    ARITHMETICS,
    Arithmetic,
    arithmetic_of,
    check_values,
    law_parameters,
    live_parameters,
    rendered_wall,
)

__all__ = [
    "ARITHMETICS",
    "Arithmetic",
    "arithmetic_of",
    "batch_layout",
    "batch_samples",
    "bytes_per_second",
    "check_values",
    "law_parameters",
    "live_parameters",
    "rendered_wall",
    "wall_elsewhere",
]
