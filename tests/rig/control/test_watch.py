"""The limits on energy and oscillations in a tick: an independent sum, the definition, and the cut to zero."""

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rig.control import _watch as watch
from rig.core.sample import Phase, RowFlag
from tests.rig.control.test_step import DELTA, Tick

STIFF = {"stiffness": 1e6}  # 1 N a count, a hundred quanta
DAMPED = {"stiffness": 0.0, "damping": 50.0}


def run_counts(tick: Tick, counts: list[int]) -> list[float]:
    """Return the effort sent for each count."""
    sent = []
    for count in counts:
        tick(count)
        sent.append(tick.effort_sent)
    return sent


@example(counts=[0, 10, 20, 30, 30, 30, -1], wall=DAMPED, side=1.0)  # what it dissipates is not carried over
@given(
    counts=st.lists(st.integers(-40, 40), min_size=2, max_size=60),
    wall=st.sampled_from([STIFF, STIFF | {"damping": 3.0}, DAMPED]),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_energy_is_effort_times_travel_reset_in_free_space(counts: list[int], wall: Any, side: Any) -> None:
    tick = Tick(wall=wall, wall_side=side)
    run_counts(tick, counts[:1])
    effort, position, given = tick.effort_sent, tick.position, 0.0
    for count in counts[1:]:
        tick(count)
        given += effort * (tick.position - position)
        if side * count <= 0:
            given = max(0.0, given)
        effort, position = tick.effort_sent, tick.position
        assert tick.energy == pytest.approx(given, abs=1e-18)
        assert not tick.has(RowFlag.ENERGY), "without a limit"


def test_too_much_energy_cuts_in_its_tick() -> None:
    counts = [-1, *([5, -5] * 50)]
    free = Tick(wall=STIFF)
    given = []
    for count in counts:
        free(count)
        given.append(free.energy)
    limit = given[len(given) // 2]
    tick = Tick(wall=STIFF, energy_limit=limit)
    for count, energy in zip(counts, given, strict=True):
        current = tick(count)
        if energy > limit:
            assert (current, tick.effort_sent, tick.limited_effort, tick.phase) == (0, 0.0, 0.0, Phase.DONE)
            assert tick.has(RowFlag.ENERGY)
            return
        assert not tick.has(RowFlag.ENERGY)
    raise AssertionError("it gave no energy")


def test_neither_homing_nor_a_wall_that_stands_still_gives_energy() -> None:
    homing = Tick(
        skip_homing=False, home_stiffness=100.0, home_effort=50.0, home_tolerance=0.0, energy_limit=1e-12
    )
    run_counts(homing, list(range(0, 2000, 7)))
    assert (homing.phase, homing.energy) == (Phase.HOMING, 0.0)
    still = Tick(wall=STIFF, energy_limit=1e-12)
    run_counts(still, [100] * 50)
    assert still.energy == 0.0


# ---------------------------------------------------------------------- oscillations

OSCILLATES = {
    "wall": {"stiffness": 1e8},
    "oscillation_limit": 4,
    "oscillation_ticks": 6,
    "oscillation_travel": 3.5 * DELTA,
}


def oscillate(tick: Tick, period: int, times: int, low: int = -4, high: int = 4) -> int | None:
    """Move the handle to and fro; return the number of the oscillation that ended the run, or None."""
    half = period // 2
    for number in range(1, times + 1):
        for count in [low] * half + [high] * (period - half):
            tick(count)
            if tick.has(RowFlag.VIOLENT):
                assert (tick.current_sent, tick.phase) == (0, Phase.DONE)
                return number
    return None


def test_so_many_oscillations_in_a_row_end_the_run() -> None:
    tick = Tick(**OSCILLATES)
    # an oscillation is seen one tick after the effort of the sample that made it
    assert oscillate(tick, 6, 10) == 4
    assert tick.oscillations == 4


@pytest.mark.parametrize(
    ("changes", "low", "high", "period"),
    [
        ({"oscillation_limit": 0}, -4, 4, 6),
        ({}, -4, 4, 8),  # later than is in a row
        ({}, -1, 2, 6),  # no travel
        ({"wall": {"stiffness": 2e7}}, -4, 4, 6),  # 80 of 100: not to the limit
        ({"wall": {"stiffness": 1e8}}, 1, 9, 6),  # never next to nothing
        ({"trial_ticks": 1, "release_ticks": 1}, -4, 4, 6),  # over before
        ({"skip_homing": False, "home_target": 1.0, "home_tolerance": 0.0}, -4, 4, 6),
    ],
)
def test_motion_without_violent_oscillation_continues(changes: Any, low: int, high: int, period: int) -> None:
    tick = Tick(**OSCILLATES | changes)
    assert oscillate(tick, period, 20, low, high) is None
    assert tick.oscillations < 4


def test_an_oscillation_rises_between_the_shares_of_the_limit_that_are_stated() -> None:
    for reaction, meaning in ((-50.0, -1), (10.0, -1), (10.1, 0), (89.9, 0), (90.0, 1), (100.0, 1)):
        assert watch.extreme(reaction, 100.0, -1.0, 1.0, 1.9) == meaning
    assert watch.extreme(100.0, 100.0, -1.0, 1.0, 2.0) == 0


def test_a_pause_begins_a_new_row() -> None:
    tick = Tick(**OSCILLATES)
    assert oscillate(tick, 6, 3) is None
    run_counts(tick, [-4] * 10)
    assert oscillate(tick, 6, 3) is None
    assert tick.oscillations == 3
    assert oscillate(tick, 6, 1) == 1


def test_the_other_side_beats_alike() -> None:
    tick = Tick(**OSCILLATES, wall_side=-1.0)
    assert oscillate(tick, 6, 10, 4, -4) == 4


@pytest.mark.parametrize(("elapsed", "ends"), [(1, True), (3, True), (4, False)])
def test_lost_samples_count_as_time(elapsed: int, ends: bool) -> None:
    tick = Tick(**OSCILLATES)  # six ticks between two oscillations are in a row
    seen = []
    for count in [-4, 4] * 8:
        tick(count, elapsed)
        seen.append(tick.has(RowFlag.VIOLENT))
    assert any(seen) == ends
