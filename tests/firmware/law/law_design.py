"""From the host's controller to the numbers of the law in C: the same designs, scaled to counts, periods and quanta."""

from __future__ import annotations

import ctypes as ct
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from rig.estimators import fdm_butterworth, foaw, foaw_best, kalman, levant
from rig.estimators import fdm_butterworth_fixed as fixed
from rig.estimators.estimator import PERIOD, RESOLUTION, Floats, Prepared
from rig.fixed_point import Format
from rig.fixed_wall import GAIN_GREATEST, MOST_SHIFT, FixedWall, design_wall
from rig.step import Controller
from rig.wall import DAMPING, ENTRY_ONLY, MAY_PULL, STIFFNESS
from tests.firmware.law.law_library import Parameters

FIXED, FLOAT = 0, 1
ESTIMATORS = ("fdm-butterworth-fixed", "fdm", "fdm-butterworth", "foaw-end", "foaw-best", "levant", "kalman")
SETPOINT_BITS, SLEW_BITS, BAND_BITS = 24, 15, 8
MOST_TICKS = 2**32 - 1
I32 = (-(2**31), 2**31 - 1)


def parameters_of(controller: Controller, arithmetic: int = FLOAT) -> ct.Structure:
    """Parameters of the C law for a controller with `spring-damper` or `bilateral`; the excitation is left silent."""
    c = {name: controller.control[name][0].item() for name in controller.control.dtype.names}
    two_sided = controller.law.law.name == "bilateral"  # which has no options
    law = np.append(controller.law.parameters, [0.0, 0.0]) if two_sided else controller.law.parameters
    delta, quantum = abs(c["resolution"]), c["effort_quantum"]
    target = c["home_target"]
    p = Parameters(
        arithmetic=arithmetic,
        reference=c["reference_count"],
        sense=1 if c["resolution"] > 0.0 else -1,
        window_minimum=first(lambda t: delta * t >= c["window_minimum"], c["window_minimum"] / delta),
        window_maximum=first(lambda t: delta * t > c["window_maximum"], c["window_maximum"] / delta) - 1,
        home_minimum=first(
            lambda t: delta * t > target or abs(delta * t - target) <= c["home_tolerance"],
            (target - c["home_tolerance"]) / delta,
        ),
        home_maximum=first(
            lambda t: delta * t > target and abs(delta * t - target) > c["home_tolerance"],
            (target + c["home_tolerance"]) / delta,
        )
        - 1,
        home_target=round(target / delta * 2**SETPOINT_BITS),
        home_step=min(round(c["home_step"] / delta * 2**SETPOINT_BITS), 2**40),
        current_limit=math.floor(c["effort_limit"] / quantum * (1.0 + 1e-12)),
        may_pull=int(law[MAY_PULL]),
        entry_only=int(law[ENTRY_ONLY]),
        bilateral=int(two_sided),
        extrapolate=c["extrapolate"],
        velocity_divider=c["velocity_divider"],
        slow_multiple=c["slow_multiple"],
        **{name: min(c[name], MOST_TICKS) for name in ("settle_ticks", "home_timeout_ticks", "trial_ticks")},
        release_ticks=max(1, c["release_ticks"]),
    )
    set_estimator(p, controller.estimator)
    if arithmetic == FLOAT:
        _set_float_wall(p, c, law)
    else:
        _set_fixed_wall(p, c, law, velocity_format(controller.estimator))
    return p


def first(passes: Callable[[int], bool], near: float) -> int:
    """Least count that passes a test that is false below some count and true from it on, within 32 bits."""
    if not abs(near) < 2.0**31:
        return I32[near > 0.0] + (near > 0.0)
    at = math.floor(near) - 2
    while not passes(at):
        at += 1
    return at


def velocity_format(prepared: Prepared) -> Format:
    """Format of the fixed estimator's output."""
    return Format(int(prepared.parameters[fixed.WORD_BITS]), int(prepared.parameters[fixed.STATE_BITS]))


def set_estimator(p: ct.Structure, prepared: Prepared) -> None:
    """Choose the estimator and set its numbers; ValueError for a variant that the C law does not have."""
    name, own = prepared.estimator.name, prepared.parameters
    p.estimator = ESTIMATORS.index(name)
    setter: Callable[[Any, Floats], None] | None = {
        "fdm-butterworth-fixed": _biquad,
        "fdm-butterworth": _low_pass,
        "foaw-end": _foaw,
        "foaw-best": _foaw,
        "levant": _levant,
        "kalman": _kalman,
    }.get(name)
    if setter is not None:
        setter(p, own)
    if name == "foaw-best":
        anchor = foaw_best.ANCHORS[int(own[foaw_best.ANCHOR])]
        if anchor == "literal":
            raise ValueError("the device has no anchor 'literal'")
        p.foaw.least_squares = int(anchor == "lsq")


def _biquad(p: Any, own: Floats) -> None:
    names = ("b0", "b1", "b2", "a1", "a2", "coefficient_bits", "state_bits", "word_bits", "rounding")
    for name, value in zip(names, own[fixed.B0 : fixed.ROUNDING + 1], strict=True):
        setattr(p.biquad, name, int(value))
    p.wall.velocity_lsb = 2.0 ** -int(own[fixed.STATE_BITS])


