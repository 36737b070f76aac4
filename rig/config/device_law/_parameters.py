"""Compute the parameters of a law that runs on the device, and which of them may change while the law runs."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from firmware_protocol.parameter import Value
from firmware_protocol.parameters import BY_NAME
from rig.config._sections import BOARD_ARITHMETICS
from rig.config._sections import Controller as Rates
from rig.config.device_law._elsewhere import wall_elsewhere
from rig.control.on_device import (
    ELSE_HOST,
    Control,
    DeviceWall,
    Values,
    common_parameters,
    designed_wall,
    estimator_parameters,
    fixed_guard,
    fixed_wall,
    fixed_wall_in_si,
    float_guard,
    float_wall,
    float_wall_in_si,
    options,
    refusal,
    velocity_format,
)
from rig.control.step import ControllerState
from rig.core.errors import PlanError

Arithmetic = Literal["fixed", "float32", "drive"]
ARITHMETICS: tuple[str, ...] = ("host", "fixed", "float32", "drive")  # in the order of the parameter `law`
# The only estimator that exists in integers.
FIXED_ESTIMATOR = "fdm-butterworth-fixed"
SETPOINT_BITS = 24
MOST_TICKS = 2**32 - 1
I32 = (-(2**31), 2**31 - 1)
MOST_PERIODS_A_TICK = 8
# In quanta: the largest effort that an excitation table without fractional bits can contain.
MOST_EXCITATION = 2.0**15

# What decides a value that does not fit, by the beginning of its name: the longest that matches.
_KEYS = {
    "home_target": "trial.start",
    "home_step": "homing.speed",
    "biquad_": "controller.parameters (coefficient_bits, state_bits, cutoff_hz)",
    "foaw_band": "controller.parameters.band",
    "levant_": "controller.parameters (lipschitz)",
    "slow_multiple": "controller.slow_velocity_rate",
    "float_surface": "wall.position",
    "fixed_surface": "wall.position",
    "float_stiffness": "wall.stiffness",
    "float_damping": "wall.damping",
    "float_constant": "trial.effort",
    "float_home_stiffness": "homing.stiffness",
    "float_home_damping": "homing.damping",
    "float_home_effort": "homing.effort",
    "excitation_": "[excitation]",
}


def arithmetic_of(rates: Rates) -> Arithmetic:
    """Return the arithmetic of a law on the device; "auto" becomes "fixed" if the estimator exists in integers."""
    if rates.arithmetic != "auto":
        return rates.arithmetic
    return "fixed" if rates.estimator == FIXED_ESTIMATOR else "float32"


def law_parameters(controller: ControllerState, arithmetic: Arithmetic) -> Values:
    """Return the value of each parameter that the law on the device reads, by name, except those of BATCH frames.

    `controller` is the host's (`rig.config.controller.for_experiment`). Raise `PlanError` if the device does not have
    the estimator, the law or one of its options, or a value is out of range.
    """
    c, law = _control_values(controller), controller.law.parameters
    _check_arithmetic(c, controller, arithmetic)
    _check_work(c)
    if arithmetic not in BOARD_ARITHMETICS:
        wall_elsewhere(arithmetic).refuse_what_it_lacks(controller, c)
    values: Values = {
        "law": ARITHMETICS.index(arithmetic),
        "velocity_divider": c["velocity_divider"],
        "extrapolate": c["extrapolate"],
        "estimated_position": int(c["position_state"] > 0),
        "slow_multiple": c["slow_multiple"],
        "settle_ticks": min(c["settle_ticks"], MOST_TICKS),
        "home_timeout_ticks": min(c["home_timeout_ticks"], MOST_TICKS),
        "free_ticks": min(c["free_ticks"], MOST_TICKS),
        "trial_ticks": min(c["trial_ticks"], MOST_TICKS),
        "hold_ticks": min(c["hold_ticks"], MOST_TICKS),
        "release_ticks": max(1, c["release_ticks"]),
        "wall_side": int(c["wall_side"]),
        **_position_parameters(c),
        **estimator_parameters(controller.estimator, float(c["effort_quantum"])),
        **common_parameters(controller.law.law.name, law),
        "excitation_lines": 0,
        **_excitation(controller),
    }
    if arithmetic != "fixed":
        values |= {**float_wall(c, law), **float_guard(c)}
        if controller.estimator.estimator.name == FIXED_ESTIMATOR:
            values["float_velocity_lsb"] = velocity_format(controller.estimator).lsb
    else:
        velocity = velocity_format(controller.estimator)
        added = (
            math.ldexp(MOST_EXCITATION, -int(values["excitation_bits"]))
            if values["excitation_lines"]
            else 0.0
        )
        wall = designed_wall(c, controller.law.law.name, law, velocity, added)
        values |= {**fixed_wall(wall), **fixed_guard(c, velocity)}
    check_values(values)
    return values


def live_parameters(controller: ControllerState, arithmetic: Arithmetic, numbers: Sequence[float]) -> Values:
    """Return the values of the device parameters that change the wall while the law runs, by name.

    `controller` is the one with which the device was armed. `numbers` are the position of the new wall, then the
    parameters of its law (`rig.experiments.trials.live.parameter_set`). Raise `PlanError` if a value is out of range
    for the device, or an option changes that cannot change while the law runs.
    """
    position, *law = numbers
    name, before, after = controller.law.law.name, controller.law.parameters, np.array(law, dtype=np.float64)
    if options(name, before) != options(name, after):
        raise PlanError(
            "wall.pull and wall.damping_on cannot change while the law runs on the device",
            remedy="end the run and start it with the other wall",
        )
    c: Control = {**_control_values(controller), "wall_position": position}
    if arithmetic != "fixed":
        values = float_wall(c, after)
    else:
        values = fixed_wall(designed_wall(c, name, after, velocity_format(controller.estimator)))
    check_values(values)
    return values


def rendered_wall(values: Mapping[str, Value], controller: ControllerState) -> DeviceWall:
    """Return stiffness, damping and position (SI units) of the wall that a device renders with its active parameters.

    `controller` is the host's controller from which they were computed; it has the scale factors.
    """
    fixed = ARITHMETICS[int(values["law"])] == "fixed"
    in_si = fixed_wall_in_si if fixed else float_wall_in_si
    return in_si(values, _control_values(controller))


def check_values(values: Mapping[str, Value]) -> None:
    """Raise `PlanError`, with the experiment's key, for a value out of the range of its device parameter."""
    for name, value in values.items():
        parameter = BY_NAME[name]
        if parameter.accepts(value):
            continue
        key = max((start for start in _KEYS if name.startswith(start)), key=len, default=None)
        raise PlanError(
            f"{_KEYS[key] if key else name}: {name} = {value:g} {parameter.unit}".rstrip()
            + f" is out of range for the device: allowed are {parameter.minimum:g} to {parameter.maximum:g}",
            remedy=f"change this key, the position rate or the current quantum, or {ELSE_HOST}",
        )


