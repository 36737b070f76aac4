"""Limit cycles of the encoder's quantisation: their measurement, and predictions compared with simulations."""

import numpy as np
import pytest

from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import PlanError
from rig.extras.papers.disagreement import limit_cycles as limit_cycles_module
from rig.extras.papers.disagreement.limit_cycles import Cycle, HeldWall, LimitCycles, limit_cycles

RATE_HZ = 20_000.0
EDGE, BELOW, ABOVE = 3.5, 3, 4  # counts: an edge of the encoder, and the counts on both sides of it
AMPLITUDE, FREQUENCY_HZ = 0.3, 600.0  # counts, Hz: of an oscillation about the edge
COMPLIANT = presets.load("koul-compliant")
UNIFORM, DUAL = Scheme.parse("uniform:20k"), Scheme.parse("dual:20k/2k")
KOUL_WALL = (400.0, 0.6)  # K (N·m/rad), B (N·m·s/rad)
WALL_OF_TWO_CYCLES = (574.7, 2.22)  # K, B: the capstan can ring, too
SOFT_WALL = (80.0, 0.5)  # K, B: friction can hold the handle


def test_a_cycle_is_measured_though_its_phase_wanders() -> None:
    wander = np.cumsum(np.random.default_rng(1).normal(0.0, 0.02, 40_000))
    phase = 2.0 * np.pi * FREQUENCY_HZ * np.arange(40_000) / RATE_HZ + wander
    motion = EDGE + AMPLITUDE * np.cos(phase)
    counts = np.where(motion > EDGE, ABOVE, BELOW)
    cycle = Cycle.of(motion, counts, RATE_HZ)
    assert cycle.amplitude == pytest.approx(AMPLITUDE, rel=0.01)
    assert cycle.frequency_hz == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert cycle.share > 0.98
    with_slow_motion = Cycle.of(motion + AMPLITUDE * np.cos(0.1 * phase), counts, RATE_HZ)
    assert with_slow_motion.share == pytest.approx(0.5, abs=0.02)  # half of the variance is in the band


@pytest.fixture(scope="module")
def cycles() -> LimitCycles:
    return limit_cycles(COMPLIANT, [UNIFORM, DUAL], [KOUL_WALL])


def test_amplitude_and_frequency_are_as_predicted(cycles: LimitCycles) -> None:
    """Largest measured errors: frequency 2 %, amplitude 9 %; the limits leave a margin."""
    assert [wall.predicted.alone for wall in cycles.walls] == [True, True, False, False]
    for wall in cycles.walls:
        assert wall.simulated.share > 0.85
        assert wall.frequency_error == pytest.approx(0.0, abs=0.03), wall
        assert wall.amplitude_error == pytest.approx(0.0, abs=0.12), wall


def test_the_release_decides_which_of_two_cycles_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """The capstan can ring at 142 Hz, which friction should end; the predicted limit cycle has 678 Hz."""

    def simulate_from(depth_counts: float) -> HeldWall:
        # The handle is released this many counts deeper than the position where the wall balances the push.
        monkeypatch.setattr(limit_cycles_module, "AWAY", depth_counts)
        _, rubbed = limit_cycles(COMPLIANT, [DUAL], [WALL_OF_TWO_CYCLES]).walls
        assert not rubbed.predicted.alone
        return rubbed

    from_three_counts, from_two_counts = simulate_from(3.0), simulate_from(2.0)
    assert from_three_counts.simulated.frequency_hz < 0.4 * from_two_counts.simulated.frequency_hz
    assert from_two_counts.frequency_error == pytest.approx(0.0, abs=0.1)


def test_a_soft_wall_rests_where_friction_can_hold_it() -> None:
    soft = limit_cycles(presets.load("koul-rigid"), [DUAL], [SOFT_WALL])
    free, rubbed = soft.walls
    assert free.simulated.amplitude > 0.3
    assert rubbed.predicted.may_rest
    assert rubbed.simulated.amplitude == 0.0
    assert (soft.tally(True).both_rest, soft.tally(True).only_predicted) == (1, 0)


@pytest.mark.parametrize("wall", [(0.0, 0.1), (-1.0, 0.1), (float("nan"), 0.0), (100.0, -0.1)])
def test_a_wall_without_stiffness_or_with_negative_damping_is_refused(wall: tuple[float, float]) -> None:
    with pytest.raises(PlanError, match="stiffness above zero"):
        limit_cycles(presets.load("koul-rigid"), (), [wall])