def _low_pass(p: Any, own: Floats) -> None:
    coefficients = own[fdm_butterworth.B0 :].reshape(-1, fdm_butterworth.SECTION)
    p.low_pass.sections = len(coefficients)
    for section, (*_, a1, a2) in zip(p.low_pass.section, coefficients.tolist(), strict=False):
        if a2 == 0.0:  # all zeros are at -1, so that it does not matter which section scipy gave them to
            g = (1.0 + a1) / (1.0 - a1)
            section.order, section.low = 1, g / (1.0 + g)
            continue
        bottom = 1.0 - a1 + a2
        g, kg = math.sqrt((1.0 + a1 + a2) / bottom), 2.0 * (1.0 - a2) / bottom
        inner = 1.0 / (1.0 + kg + g * g)
        section.order, section.inner, section.band, section.low = 2, inner, g * inner, g * g * inner


def _foaw(p: Any, own: Floats) -> None:
    p.foaw.band = math.floor(own[foaw.BAND] * 2**BAND_BITS)  # its margin keeps a whole band whole
    p.foaw.limit = int(own[foaw.LIMIT])
    p.foaw.stop_first = int(own[foaw.STOP] == foaw.STOP_FIRST)


def _levant(p: Any, own: Floats) -> None:
    p.levant.alpha, p.levant.lambda_ = own[levant.ALPHA], own[levant.LAMBDA]
    p.levant.discretisation, p.levant.integrator = int(own[levant.SCHEME]), int(own[levant.OUTPUT])


def _kalman(p: Any, own: Floats) -> None:
    if own[kalman.STEADY] == 0.0:
        raise ValueError("the device has the steady gain only")
    gains = own[kalman.GAIN1 : kalman.GAIN3 + 1]
    p.kalman.gain_position, p.kalman.gain_velocity, p.kalman.gain_acceleration = gains


def _set_float_wall(p: Any, c: dict[str, Any], law: Floats) -> None:
    w, delta, quantum = p.wall, abs(c["resolution"]), c["effort_quantum"]
    period_s = c["tick_s"] * c["velocity_divider"]
    surface = c["wall_position"] / delta
    w.surface_whole = math.floor(surface)
    w.surface_fraction = surface - math.floor(surface)
    w.side = c["wall_side"]
    w.stiffness, w.damping = law[STIFFNESS] * delta / quantum, law[DAMPING] * delta / (period_s * quantum)
    w.constant = c["constant_effort"] / quantum
    w.trial_slew, w.homing_slew = c["trial_slew"] / quantum, c["homing_slew"] / quantum
    w.speed_limit, w.slow_speed = c["speed_limit"] * period_s / delta, c["slow_speed"] * period_s / delta
    w.home_stiffness = c["home_stiffness"] * delta / quantum
    w.home_damping = c["home_damping"] * delta / (period_s * quantum)
    w.home_effort = c["home_effort"] / quantum


def fixed_wall_of(c: dict[str, Any], law: Floats, velocity: Format) -> FixedWall:
    """The wall of `rig.fixed_wall` for the values of a controller."""
    return design_wall(
        stiffness=law[STIFFNESS],
        damping=law[DAMPING],
        resolution=c["resolution"],
        period_s=c["tick_s"] * c["velocity_divider"],
        velocity=velocity,
        effort_quantum=c["effort_quantum"],
        effort_limit=c["effort_limit"],
        wall_position=c["wall_position"],
        side=int(c["wall_side"]),
        constant_effort=c["constant_effort"],
        reference_count=c["reference_count"],
        may_pull=bool(law[MAY_PULL]),
        entry_only=bool(law[ENTRY_ONLY]),
    )


def copy_wall(p: Any, wall: FixedWall) -> None:
    """Set what `rig.fixed_wall` has; where it has it twice, both say the same."""
    for name in ("constant", "direction", "side", "surface", "stiffness", "damping", "shift"):
        setattr(p.fixed_wall, name, getattr(wall, name))
    p.current_limit, p.may_pull, p.entry_only = wall.limit, wall.may_pull, wall.entry_only
    p.reference, p.sense = wall.reference, wall.direction * wall.side


def _set_fixed_wall(p: Any, c: dict[str, Any], law: Floats, velocity: Format) -> None:
    copy_wall(p, fixed_wall_of(c, law, velocity))
    w, delta, quantum = p.fixed_wall, abs(c["resolution"]), c["effort_quantum"]
    lsb = delta * velocity.lsb / (c["tick_s"] * c["velocity_divider"])  # of the velocity, in SI
    gains = (c["home_stiffness"] * delta / quantum / 2**8, c["home_damping"] * lsb / quantum)
    shift = max(s for s in range(1, MOST_SHIFT + 1) if round(max(gains) * 2**s) <= GAIN_GREATEST)
    w.home_shift = shift
    w.home_stiffness, w.home_damping = (round(gain * 2**shift) for gain in gains)
    w.home_effort = round(c["home_effort"] / quantum * 2**shift)
    for name in ("trial_slew", "homing_slew"):
        setattr(w, name, min(round(c[name] / quantum * 2**SLEW_BITS), I32[1]))
    w.speed_limit = min(math.floor(c["speed_limit"] / lsb), I32[1])
    w.slow_speed = min(math.ceil(c["slow_speed"] / lsb), I32[1])


def scale_of(prepared: Prepared) -> float:
    """SI velocity of one count per period, signed."""
    return float(prepared.parameters[RESOLUTION] / prepared.parameters[PERIOD])
