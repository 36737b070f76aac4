"""The structure of the C law as values of the parameter table.

Written from the table and law.h, not from the firmware that reads it, so that the two check each other.
"""

from __future__ import annotations

import ctypes as ct
from typing import Any

from firmware_protocol.parameter import Value
from tests.firmware.law.law_library import SECTIONS

_LOW32 = 2**32 - 1
_FRACTION = 2**24
_SAME = (
    "estimator", "extrapolate", "bilateral", "slow_multiple", "settle_ticks", "home_timeout_ticks", "trial_ticks",
    "release_ticks", "home_minimum", "home_maximum", "velocity_divider", "current_limit", "free_ticks", "free_minimum",
    "free_maximum", "hold_ticks",
)  # fmt: skip
_PARTS = {
    "biquad": ("b0", "b1", "b2", "a1", "a2", "coefficient_bits", "state_bits", "word_bits", "rounding"),
    "foaw": ("band", "limit", "stop_first", "least_squares"),
    "levant": ("alpha", "discretisation", "integrator"),
}
_FLOAT = (
    "stiffness", "damping", "constant", "trial_slew", "homing_slew", "speed_limit", "slow_speed", "velocity_lsb",
    "home_stiffness", "home_damping", "home_effort",
)  # fmt: skip
_FIXED = (
    "surface", "stiffness", "damping", "shift", "trial_slew", "homing_slew", "speed_limit", "slow_speed",
    "home_stiffness", "home_damping", "home_shift",
)  # fmt: skip


def wire_values(p: ct.Structure) -> dict[str, Value]:
    """Return the parameters of a law; those that are zero because another law is meant keep their default."""
    values: dict[str, Value] = {name: getattr(p, name) for name in _SAME}
    values |= {
        "law": p.arithmetic + 1,
        "reference_count": p.reference,
        "law_window_minimum": p.window_minimum,
        "law_window_maximum": p.window_maximum,
        "wall_pull": p.may_pull,
        "damping_on_entry": p.entry_only,
        "home_target": p.home_target // _FRACTION,
        "home_target_fraction": p.home_target % _FRACTION,
        "home_step": min(p.home_step, _LOW32),
    }
    for part, names in _PARTS.items():
        values |= {f"{part}_{name}": getattr(getattr(p, part), name) for name in names}
    values["levant_lambda"] = p.levant.lambda_
    values |= {
        f"kalman_{name}": getattr(p.kalman, f"gain_{name}")
        for name in ("position", "velocity", "acceleration")
    }
    values |= _low_pass(p.low_pass) | _float_wall(p.wall) | _fixed_wall(p.fixed_wall)
    values["excitation_lines"] = p.excitation.lines
    if p.excitation.lines:
        values |= {f"excitation_{name}": getattr(p.excitation, name) for name, _ in p.excitation._fields_}
    values["wall_side"] = int(p.wall.side) or p.fixed_wall.side
    unset = {"biquad_word_bits", "foaw_limit", "fixed_shift", "fixed_home_shift"}
    return {name: value for name, value in values.items() if value != 0 or name not in unset}


def live_values(p: ct.Structure) -> dict[str, Value]:
    """Return those that may change while the device is armed."""
    names = ("surface", "stiffness", "damping", "shift", "constant_high", "constant_low")
    fixed = _fixed_wall(p.fixed_wall)
    live = {f"fixed_{name}": fixed[f"fixed_{name}"] for name in names} if p.fixed_wall.shift else {}
    own = _float_wall(p.wall)
    names = ("surface", "surface_fraction", "stiffness", "damping")
    return live | {f"float_{name}": own[f"float_{name}"] for name in names}


def _low_pass(p: Any) -> dict[str, Value]:
    sections = p.section[: p.sections]
    values: dict[str, Value] = {}
    if sections:
        values["low_pass_order"] = sum(section.order for section in sections)
    for n, section in enumerate(p.section[:SECTIONS], start=1):
        values |= {f"low_pass_{part}_{n}": getattr(section, part) for part in ("inner", "band", "low")}
    return values


def _float_wall(w: Any) -> dict[str, Value]:
    values: dict[str, Value] = {f"float_{name}": getattr(w, name) for name in _FLOAT}
    return values | {"float_surface": w.surface_whole, "float_surface_fraction": w.surface_fraction}


def _fixed_wall(w: Any) -> dict[str, Value]:
    values: dict[str, Value] = {f"fixed_{name}": getattr(w, name) for name in _FIXED}
    for name in ("constant", "home_effort"):
        number = getattr(w, name)
        values[f"fixed_{name}_high"], values[f"fixed_{name}_low"] = number >> 32, number & _LOW32
    return values
