"""Walls near their limit, hit with samples lost: within the limits K_max stays, beyond them there is no verdict."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

if numba.config.DISABLE_JIT:
    pytest.skip("plug points are function types of compiled code", allow_module_level=True)

from rig.control.verdict import MACHINE, Kind
from tests.benchmarks.gap_ladders import BESIDE, RUNG, World, highest, spans
from tests.conformance.late_samples import LOST

STRIDE = 150  # ticks between samples lost: 0.7 %


def struck(world: World, begin: int, length: int, ticks: Any = ()) -> Any:
    delays = np.zeros(world.ticks, np.int64)
    delays[begin : begin + length] = LOST
    delays[list(ticks)] = LOST
    return delays


@pytest.mark.parametrize("name", ["1 kHz rigid", "1 kHz compliant, held", "1 kHz linear"])
def test_losses_within_the_limits_leave_the_limit_of_a_ladder_and_those_beyond_are_invalid(name: str) -> None:
    world = World(name)
    middle = world.stiffest()
    rungs = [middle * RUNG**rung for rung in range(-BESIDE, BESIDE + 1)]
    before = [world.hit(stiffness) for stiffness in rungs]
    at = spans(before[0], world.tick_s, world.limits.tail_s)
    contact, end = at["contact"]
    longest = int(world.limits.longest_gap_s / world.tick_s + 1e-9)
    assert longest >= 1

    within = struck(world, contact, longest, range(contact + STRIDE, end, STRIDE))
    after = [world.hit(stiffness, within, judged=True) for stiffness in rungs]
    assert not any(hit.recorded.found & MACHINE for hit in after)
    assert abs(highest(after) - highest(before)) <= 1
    for hit, clean in zip(after[:2], before[:2], strict=True):  # more than a rung below
        assert hit.recorded.kind is clean.recorded.kind is Kind.STABLE

    many = range(contact + 2, end, 50)
    for beyond in (struck(world, at["tail"][0] + 5, longest + 1), struck(world, contact, 0, many)):
        for stiffness in rungs:
            hit = world.hit(stiffness, beyond, judged=True)
            assert hit.recorded.found & MACHINE
            assert hit.recorded.kind in (Kind.INVALID, Kind.UNSTABLE)
            assert hit.recorded.kind is Kind.INVALID or hit.recorded.thrown_out


def test_what_is_lost_in_free_space_changes_no_verdict() -> None:
    world = World("1 kHz compliant, held")
    stiffness = world.stiffest() / RUNG**2
    first, contact = spans(world.hit(stiffness), world.tick_s, world.limits.tail_s)["approach"]
    hit = world.hit(stiffness, struck(world, (first + contact) // 2, 4), judged=True)
    assert hit.recorded.numbers["lost_samples"] == 4
    assert hit.recorded.kind is Kind.STABLE
