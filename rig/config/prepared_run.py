"""Data of a run that is prepared for one device: controller, device parameters and law on the device.

`rig.config.controller.prepare_controller` creates it. Trials, hits and motions of `rig.experiments` execute it without
depending on how a law or a device's parameters are computed. This file must not import `rig.config.controller`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from firmware_protocol.parameter import Value
from rig.config._sections import Experiment
from rig.control.step import ControllerState


@dataclass(frozen=True, slots=True, kw_only=True)
class LawOnDevice:
    """The law of a run that the device executes instead of the host.

    Attributes
    ----------
    arithmetic
        Arithmetic of the law on the device.
    currents_compared
        True if the measured current is compared with the commanded current of the same tick. False if a drive renders
        the wall: its current changes within a tick, and it reports one value.
    live
        Function that converts a changed wall (position, then parameters of the law) to the device's parameters; raises
        `PlanError` for a wall that is out of range.
    rendered
        Function that returns stiffness, damping and position of the rendered wall in SI, from the device's active
        parameters.
    """

    arithmetic: str
    currents_compared: bool
    live: Callable[[Sequence[float]], Mapping[str, Value]]
    rendered: Callable[[Mapping[str, Value]], Mapping[str, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRun:
    """A run that is prepared for one device.

    Attributes
    ----------
    experiment
        The experiment to run.
    current_quantum_a, reference_count
        Current quantum of the device (A), and the encoder count at position zero.
    controller
        Initial state of the host's controller; a trial runs on a copy.
    parameters
        Parameters of the device, by name.
    own_law
        True if the caller gave the law as an object; False if the experiment names the law.
    on_device
        Law on the device; None if the host runs the law.
    """

    experiment: Experiment
    current_quantum_a: float
    reference_count: int
    controller: ControllerState
    parameters: Mapping[str, Value]
    own_law: bool
    on_device: LawOnDevice | None
