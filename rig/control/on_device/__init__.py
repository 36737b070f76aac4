"""Device parameters of an estimator and of a wall: parameters of the host's kernels, scaled and rounded.

`rig.config.device_law` combines them; a program for your own board may use the estimator's parameters only. Nothing
here reads an experiment or sends values. If the device does not have a law or an estimator, `NotOnDeviceError` is
raised.
"""

from rig.control.on_device._errors import ELSE_HOST, NotOnDeviceError, refusal
from rig.control.on_device._estimators import estimator_parameters, velocity_format
from rig.control.on_device._walls import (
    BILATERAL,
    Control,
    DeviceWall,
    Values,
    common_parameters,
    designed_wall,
    fixed_guard,
    fixed_wall,
    fixed_wall_in_si,
    float_guard,
    float_wall,
    float_wall_in_si,
    options,
)

__all__ = [
    "BILATERAL",
    "ELSE_HOST",
    "Control",
    "DeviceWall",
    "NotOnDeviceError",
    "Values",
    "common_parameters",
    "designed_wall",
    "estimator_parameters",
    "fixed_guard",
    "fixed_wall",
    "fixed_wall_in_si",
    "float_guard",
    "float_wall",
    "float_wall_in_si",
    "options",
    "refusal",
    "velocity_format",
]
