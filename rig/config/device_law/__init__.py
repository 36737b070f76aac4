"""Convert the host's controller to the parameters of a law that the device runs itself.

`rig.control.step` runs in SI and float64 on the host. A device runs the same law tick by tick in integers or in float32
(firmware/law): lengths are in counts, velocities in counts per velocity period, currents in quanta, times in ticks.
This package scales everything to values of `firmware_protocol.law_parameters`. The preparation of a run, its plan and
the export of an estimator call it; it sends nothing. Features that the device lacks are refused with `PlanError`
(`rig.control.on_device`); only `check_values` decides whether a value is in the range of its parameter.
"""

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
