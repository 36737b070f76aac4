"""The simulated hardware layer at a rate other than the one that it was built for."""

import pytest

from sim_backend.board.hardware import Hardware
from tests.conformance.rigs import rotary_rig


@pytest.mark.parametrize(
    ("first", "rate"), [(1_000, 1_000), (1_000, 10_000), (10_000, 1_000), (1_000, 4_000)]
)
def test_a_set_point_is_as_late_at_another_rate(first: int, rate: int) -> None:
    hardware = Hardware(rotary_rig(set_point_delay_s=5e-4), first, seed=0, initial_position=None)
    hardware.set_rate(rate)
    late = 0
    while hardware.measured == 0 and late < 100:
        hardware.advance(100)
        late += 1
    assert late - 1 == max(1, round(5e-4 * rate))
