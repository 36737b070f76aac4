"""Data of a run that is prepared for one device, which a trial executes.

`rig.config.controller.prepare_controller` makes it; its users do not depend on how a law or a device's parameters are
designed.

Trials, hits and motions of `rig.experiments` receive it. It must not import `rig.config.controller`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from firmware_protocol.parameter import Value
from rig.config._sections import Experiment
from rig.control.step import ControllerState


@dataclass(frozen=True, slots=True, kw_only=True)
class LawOnDevice:
    """Law of a run on the device.

    Attributes
    ----------
    arithmetic
        Arithmetic of the law on the device.
    currents_compared
        True if the measured current is compared with the active one. False if a drive renders the wall: its current
        changes within a tick, and it reports one value.
    live
        Function that converts a parameter set from the loop's mailbox to the device's parameters for another wall;
        raises `PlanError` for a wall that is out of range.
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
    """Run that is prepared for one device.

    Attributes
    ----------
    experiment
        Experiment that is in effect.
    current_quantum_a, reference_count
        Current quantum of the device (A), and its count at position zero.
    controller
        Controller of the host before the first sample; a copy of it is executed.
    parameters
        Parameters of the device.
    own_law
        True if the caller gave the law object, instead of the name in the experiment.
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
