"""Define the error for each reason that ends a run: what happened, and what to do next (for `_trial`)."""

import os

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.faults import Fault
from rig.core.errors import (
    DeviceFaultError,
    GuardError,
    LawError,
    LinkLostError,
    OverrunError,
    RigError,
    StoppedError,
)
from rig.devices.device import failure
from rig.devices.framed import FaultReport
from rig.loop.interface import LoopEnd
from rig.loop.layout import EndReason

# Reason → error, what happened, what to do. In braces: url, why (errno), cause_of_loss and loss_remedy
# (`rig.devices._failures`), fault, fault_remedy, contradiction, cause (an exception), position and velocity of the last
# row, and the values in `watched` of `rig.loop._run.LoopEnd`.
ENDINGS: dict[EndReason, tuple[type[RigError], str, str]] = {
    EndReason.RUNNING: (StoppedError, "stopped before the loop had begun; the effort is zero", ""),
    EndReason.STOPPED: (StoppedError, "stopped{stopper}; the effort is zero", ""),
    EndReason.HEARTBEAT_MISSED: (
        StoppedError,
        "the supervising program sent no heartbeat, so the loop stopped; the effort is zero",
        "find what blocked the supervising program",
    ),
    EndReason.LINK_CLOSED: (
        LinkLostError,  # replaced by the class from `rig.devices._failures`
        "the link broke during the run: {url} {cause_of_loss} ({why}); the device cuts the effort by itself",
        "{loss_remedy}",
    ),
    EndReason.LINK_SILENT: (
        LinkLostError,
        "no more data from the device at {url} during the run; the device cuts the effort by itself",
        "check cable, power and the load of this computer: rig doctor --url {url} measures link and load",
    ),
    EndReason.LINK_DELAYED: (
        LinkLostError,
        "the link to {url} delayed commands beyond their lifetime; the effort went to zero",
        "check hub, cable and other traffic on the bus: rig doctor --url {url} measures the round trip",
    ),
    EndReason.DEVICE_FAULT: (DeviceFaultError, "device fault: {fault}", "{fault_remedy}"),
    EndReason.DEVICE_CONTRADICTS: (
        DeviceFaultError,
        "the device at {url} sends contradictory data: {contradiction}; the effort went to zero",
        "restart the device; if it happens again, check its power supply and update its firmware",
    ),
    EndReason.DEVICE_RESTARTED: (
        DeviceFaultError,
        "the device at {url} restarted during the run, so its position zero has changed; the effort is zero",
        "check its power supply and cables, put the handle at position zero, and start again",
    ),
    EndReason.NONFINITE: (
        LawError,
        "the law returned a value that is not finite; the effort went to zero",
        "check the law, the estimator and their parameters",
    ),
    EndReason.LAW_RAISED: (
        LawError,
        "the law raised {cause}; the effort went to zero",
        "correct the law: it must not raise an exception",
    ),
    EndReason.STUCK: (
        LawError,
        "the loop did not end after a stop request: the law or the estimator does not return; no "
        "more commands are sent, and the device cuts the effort by itself",
        "correct the law or the estimator so that it returns at once; then restart the program, in "
        "which this loop still runs",
    ),
    EndReason.DEVICE_ENDED: (
        GuardError,
        "the law on the device ended the run at position {position} with velocity {velocity} "
        "(window, speed limit or start), but the same law on the host, in other arithmetic, did not; "
        "the effort is zero",
        "check the wall, rig.limits and [homing]; see device_host_agreement in the recording's trailer",
    ),
    EndReason.OVERRUN: (
        OverrunError,
        'a tick was more than one period late, and host.overrun = "stop"; the effort went to zero',
        '{slower}reduce the load of this computer (rig doctor shows how), or set host.overrun = "skip"',
    ),
    EndReason.OUT_OF_WINDOW: (
        GuardError,
        "the handle left the position window or exceeded the speed limit, at position {position} with velocity "
        "{velocity}; the effort went to zero",
        "check the wall, the signs of motor and encoder, and rig.limits",
    ),
    EndReason.ENERGY: (
        GuardError,
        "the motor gave the handle {energy} J, more than rig.limits.energy = {energy_limit} J; the "
        "effort went to zero",
        "choose a softer or more damped wall, or raise rig.limits.energy if no hand is in danger",
    ),
    EndReason.VIOLENT: (
        GuardError,
        "the effort oscillated {oscillations} times in succession between zero and its limit, each "
        "within {oscillation_s} s of the one before: the number at which rig.limits.oscillations "
        "ends the run; the effort went to zero",
        "choose a softer or more damped wall; in an automated trial rig.limits.oscillations = 0 "
        "disables this check",
    ),
    EndReason.CURRENT_DIFFERS: (
        GuardError,
        "the measured current differed from the set current over 10 ms; the effort went to zero",
        "check, in this order, rig.amplifier.set_point_delay_s and lag_s against the amplifier, current_quantum_a "
        "against the steps of its set-point, motor leads, supply, and the current sensor with its sign and scale "
        "(current_monitor = false: nothing is measured)",
    ),
    EndReason.LIMIT_SWITCH: (
        GuardError,
        "the limit switch was pressed at position {position}, or its wire is broken; the effort went to zero",
        "move the handle back into its travel; if the switch is pressed within the position window, "
        "find the reference again (`rig device reference`); if the handle is not at the switch, "
        "repair its wire",
    ),
    EndReason.UNMOVED: (
        GuardError,
        "the encoder is dead or the handle is blocked: a free handle would have reached half of "
        "rig.limits.speed, but the count does not change at position {position}; the effort went to "
        "zero",
        "check the encoder and its wires, and that nothing holds the handle; if friction holds it, "
        "enter the friction in the experiment (`rig identify` measures it)",
    ),
    EndReason.HOMING_FAILED: (
        GuardError,
        "homing did not reach the start in time; the effort went to zero",
        "free the handle; if friction holds it, enter the friction in the experiment (`rig identify` "
        "measures it); `rig experiment plan` then shows the homing.stiffness and homing.effort that "
        "are needed",
    ),
}


