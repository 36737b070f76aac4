"""Hits on walls near the stability limit with lost samples: few losses keep K_max, many give no verdict."""

from typing import Any

import numpy as np
import pytest

from rig.control.verdict import MACHINE, Kind
from tests.benchmarks.gaps import NO_DELAYS, RUNG, Case, SeriesRig, middle
from tests.conformance.late_samples import LOST
from tests.conformance.tiers import first_by_default

STRIDE = 150  # samples between those lost: 0.7 %
RUNGS = range(-4, 5)
CASES = (
    Case("koul-rigid", "uniform:1k", 0.1, delay=1),
    Case("koul-compliant", "uniform:1k", 0.2, held=True, delay=1),
    Case("chawda-linear", "uniform:1k", 60.0),
    Case("koul-rigid", "dual:5k/1k", 0.2),
)


def delays(end: int, begin: int, length: int, scattered: Any = ()) -> Any:
    made = np.zeros(end, np.int64)
    made[begin : begin + length] = LOST
    made[list(scattered)] = LOST
    return made


def highest(hits: Any) -> int:
    passes = [recorded.passes("any") for recorded, _ in hits]
    return passes.index(False) if False in passes else len(passes)


@pytest.mark.parametrize("case", first_by_default(CASES, 2), ids=lambda case: case.text)
def test_losses_within_the_limits_leave_the_limit_of_a_ladder_and_others_are_invalid(
    case: Case,
) -> None:
    rig, center = SeriesRig(case, 0.3, 1), middle(case)
    walls = [center * RUNG**rung for rung in RUNGS]
    clean = [rig.hit(stiffness, NO_DELAYS, judged=True) for stiffness in walls]
    span = rig.span(walls[0])
    assert span is not None
    longest = rig.limits.longest_gap
    within = delays(span.end, span.contact, longest, range(span.contact + STRIDE, span.end, STRIDE))
    struck = [rig.hit(stiffness, within, judged=True) for stiffness in walls]
    assert all(recorded.numbers["gaps"] > 3 for recorded, _ in struck)
    assert not any(recorded.found & MACHINE for recorded, _ in struck)
    assert 0 < highest(clean) < len(walls)
    assert abs(highest(struck) - highest(clean)) <= 1
    for (recorded, _), (without, _) in zip(struck[:2], clean[:2], strict=True):  # more than a rung below
        assert recorded.kind is without.kind is Kind.STABLE

    often = range(span.contact + 2, span.end, 50)
    for beyond in (delays(span.end, span.tail + 5, longest + 1), delays(span.end, span.contact, 0, often)):
        for stiffness in walls:
            recorded, _ = rig.hit(stiffness, beyond, judged=True)
            assert recorded.found & MACHINE
            assert recorded.kind is Kind.INVALID or recorded.thrown_out


def test_samples_lost_in_free_space_change_no_verdict() -> None:
    case = CASES[1]
    rig, stiffness = SeriesRig(case, 0.3, 1), middle(case) / RUNG**2
    span = rig.span(stiffness)
    assert span is not None
    before_contact = delays(span.end, (span.begin + span.contact) // 2, 4)
    recorded, _ = rig.hit(stiffness, before_contact, judged=True)
    assert recorded.numbers["lost_samples"] == 4
    assert recorded.kind is Kind.STABLE
