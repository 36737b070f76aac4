"""The fixed-point wall and guard: bit-exact arithmetic, within one quantum of the float wall."""

import json
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import _guard as guard
from rig.control import _wall as wall
from rig.control._fixed_point import Format
from rig.control._fixed_wall import DEPTH, GAIN_GREATEST, current_quanta, design_wall
from rig.core.errors import ConfigError
from tests.conformance.fixed_law import difference, exact_quanta, golden_vectors

RESOLUTION, PERIOD, QUANTUM, LIMIT = 1.5707963e-4, 5e-4, 2.34e-4, 1.3  # koul-rigid
VELOCITY = Format(32, 16)
COUNT = st.integers(-(2**31), 2**31 - 1)
WALLS = st.fixed_dictionaries(
    {
        "stiffness": st.floats(0.5, 2000),
        "damping": st.floats(0.01, 2),
        "resolution": st.sampled_from((RESOLUTION, -RESOLUTION)),
        "velocity": st.builds(Format, st.integers(20, 32), st.integers(4, 16)),
        "wall_position": st.floats(-0.2, 0.2, allow_subnormal=False),
        "side": st.sampled_from((1, -1)),
        "constant_effort": st.floats(-1, 1, allow_subnormal=False),
        "reference_count": COUNT,
        "may_pull": st.booleans(),
        "entry_only": st.booleans(),
    }
)


def designed(**given: Any) -> Any:
    common = {"stiffness": 300.0, "damping": 0.5, "resolution": RESOLUTION, "velocity": VELOCITY}
    return design_wall(
        **(common | {"period_s": PERIOD, "effort_quantum": QUANTUM, "effort_limit": LIMIT} | given)
    )


@given(given=WALLS, offset=st.integers(-2000, 2000) | COUNT, data=st.data())
def test_fixed_wall_is_exact_arithmetic_to_the_bit(given: Any, offset: int, data: st.DataObject) -> None:
    least, greatest = given["velocity"].limits
    velocity = data.draw(st.integers(least, greatest) | st.sampled_from((least, greatest, 0)))
    w = designed(**given)
    count = difference(w.reference + offset, 0)
    assert current_quanta(count, velocity, w) == exact_quanta(count, velocity, w)


@given(given=WALLS)
def test_no_sum_of_any_design_can_leave_64_bits(given: Any) -> None:
    """The worst sum: greatest depth, fastest velocity, constant effort, and half a quantum for rounding."""
    w = designed(**given)
    largest = w.stiffness * DEPTH.limits[1] - w.damping * given["velocity"].limits[0] + abs(w.constant)
    assert largest + 2**w.shift < 2**63
    assert max(w.stiffness, w.damping) <= GAIN_GREATEST
    # No bit wasted.
    assert largest + 2**w.shift >= 2**61 or max(w.stiffness, w.damping) >= 2**29 or w.shift == 40


@given(given=WALLS, offset=st.integers(-2000, 2000), speed=st.floats(-3, 3, allow_subnormal=False))
def test_fixed_wall_is_the_float_wall_within_a_quantum(given: Any, offset: int, speed: float) -> None:
    """Away from the rounded surface; gains are exact to 1e-3, so the limit of 1.3 N·m bounds the error."""
    w = designed(**given)
    delta, side = given["resolution"], given["side"]
    velocity = round(speed * PERIOD / delta / given["velocity"].lsb)
    least, greatest = given["velocity"].limits
    velocity = min(max(velocity, least), greatest)
    penetration = side * (offset * delta - given["wall_position"])
    if abs(penetration) < 2**-8 * abs(delta):
        return
    parameters = np.array(
        [given["stiffness"], given["damping"], given["may_pull"], given["entry_only"]], float
    )
    rate = side * velocity * given["velocity"].lsb * delta / PERIOD
    reaction = wall.spring_damper(penetration, rate, 1, np.zeros(1), parameters)
    effort = given["constant_effort"] - side * reaction
    expected = guard.current_quanta(guard.clip_effort(effort, w.limit * QUANTUM), QUANTUM)
    # The surface lies within half an LSB of depth.
    surface = given["stiffness"] * abs(delta) * 2**-9 / QUANTUM
    gains = 1e-3 * (given["stiffness"] * abs(penetration) + given["damping"] * abs(rate)) / QUANTUM
    count = difference(w.reference + offset, 0)
    assert abs(current_quanta(count, velocity, w) - expected) <= 1 + surface + gains


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"effort_limit": 10.0}, r"effort limit 10 is 42735 current quanta; allowed are 0 to 32767"),
        ({"stiffness": 1e13}, r"stiffness is .* current\); allowed are 0 to 2147483647.*softer"),
        ({"stiffness": -1.0}, r"stiffness is .* current\); allowed are 0 to"),
        ({"damping": 1e-9}, r"damping is .* quanta per LSB.* can represent only as the integer 0"),
        (
            {"stiffness": 0.5625, "damping": 7.0, "velocity": Format(20, 0)},
            r"stiffness is .* only as the integer",
        ),
        ({"wall_position": 2000.0}, r"wall position in counts = .* does not fit the format Q24\.8"),
    ],
)
def test_wall_beyond_its_words_is_refused(given: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        designed(**given)


def test_golden_vectors_are_the_same_for_ever() -> None:
    """If this checksum changes, the law that devices run has changed: its format, rounding or design."""
    text = json.dumps([(v.wall, v.counts, v.velocities, v.quanta) for v in map(golden_vectors, range(8))])
    assert crc32(text.encode()) == 3486532006
