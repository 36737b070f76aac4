"""A run, prepared for one device: what a trial executes.

Data alone. `rig.config.controller.prepare_controller` makes it; its users need not know how a law or a device's
parameters are designed.

Trials, hits and motions of `rig.experiments` receive it. It must not import what makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from firmware_protocol.parameter import Value
from rig.config._sections import Experiment
from rig.control.step import ControllerState


@dataclass(frozen=True, slots=True, kw_only=True)
class LawOnDevice:
    """The law of a run as the device computes it itself.

    Attributes
    ----------
    arithmetic
        Arithmetic of the law on the device.
    currents_compared
        True if its measured current is compared with the command. Not where a drive renders the wall: its current
        changes within a tick, and it reports one value.
    live
        Given a set of the loop's mailbox, the device's parameters that make another wall while the law runs; raises
        `PlanError` for a wall that does not fit.
    rendered
        Given the device's active parameters, stiffness, damping and position of the wall that it renders, in SI.
    """

    arithmetic: str
    currents_compared: bool
    live: Callable[[Sequence[float]], Mapping[str, Value]]
    rendered: Callable[[Mapping[str, Value]], Mapping[str, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedRun:
    """A run, prepared for one device.

    Attributes
    ----------
    experiment
        In effect.
    current_quantum_a, reference_count
        Current quantum of the device (A), and its count at position zero.
    controller
        The host's law before the first sample: numbers, and rows of the tables that name its kernels. A copy of it is
        executed.
    parameters
        Parameters of the device.
    own_law
        A law of the caller's own, in place of the one that the experiment names.
    on_device
        The law as the device computes it; None where the host runs it.
    """

    experiment: Experiment
    current_quantum_a: float
    reference_count: int
    controller: ControllerState
    parameters: Mapping[str, Value]
    own_law: bool
    on_device: LawOnDevice | None
