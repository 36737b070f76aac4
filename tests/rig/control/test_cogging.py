"""Cogging compensation follows the measured map, stays within its limit, and is zero outside the map."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import config
from rig.analysis import theory
from rig.config import controller, presets
from rig.control import laws
from rig.control.cogging import FADE, bounded_at, compensate_cogging
from rig.core.model import Cogging
from rig.core.sample import Phase
from rig.testing import Hits
from tests.conformance.tiers import first_by_default

MAP = Cogging(
    period=0.0628, orders=(1, 3), cosine=(0.0, 0.004), sine=(-0.02, 0.006), minimum=-0.04, maximum=0.05
)
WALL = {
    "stiffness": 300.0,
    "damping": 0.5,
    "pull": "clamp",
    "damping_on": "both",
    "position": 0.01,
    "side": 1,
}
KEYS: dict[str, Any] = {
    **{f"rig.cogging.{key}": getattr(MAP, key) for key in ("period", "minimum", "maximum")},
    **{f"rig.cogging.{key}": list(getattr(MAP, key)) for key in ("orders", "cosine", "sine")},
    "rig.reference.index": True,
    "rig.reference.limit_switch": "minimum",
    "rig.reference.position": -0.25,
    "rig.reference.travel": 1.2,
}


def taken(x: float, limit: float) -> float:
    return float(bounded_at(x, MAP.minimum, MAP.maximum, limit, MAP.harmonics))


@given(x=st.floats(-0.1, 0.1, allow_subnormal=False), limit=st.floats(0.0, 0.1, allow_subnormal=False))
def test_compensation_is_the_map_within_range_and_limit(x: Any, limit: Any) -> None:
    assert MAP.minimum is not None
    assert MAP.maximum is not None
    found, true = taken(x, limit), float(MAP.effort(x))
    assert abs(found) <= limit
    assert found * true >= 0.0
    margin = FADE * (MAP.maximum - MAP.minimum)
    if not MAP.minimum < x < MAP.maximum:
        assert found == 0.0
    elif MAP.minimum + margin <= x <= MAP.maximum - margin:
        assert found == pytest.approx(min(max(true, -limit), limit), abs=1e-15)
    steepest = float(sum(np.hypot(MAP.cosine, MAP.sine) * MAP.harmonics[::3])) + limit / margin
    assert abs(taken(x + 1e-6, limit) - found) <= 1.01 * steepest * 1e-6, "it fades, and steps nowhere"


@pytest.mark.parametrize("side", first_by_default([1, -1]))
def test_the_wall_stays_the_wall_and_the_motor_pushes_against_its_cogging(side: int) -> None:
    """A reaction is an effort against the side, so a reaction side · F(x) is the effort −F(x)."""
    plain = laws.get("spring-damper")
    wall = {**WALL, "side": side}
    law, alone = compensate_cogging(plain, MAP, 0.1).prepare(wall), plain.prepare(wall)
    for penetration in (-0.02, 0.0, 0.003):
        reaction = law.law.function(penetration, 0.1, 1, law.state, law.parameters)
        expected = plain.function(penetration, 0.1, 1, alone.state, alone.parameters)
        x = 0.01 + side * penetration
        assert reaction == pytest.approx(expected + side * float(MAP.effort(x)), abs=1e-15)
        assert law.state[0] == alone.state[0], "the mark of a clamped wall passes"


def test_a_replay_needs_only_the_wrapper_and_friction_may_be_inside_of_it() -> None:
    name = "spring-damper+friction+cogging"
    assert laws.get(name).name == name
    law = compensate_cogging(laws.get("spring-damper"), MAP, 0.1).prepare(WALL)
    again = laws.get("spring-damper+cogging")
    state = np.zeros_like(law.state)
    expected = law.law.function(1e-3, 0.05, 1, law.state, law.parameters)
    assert again.function(1e-3, 0.05, 1, state, law.parameters) == expected


@pytest.mark.exhaustive("::test_compensation_is_the_map_within_range_and_limit")
def test_handle_moves_as_if_nothing_cogged(rig_hit: Hits) -> None:
    short = {"trial.duration_s": 0.2, "verdict.tail_s": 0.1, "homing.settle_s": 0.0,
             "homing.tolerance_counts": 1e6, "rig.simulation.initial_position": -0.015}  # fmt: skip
    plain = config.override(presets.load("koul-compliant"), short)
    cogs = config.override(plain, KEYS)
    helped = config.override(cogs, {"controller.cogging_compensation": True, "controller.cogging_limit": 0.5})
    law = controller.for_experiment(helped, current_quantum_a=0.001).law
    assert law.law.name == "spring-damper+cogging"
    assert law.parameters[4] == 0.5 * helped.rig.limits.nominal_effort
    way, rows = [], None
    for experiment in (plain, cogs, helped):
        rows = rig_hit(experiment).recording.rows
        rows = rows[rows["phase"] == Phase.TRIAL]
        way.append(rows["position_true"][:300])
    # The rest are the ticks of homing, in which nothing is compensated.
    assert np.abs(way[1] - way[0]).max() > 10.0 * np.abs(way[2] - way[0]).max()
    assert rows is not None
    outside = rows[rows["penetration"] < 0.0]
    quantum = helped.rig.amplifier.effort_quantum
    push = helped.trial.effort - MAP.effort(outside["position"])
    assert outside["effort_wall"] == pytest.approx(MAP.effort(outside["position"]), abs=1e-12)
    assert outside["effort_wanted"] == pytest.approx(push, abs=1e-12)
    assert outside["effort_sent"] == pytest.approx(push, abs=0.51 * quantum)


def test_late_compensation_costs_the_coggings_stiffness() -> None:
    """For a rigid rig K_max(B = 0) = b/τ limits the law's part K − k; with k = −s that leaves b/τ − s."""
    limits: dict[str, Any] = {
        "rig.cogging.orders": [1],
        "rig.cogging.cosine": [0.0],
        "rig.cogging.sine": [0.02],
    }
    cogs = config.override(presets.load("koul-rigid"), {**KEYS, **limits})
    helped = replace(cogs, controller=replace(cogs.controller, cogging_compensation=True))
    slope = 0.02 * 2.0 * math.pi / 0.0628
    plain, left, taken_away = (
        theory.k_max(x, "uniform:20k").stiffness for x in (presets.load("koul-rigid"), cogs, helped)
    )
    assert left == pytest.approx(plain, rel=0.01)
    assert taken_away == pytest.approx(plain - slope, rel=0.01)
