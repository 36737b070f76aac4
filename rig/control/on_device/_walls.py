"""Device parameters of the wall, of the limits of its effort and of its homing servo, in integers and in float32.

`rig.config.device_law` uses it. Change it only together with firmware/law.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from firmware_protocol.parameter import Value
from rig.control._fixed_point import Format
from rig.control._fixed_wall import DEPTH, GAIN_GREATEST, MOST_SHIFT, FixedWall, design_wall
from rig.control._wall import DAMPING, ENTRY_ONLY, MAY_PULL, PARAMETERS, STIFFNESS
from rig.control.estimators.estimator import Floats
from rig.control.on_device._errors import ELSE_HOST, refusal
from rig.core.errors import ConfigError, PlanError

LAWS = ("spring-damper", "bilateral", "excited")
BILATERAL = LAWS[1:]  # spring and damper on both sides, without options
SLEW_BITS = 15  # of the slew limits in integers
I32_GREATEST = 2**31 - 1
MOST_SLEW = 2.0**30  # quanta a tick: beyond any current, so no limit

Values = dict[str, Value]
Control = Mapping[str, Any]  # `rig.control.step.CONTROL` as plain numbers


@dataclass(frozen=True, slots=True)
class DeviceWall:
    """The wall that a device renders, in SI units, after scaling and rounding.

    Attributes
    ----------
    stiffness, damping
        K and B (N·m/rad and N·m·s/rad, or N/m and N·s/m).
    position
        Position of the wall's surface, from the reference (rad or m).
    """

    stiffness: float
    damping: float
    position: float


def common_parameters(name: str, law: Floats) -> Values:
    """Return a wall's device parameters that do not depend on its arithmetic (integers or float32), by name.

    `name` is the name of the force law, `law` its parameters on the host. Raises `PlanError` if no device has the law.
    """
    if name not in LAWS:
        if name.endswith("+friction"):
            raise PlanError(
                'controller.friction_compensation with controller.loop = "device": the firmware does '
                "not compensate friction",
                remedy=f"set controller.friction_compensation to 0, or {ELSE_HOST}",
            )
        raise refusal(
            "wall.law", name, "a device does not have this law", f"choose one of: {', '.join(LAWS)}"
        )
    may_pull, entry_only = options(name, law)
    return {
        "bilateral": int(name in BILATERAL),
        "wall_pull": int(may_pull),
        "damping_on_entry": int(entry_only),
    }


def options(name: str, law: Floats) -> tuple[bool, bool]:
    """Return if a wall may pull, and if its damping acts on entry only; both False if it acts on both sides."""
    if name in BILATERAL or len(law) < PARAMETERS:
        return False, False
    return bool(law[MAY_PULL]), bool(law[ENTRY_ONLY])


def float_wall(c: Control, law: Floats) -> Values:
    """Return the wall's device parameters in float32, in counts and current quanta.

    The surface is a whole count and a fraction, so that the depth is exact.
    """
    delta, quantum, period_s = _scales(c)
    surface = c["wall_position"] / delta
    return {
        "float_surface": math.floor(surface),
        "float_surface_fraction": surface - math.floor(surface),
        "float_stiffness": float(law[STIFFNESS]) * delta / quantum,
        "float_damping": float(law[DAMPING]) * delta / (period_s * quantum),
    }


def float_wall_in_si(values: Mapping[str, Value], c: Control) -> DeviceWall:
    """Return the wall in SI units, from the device parameters of a wall in float32.

    The error of float32 is 2⁻²⁴ (relative) for stiffness and damping, and 2⁻²⁵ counts for the position.
    """
    delta, quantum, period_s = _scales(c)
    surface = values["float_surface"] + values["float_surface_fraction"]
    return DeviceWall(
        stiffness=values["float_stiffness"] * quantum / delta,
        damping=values["float_damping"] * quantum * period_s / delta,
        position=surface * delta,
    )


def float_guard(c: Control) -> Values:
    """Return the device parameters of constant effort, limits and homing servo in float32 (counts, current steps)."""
    delta, quantum, period_s = _scales(c)
    return {
        "float_constant": c["constant_effort"] / quantum,
        "float_trial_slew": min(c["trial_slew"] / quantum, MOST_SLEW),
        "float_homing_slew": min(c["homing_slew"] / quantum, MOST_SLEW),
        "float_speed_limit": min(c["speed_limit"] * period_s / delta, MOST_SLEW),
        "float_slow_speed": min(c["slow_speed"] * period_s / delta, MOST_SLEW),
        "float_home_stiffness": c["home_stiffness"] * delta / quantum,
        "float_home_damping": c["home_damping"] * delta / (period_s * quantum),
        "float_home_effort": c["home_effort"] / quantum,
        "float_passive_damping": c["passive_damping"] * delta / (period_s * quantum),
    }


def designed_wall(
    c: Control, name: str, law: Floats, velocity: Format, added_quanta: float = 0.0
) -> FixedWall:
    """Return the wall in integers; its sums have bits for a further effort of `added_quanta` current quanta.

    Raises `PlanError` if the wall does not fit the integers of the device.
    """
    may_pull, entry_only = options(name, law)
    try:
        return design_wall(
            stiffness=float(law[STIFFNESS]),
            damping=float(law[DAMPING]),
            resolution=c["resolution"],
            period_s=c["tick_s"] * c["velocity_divider"],
            velocity=velocity,
            effort_quantum=c["effort_quantum"],
            effort_limit=c["effort_limit"],
            wall_position=c["wall_position"],
            side=int(c["wall_side"]),
            constant_effort=c["constant_effort"],
            added_effort=added_quanta * c["effort_quantum"],
            reference_count=c["reference_count"],
            may_pull=may_pull,
            entry_only=entry_only,
        )
    except ConfigError as error:
        raise PlanError(
            f"the wall with stiffness {law[STIFFNESS]:g} and damping {law[DAMPING]:g} does not fit the device's "
            f"integers: {error.message}",
            remedy=f'{error.remedy}, or choose controller.arithmetic = "float32"',
        ) from None


def fixed_wall(wall: FixedWall) -> Values:
    """Return the device parameters of a wall in integers, by name; a 64-bit number becomes ``…_high`` and ``…_low``."""
    return {
        "fixed_surface": wall.surface,
        "fixed_stiffness": wall.stiffness,
        "fixed_damping": wall.damping,
        "fixed_shift": wall.shift,
        **_split_halves("fixed_constant", wall.constant),
    }


def fixed_wall_in_si(values: Mapping[str, Value], c: Control) -> DeviceWall:
    """Return the wall in SI units, from the device parameters of a law in integers.

    Its rounding error is half of 2⁻ˢ current quanta (s is the parameter ``fixed_shift``) for each LSB of depth or
    velocity, and 2⁻⁹ counts for the position.
    """
    delta, quantum, period_s = _scales(c)
    lsb = math.ldexp(1.0, -int(values["fixed_shift"]))
    velocity_lsb = math.ldexp(1.0, -int(values["biquad_state_bits"]))
    return DeviceWall(
        stiffness=values["fixed_stiffness"] * lsb / DEPTH.lsb * quantum / delta,
        damping=values["fixed_damping"] * lsb / velocity_lsb * quantum * period_s / delta,
        position=values["wall_side"] * values["fixed_surface"] * DEPTH.lsb * delta,
    )


def fixed_guard(c: Control, velocity: Format) -> Values:
    """Return the device parameters of limits and homing servo in integers; raise `PlanError` if they do not fit."""
    delta, quantum, period_s = _scales(c)
    lsb = delta * velocity.lsb / period_s  # of the velocity, in SI
    gains = {  # quanta per LSB
        "stiffness": c["home_stiffness"] * delta / quantum * DEPTH.lsb,
        "damping": c["home_damping"] * lsb / quantum,
    }
    shifts = [s for s in range(1, MOST_SHIFT + 1) if round(max(gains.values()) * 2**s) <= GAIN_GREATEST]
    if not shifts:
        name, gain = max(gains.items(), key=lambda item: item[1])
        key = f"homing.{name}"
        raise refusal(
            key,
            c[f"home_{name}"],
            f"in the device's integers this is {gain:.3g} current quanta per LSB of depth or velocity, above 2^30",
            f"lower {key}",
        )
    shift = shifts[-1]
    return {
        "fixed_trial_slew": min(round(c["trial_slew"] / quantum * 2**SLEW_BITS), I32_GREATEST),
        "fixed_homing_slew": min(round(c["homing_slew"] / quantum * 2**SLEW_BITS), I32_GREATEST),
        "fixed_speed_limit": min(math.floor(c["speed_limit"] / lsb), I32_GREATEST),
        "fixed_slow_speed": min(math.ceil(c["slow_speed"] / lsb), I32_GREATEST),
        "fixed_home_stiffness": round(gains["stiffness"] * 2**shift),
        "fixed_home_damping": round(gains["damping"] * 2**shift),
        "fixed_home_shift": shift,
        **_split_halves("fixed_home_effort", round(c["home_effort"] / quantum * 2**shift)),
    }


def _split_halves(name: str, value: int) -> Values:
    return {f"{name}_high": value >> 32, f"{name}_low": value & 0xFFFFFFFF}


def _scales(c: Control) -> tuple[float, float, float]:
    """Return travel for one count (rad or m), effort of a current quantum (N·m or N) and velocity period (s)."""
    return abs(c["resolution"]), c["effort_quantum"], c["tick_s"] * c["velocity_divider"]
