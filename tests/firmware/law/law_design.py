"""Convert the parameters that a host sends to the structure of the law in C.

Written from the table and law.h, not from the firmware that reads the parameters, so that the two check each other.
"""

import ctypes as ct
from collections.abc import Mapping
from typing import Any

from firmware_protocol.law_parameters import LAW_PARAMETERS
from firmware_protocol.parameter import Value
from rig.config import device_law
from rig.control._fixed_point import Biquad
from rig.control._fixed_wall import FixedWall
from rig.control.estimators.estimator import PERIOD, RESOLUTION, Prepared
from rig.control.on_device._estimators import ESTIMATORS, estimator_parameters
from rig.control.step import ControllerState
from tests.conformance.estimator import MASSES
from tests.firmware.law.law_library import Parameters

__all__ = ["ELSEWHERE", "ESTIMATORS", "FIXED", "FLOAT", "OWN"]  # of the design: for other tests
FIXED, FLOAT, ELSEWHERE = 0, 1, 2
OWN: dict[str, dict[str, float | str]] = {"kalman": {"gain": "steady"}, "disturbance-two-mass": MASSES}
ARITHMETICS = ("fixed", "float32")
SECTIONS = 4
# Where a parameter's name differs from the structure's: the beginning of it, and the structure inside.
_PARTS = {f"{name}_": name for name in ("biquad", "foaw", "levant", "two_mass", "excitation")}
_OF_KALMAN = {f"kalman_{name}": f"gain_{name}" for name in ("position", "velocity", "acceleration")}
_OF_KALMAN["kalman_input"] = "input"
_SAME = [
    "estimator", "extrapolate", "bilateral", "slow_multiple", "settle_ticks", "home_timeout_ticks", "trial_ticks",
    "release_ticks", "home_minimum", "home_maximum", "velocity_divider", "current_limit", "free_ticks", "free_minimum",
    "free_maximum", "hold_ticks", "estimated_position",
]  # fmt: skip


def values_of(controller: ControllerState, arithmetic: int = FLOAT) -> dict[str, Value]:
    c = controller.control[0]
    limits = {"current_limit": round(c["effort_limit"] / c["effort_quantum"])}
    limits["reference_count"] = int(c["reference_count"])
    return device_law.law_parameters(controller, ARITHMETICS[arithmetic]) | limits


def parameters_of(controller: ControllerState, arithmetic: int = FLOAT) -> ct.Structure:
    sense = 1 if controller.control[0]["resolution"] > 0.0 else -1
    return structure_of(values_of(controller, arithmetic), sense)


def structure_of(values: Mapping[str, Value], sense: int) -> ct.Structure:
    """Return the structure of the law for parameters; `sense` is that of the encoder."""
    v: dict[str, Any] = {parameter.name: parameter.default for parameter in LAW_PARAMETERS} | dict(values)
    p = Parameters(
        arithmetic=v["law"] - 1,
        reference=v["reference_count"],
        sense=sense,
        may_pull=v["wall_pull"],
        entry_only=v["damping_on_entry"],
        window_minimum=v["law_window_minimum"],
        window_maximum=v["law_window_maximum"],
        home_target=(v["home_target"] << 24) + v["home_target_fraction"],
        home_step=v["home_step"],
        **{name: v[name] for name in _SAME},
    )
    set_estimator_values(p, v)
    w, f = p.wall, p.fixed_wall
    w.side, w.surface_whole, w.surface_fraction = (
        v["wall_side"],
        v["float_surface"],
        v["float_surface_fraction"],
    )
    f.side, f.direction = v["wall_side"], v["wall_side"] * sense
    for name, value in v.items():
        if name.startswith("float_") and not name.startswith("float_surface"):
            setattr(w, name.removeprefix("float_"), value)
        elif name.startswith("fixed_") and not name.endswith(("_high", "_low")):
            setattr(f, name.removeprefix("fixed_"), value)
    for name in ("constant", "home_effort"):
        setattr(f, name, (v[f"fixed_{name}_high"] << 32) + v[f"fixed_{name}_low"])
    return p


def set_estimator_values(p: ct.Structure, v: Mapping[str, Any]) -> None:
    p.estimator = v["estimator"]
    for name, value in v.items():
        start = next((start for start in _PARTS if name.startswith(start)), None)
        owner = getattr(p, _PARTS[start], None) if start is not None else None
        if owner is not None and start is not None:
            leaf = name.removeprefix(start)
            setattr(owner, {"lambda": "lambda_"}.get(leaf, leaf), value)
        elif name in _OF_KALMAN:
            setattr(p.kalman, _OF_KALMAN[name], value)
    if "low_pass_order" in v:
        order = v["low_pass_order"]
        p.low_pass.sections = (order + 1) // 2
        for n in range(p.low_pass.sections):
            section = p.low_pass.section[n]
            section.order = 1 if order % 2 and n + 1 == p.low_pass.sections else 2
            for part in ("inner", "band", "low"):
                setattr(section, part, v.get(f"low_pass_{part}_{n + 1}", 0.0))
    if "float_velocity_lsb" in v:
        p.wall.velocity_lsb = v["float_velocity_lsb"]


def set_estimator(p: ct.Structure, prepared: Prepared) -> None:
    """Choose the estimator and set its parameters; raise PlanError for a variant that the device lacks."""
    values = estimator_parameters(prepared)
    if "biquad_state_bits" in values:
        values["float_velocity_lsb"] = 2.0 ** -int(values["biquad_state_bits"])
    set_estimator_values(p, values)


def copy_filter(p: Any, filter_: Biquad) -> None:
    for name in ("b0", "b1", "b2", "a1", "a2", "coefficient_bits", "rounding"):
        setattr(p.biquad, name, getattr(filter_, name))
    p.biquad.state_bits, p.biquad.word_bits = filter_.state.fraction_bits, filter_.state.word_bits


def copy_wall(p: Any, wall: FixedWall) -> None:
    """Set the fields of `rig.control._fixed_wall`; its duplicate values must be equal."""
    for name in ("constant", "direction", "side", "surface", "stiffness", "damping", "shift"):
        setattr(p.fixed_wall, name, getattr(wall, name))
    p.current_limit, p.may_pull, p.entry_only = wall.limit, wall.may_pull, wall.entry_only
    p.reference, p.sense = wall.reference, wall.direction * wall.side


def scale_of(prepared: Prepared) -> float:
    """Return the SI velocity of one count per period, signed."""
    return float(prepared.parameters[RESOLUTION] / prepared.parameters[PERIOD])
