"""Numbers of an estimator and of a wall in the form of a device: those of the host's kernels, scaled and rounded.

`rig.config.device_law` makes a device's parameters from them, a program for one's own board takes the estimator alone.
Nothing here reads an experiment or knows how values travel; what a device lacks raises `NotOnDeviceError`.
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
