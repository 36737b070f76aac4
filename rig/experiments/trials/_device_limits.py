"""Check that a device accepts the limits of an experiment.

`rig.experiments.trials.plan` calls this module. A board, or a drive behind a bridge (firmware on this computer in front
of a drive), may have narrower limits of speed, current and position than the protocol.
"""

from collections.abc import Callable
from typing import NamedTuple

from firmware_protocol.dictionary import Dictionary
from rig.config.controller import effort_quantum, resolution
from rig.config.prepared_run import PreparedRun
from rig.core.check import Check, Outcome
from rig.core.sample import unit_of


class _Limit(NamedTuple):
    """A limit that becomes a parameter of the device: key and quantity in the experiment, SI size of its unit step."""

    key: str
    quantity: str
    quantum: Callable[[PreparedRun], float]


def _of_count(run: PreparedRun) -> float:
    return abs(resolution(run.experiment))


def _of_current(run: PreparedRun) -> float:
    return effort_quantum(run.experiment, run.current_quantum_a)


_LIMITS = {
    "speed_limit": _Limit("rig.limits.speed", "velocity", _of_count),
    "current_limit": _Limit("rig.limits.effort", "effort", _of_current),
    "continuous_current": _Limit("rig.limits.nominal_effort", "effort", _of_current),
    "window_minimum": _Limit("rig.limits.position_minimum and position_maximum", "position", _of_count),
    "window_maximum": _Limit("rig.limits.position_minimum and position_maximum", "position", _of_count),
}


def check_limits(run: PreparedRun, dictionary: Dictionary) -> Check:
    """Check that the device accepts the limits of a run: speed, current, and the ends of the position window.

    Returns
    -------
    Check
        Refused if the device does not accept a limit, with each such limit and its allowed range; else OK.
    """
    wrong, keys = [], []
    for name, limit in _LIMITS.items():
        value, own = run.parameters[name], dictionary.parameter(name)
        if own is None or own.minimum <= value <= own.maximum:
            continue
        quantum, unit = limit.quantum(run), unit_of(limit.quantity, run.experiment.rig.motion)
        low, high = own.minimum * quantum, own.maximum * quantum
        wrong.append(f"{name} {value * quantum:.4g} {unit} (allowed: {low:.4g} to {high:.4g} {unit})")
        keys.append(limit.key)
    return Check(
        "limits of the device",
        Outcome.REFUSED if wrong else Outcome.OK,
        f"{dictionary.device} does not accept these limits: {'; '.join(wrong)}"
        if wrong
        else f"{dictionary.device} accepts the limits of the experiment",
        f"change {', '.join(dict.fromkeys(keys))}, or the limit of the drive or board" if wrong else "",
    )
