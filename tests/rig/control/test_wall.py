"""The virtual wall, a spring and damper that acts only inside: Koul et al., equation (1)."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import laws
from rig.control.law import PreparedLaw
from rig.core.errors import ConfigError
from rig.realtime.plugs import LAW_CLAMPED

DEPTH = st.floats(0.0, 0.1, exclude_min=True, allow_subnormal=False)
VELOCITY = st.floats(-20.0, 20.0, allow_subnormal=False)
STIFFNESS = st.floats(0.0, 1e5, allow_subnormal=False)
DAMPING = st.floats(0.0, 1e3, allow_subnormal=False)


def wall(stiffness: float, damping: float, pull: str = "clamp", damping_on: str = "both") -> PreparedLaw:
    section = {"stiffness": stiffness, "damping": damping, "pull": pull, "damping_on": damping_on}
    return laws.get("spring-damper").prepare(section)


def reaction(law: PreparedLaw, penetration: float, velocity: float) -> float:
    return law.law.function(penetration, velocity, 1, law.state, law.parameters)


@given(
    penetration=st.floats(-1.0, 0.0, allow_subnormal=False),
    velocity=VELOCITY,
    pull=st.sampled_from(["clamp", "allow"]),
)
def test_outside_there_is_no_wall(penetration: float, velocity: Any, pull: Any) -> None:
    """On the surface itself the reaction is zero too: inside means penetration above zero."""
    law = wall(1000.0, 10.0, pull)
    assert reaction(law, penetration, velocity) == 0.0
    assert law.state[LAW_CLAMPED] == 0.0


@given(depth=DEPTH, velocity=VELOCITY, stiffness=STIFFNESS, damping=DAMPING)
def test_inside_it_is_a_spring_and_a_damper(depth: Any, velocity: Any, stiffness: Any, damping: Any) -> None:
    law = wall(stiffness, damping, pull="allow")
    assert reaction(law, depth, velocity) == stiffness * depth + damping * velocity


@given(depth=DEPTH, velocity=VELOCITY, stiffness=STIFFNESS, damping=DAMPING)
def test_clamping_never_pulls_and_is_marked(depth: Any, velocity: Any, stiffness: Any, damping: Any) -> None:
    clamped, pulling = wall(stiffness, damping), wall(stiffness, damping, pull="allow")
    free = reaction(pulling, depth, velocity)
    assert reaction(clamped, depth, velocity) == max(free, 0.0)
    assert clamped.state[LAW_CLAMPED] == (1.0 if free < 0.0 else 0.0)
    assert pulling.state[LAW_CLAMPED] == 0.0


@given(depth=DEPTH, velocity=VELOCITY, stiffness=STIFFNESS, damping=DAMPING)
def test_damping_on_entry_has_none_on_exit(depth: Any, velocity: Any, stiffness: Any, damping: Any) -> None:
    law = wall(stiffness, damping, damping_on="entry")
    assert reaction(law, depth, velocity) == stiffness * depth + damping * max(velocity, 0.0)


def test_a_velocity_that_is_not_a_number_is_passed_on_for_the_guard_to_stop() -> None:
    assert np.isnan(reaction(wall(100.0, 1.0), 0.01, np.nan))


def test_an_unknown_law_lists_the_known_ones() -> None:
    assert laws.names()[0] == "spring-damper"
    with pytest.raises(ConfigError, match=r"unknown law 'spring'.*spring-damper"):
        laws.get("spring")
