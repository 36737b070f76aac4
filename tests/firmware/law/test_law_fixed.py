"""The fixed-point law in C gives the golden quanta to the bit, and a whole run equals exact arithmetic."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.sample import Phase, RowFlag
from tests.conformance.fixed_law import golden_vectors
from tests.conformance.tiers import first_by_default
from tests.firmware.law.exact_law import ExactLaw
from tests.firmware.law.law_cases import BREAKS, broken, golden_parameters
from tests.firmware.law.law_library import SOURCES, inputs
from tests.firmware.law.law_rigs import FLAGS_OF_THE_HOST


@pytest.mark.parametrize("seed", first_by_default(range(40), 10))
def test_quanta_are_the_golden_ones(law: Any, seed: int) -> None:
    vectors = golden_vectors(seed)
    p = golden_parameters(vectors)
    state = law.reset(p)
    state.phase = Phase.TRIAL
    ticks = law.run(p, inputs(vectors.counts), state)
    assert tuple(ticks["velocity_fixed"].tolist()) == vectors.velocities
    assert tuple(ticks["current"].tolist()) == vectors.quanta


@given(st.data())
def test_a_whole_run_is_exact(law: Any, data: st.DataObject) -> None:
    draw = data.draw
    vectors = golden_vectors(draw(st.integers(0, 10_000)), ticks=1)
    p = golden_parameters(vectors)
    w = p.fixed_wall
    p.slow_multiple, w.slow_speed = draw(st.integers(1, 4)), draw(st.integers(0, 2**20))
    p.home_target = draw(st.integers(-30 * 2**24, 30 * 2**24))
    p.home_step = draw(st.integers(2**20, 2**28))
    middle = p.home_target >> 24
    p.home_minimum, p.home_maximum = middle - draw(st.integers(0, 50)), middle + draw(st.integers(0, 50))
    p.settle_ticks, p.home_timeout_ticks = draw(st.integers(0, 6)), draw(st.integers(5, 300))
    p.trial_ticks, p.release_ticks = draw(st.integers(1, 40)), draw(st.integers(1, 20))
    p.free_ticks, p.hold_ticks = draw(st.integers(0, 20)), draw(st.integers(0, 20))
    p.free_minimum, p.free_maximum = -draw(st.integers(10, 300)), draw(st.integers(10, 300))
    p.window_minimum, p.window_maximum = -draw(st.integers(60, 300)), draw(st.integers(60, 300))
    p.bilateral = draw(st.integers(0, 1))
    w.home_shift = draw(st.integers(1, 30))
    w.home_stiffness, w.home_damping = draw(st.integers(0, 2**31 - 1)), draw(st.integers(0, 2**31 - 1))
    w.home_effort = draw(st.integers(0, 2000)) << w.home_shift
    w.homing_slew, w.trial_slew = draw(st.integers(2**9, 2**23)), draw(st.integers(2**9, 2**31 - 1))
    w.speed_limit = draw(st.sampled_from([2**31 - 1, 30 << p.biquad.state_bits]))
    steps = draw(st.lists(st.integers(-4, 4), min_size=30, max_size=120))
    elapsed = draw(
        st.lists(st.sampled_from([1, 1, 1, 1, 2, 5, 30]), min_size=len(steps), max_size=len(steps))
    )
    counts = vectors.wall.reference + np.cumsum(steps)
    table = inputs(counts, np.array(elapsed))
    exact = ExactLaw(p)
    expected = [exact.tick(*sample) for sample in zip(table["count"].tolist(), elapsed, strict=True)]
    ticks = law.run(p, table)
    assert list(zip(*(ticks[n].tolist() for n in ("current", "flags", "phase")), strict=True)) == expected


def test_a_lower_limit_holds_at_once_whatever_the_slew(law: Any) -> None:
    vectors = golden_vectors(3)
    p = golden_parameters(vectors)
    p.fixed_wall.stiffness = p.fixed_wall.damping = 0
    p.fixed_wall.constant = 1000 << p.fixed_wall.shift
    state = law.reset(p)
    state.phase = Phase.TRIAL
    assert law.tick(state, p, vectors.counts[0]).current == 1000
    p.current_limit, p.fixed_wall.trial_slew = 10, 1 << 15
    assert law.tick(state, p, vectors.counts[0]).current == 10


@pytest.mark.parametrize(
    ("verdict", "field", "value"),
    [(number, *change) for number, changes in enumerate(BREAKS.values(), 1) for change in changes],
)
def test_parameters_that_would_overflow_are_refused(law: Any, verdict: Any, field: Any, value: Any) -> None:
    assert law.check(golden_parameters(golden_vectors(1))) == 0
    assert law.check(broken(field, value)) == verdict


def test_flags_and_phases_are_the_hosts_numbers() -> None:
    header = SOURCES.joinpath("law.h").read_text()
    for member in (*Phase, *(~FLAGS_OF_THE_HOST | RowFlag.NONFINITE)):
        assert f"LAW_{member.name} = {int(member)}" in header