def _check_arithmetic(c: Control, controller: ControllerState, arithmetic: Arithmetic) -> None:
    name = controller.estimator.estimator.name
    if arithmetic != "fixed":
        return
    if name != FIXED_ESTIMATOR:
        raise refusal(
            "controller.arithmetic",
            "fixed",
            f"the estimator {name} does not exist in integers",
            f'choose controller.estimator = "{FIXED_ESTIMATOR}", or controller.arithmetic = "float32"',
        )
    if c["extrapolate"]:
        raise refusal(
            "controller.prediction",
            "extrapolate",
            "the law in integers holds the velocity between samples",
            'choose controller.prediction = "hold", or controller.arithmetic = "float32"',
        )
    _check_passivity(c)


def _check_passivity(c: Control) -> None:
    if c["passive_damping"] > 0.0:
        raise refusal(
            "wall.passive_damping",
            c["passive_damping"],
            "the law in integers has no passivity controller",
            'choose wall.passive_damping = 0, or controller.arithmetic = "float32"',
        )


def _check_work(c: Control) -> None:
    if c["slow_multiple"] > MOST_PERIODS_A_TICK:
        raise refusal(
            "controller.slow_velocity_rate",
            round(1.0 / (c["tick_s"] * c["velocity_divider"] * c["slow_multiple"])),
            f"{c['slow_multiple']} velocity periods would be computed in one tick; a board has time "
            f"for {MOST_PERIODS_A_TICK} at most",
            f"choose at least controller.velocity_rate / {MOST_PERIODS_A_TICK}",
        )


def _position_parameters(c: Control) -> Values:
    delta, target, tolerance = abs(c["resolution"]), c["home_target"], c["home_tolerance"]
    target_bits = round(target / delta * 2**SETPOINT_BITS)
    return {
        "law_window_minimum": _lowest_count(c["window_minimum"], delta),
        "law_window_maximum": _highest_count(c["window_maximum"], delta),
        "free_minimum": _lowest_count(c["free_minimum"], delta),
        "free_maximum": _highest_count(c["free_maximum"], delta),
        "home_minimum": _first_passing_count(
            lambda t: delta * t > target or abs(delta * t - target) <= tolerance, (target - tolerance) / delta
        ),
        "home_maximum": _first_passing_count(
            lambda t: delta * t > target and abs(delta * t - target) > tolerance, (target + tolerance) / delta
        )
        - 1,
        "home_target": target_bits >> SETPOINT_BITS,
        "home_target_fraction": target_bits & (2**SETPOINT_BITS - 1),
        "home_step": round(c["home_step"] / delta * 2**SETPOINT_BITS),
    }


def _lowest_count(position: float, delta: float) -> int:
    """Return the lowest count whose position is at or above `position` (rad or m); `delta` is the travel per count."""
    return _first_passing_count(lambda t: delta * t >= position, position / delta)


def _highest_count(position: float, delta: float) -> int:
    """Return the highest count whose position is at or below `position` (rad or m); `delta` is the travel per count."""
    return _first_passing_count(lambda t: delta * t > position, position / delta) - 1


def _first_passing_count(passes: Callable[[int], bool], near: float) -> int:
    """Return the lowest 32-bit count from which on `passes` is True; the search begins just below `near`."""
    if not abs(near) < 2.0**31:
        return I32[near > 0.0] + (near > 0.0)
    at = math.floor(near) - 2
    while not passes(at):
        at += 1
    return max(at, I32[0])


def _excitation(controller: ControllerState) -> Values:
    law = controller.law.law
    if law.name == "excited" and not law.device:
        raise PlanError(
            'wall.law = "excited" with controller.loop = "device": the excitation is a table of values computed on '
            "the host, and the device cannot receive such a table",
            remedy="measure with rig impedance measure, for which the device computes the excitation "
            f"itself, or {ELSE_HOST}",
        )
    return dict(law.device)


def _control_values(controller: ControllerState) -> Control:
    return dict(zip(controller.control.dtype.names or (), controller.control[0].item(), strict=True))