# Reasons (as written in a trailer) after which the rig may have changed, so that a new torque pulse is needed.
IN_DOUBT = frozenset(
    reason.name.lower()
    for reason in (
        EndReason.DEVICE_FAULT,
        EndReason.DEVICE_CONTRADICTS,
        EndReason.DEVICE_RESTARTED,
        EndReason.CURRENT_DIFFERS,
        EndReason.UNMOVED,
    )
)


def error_of(end: LoopEnd, url: str, fault: FaultReport | None, rows: NDArray[np.void]) -> RigError | None:
    """Return the error for the end of a run; None if the run finished as planned.

    `fault` is the device's fault report, None if no report was received. A `LinkLostError` stores the last logged
    samples, `rows`.
    """
    if end.reason == EndReason.FINISHED:
        return None
    kind, message, remedy = ENDINGS[end.reason]
    # A device may report a fault NONE.
    named = fault if fault is not None and fault.code != Fault.NONE else None
    errno = end.counters["errno"]
    loss = failure(errno, url)
    if end.reason == EndReason.LINK_CLOSED:
        kind = loss.kind
    words = {
        "url": url,
        "why": os.strerror(errno) if errno else "no error number",
        "cause_of_loss": loss.cause,
        "loss_remedy": loss.remedy,
        "fault": named.text if named else "it did not report which",
        "fault_remedy": named.remedy if named else "read its fault log",
        "contradiction": end.contradiction,
        "stopper": end.stopper,
        "cause": repr(end.error),
        "position": f"{rows['position'][-1]:.4g}" if len(rows) else "?",
        "velocity": f"{rows['velocity'][-1]:.4g}" if len(rows) else "?",
        "slower": _slower(rows),
        **{name: f"{value:.4g}" for name, value in end.watched.items()},
    }
    error = kind(message.format(**words), remedy=remedy.format(**words))
    if isinstance(error, LinkLostError):
        error.statistics = end.counters
        error.rows = rows
    return error


def _slower(rows: NDArray[np.void]) -> str:
    """Return advice to choose a loop rate at which the latest tick would be in time; "" if no tick was late."""
    late_ns = int(rows["lateness"].max()) if len(rows) else 0
    return f"choose a rate of {int(1e9 // late_ns)} Hz or less, " if late_ns > 0 else ""
