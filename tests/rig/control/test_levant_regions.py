"""Convergence regions of Levant's differentiator: the published tables, two proofs, and the computed worst case."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import brentq

from rig.control.estimators import levant_regions as regions


def test_boundaries_cross_at_3_2656_2_7443() -> None:
    mu1, mu2 = regions.find_crossing()
    assert (mu1, mu2) == pytest.approx((3.2656, 2.7443), abs=5e-5)
    assert regions.hba_mu1(mu2) == pytest.approx(regions.lfba_mu1(mu2), rel=1e-12)
    assert mu2 == pytest.approx(brentq(lambda m: regions.hba_mu1(m) - regions.lfba_mu1(m), 2.1, 5.0))


@given(mu1=st.floats(0.5, 20.0), mu2=st.floats(0.05, 20.0), bound=st.floats(0.01, 1e3))
def test_the_regions_are_the_papers_inequalities_for_every_c(mu1: float, mu2: float, bound: float) -> None:
    """Equations (10) and (14) are printed in α, λ and C; in mu1 and mu2 the regions must not depend on C."""
    alpha, gain = mu1 * bound, mu2 * math.sqrt(bound)
    hba = alpha > bound and gain**2 >= 4 * bound * (alpha + bound) / (alpha - bound)
    lfba = alpha > 3 * bound + 2 * bound**2 / gain**2
    edge = 1e-9
    if abs(mu1 - regions.hba_mu1(mu2)) > edge * mu1:
        assert regions.in_hba(mu1, mu2) == hba
    if abs(mu1 - regions.lfba_mu1(mu2)) > edge * mu1:
        assert regions.in_lfba(mu1, mu2) == lfba


def test_levants_own_pair_lies_in_neither_region_but_converges() -> None:
    for name, contraction in (("hba-sc", 0.989), ("levant", 0.537)):
        pair = regions.NAMED_GAINS[name]
        assert not regions.in_hba(*pair)
        assert not regions.in_lfba(*pair)
        assert regions.half_cycle_contraction(*pair) == pytest.approx(contraction, abs=1e-3)


@pytest.mark.parametrize(
    ("mu1", "mu2"),
    [(1.05, 1.046), (1.1, 0.991), (1.2, 0.915), (1.5, 0.780), (2, 0.656), (3, 0.527), (5, 0.404)],
)
def test_the_worst_case_boundary_is_that_of_the_table(mu1: float, mu2: float) -> None:
    assert regions.worst_case_mu2(mu1) == pytest.approx(mu2, abs=1.1e-3)


def bang_bang(mu1: float, mu2: float, switch: float) -> float:
    """Return |x2| after a half cycle, f̈ = −C, then +C from the ray x2 = switch·w: two linear flows, by expm."""

    def flow(gain: Any, z: Any, stop: Any) -> Any:
        """Return the state where stop falls to zero, by equal steps, then exactly; None if it never does."""
        a = np.array([[-0.5 * mu2, 0.5], [-gain, 0.0]])
        one = expm(0.1 * a)
        for _ in range(1000):
            if stop(one @ z) <= 0.0:
                return expm(a * brentq(lambda tau, z: stop(expm(a * tau) @ z), 0.0, 0.1, (z,))) @ z
            z = one @ z
        return None

    turned = flow(mu1 - 1.0, np.array([0.0, 1.0]), lambda z: z[1] - switch * z[0])
    if turned is None:
        return 0.0
    end = flow(mu1 + 1.0, turned, lambda z: z[0])
    return 0.0 if end is None else abs(float(end[1]))


@pytest.mark.parametrize(("mu1", "mu2"), [(1.1, 1.0), (1.1, 1.5), (2.0, 1.0), (3.0, 0.6)])
def test_no_bang_bang_disturbance_is_worse_than_the_computed_one(mu1: float, mu2: float) -> None:
    computed = regions.half_cycle_contraction(mu1, mu2)
    tried = max(bang_bang(mu1, mu2, switch) for switch in np.linspace(-0.5, 3.0, 36))
    assert tried <= computed * (1 + 1e-5)
    assert tried == pytest.approx(computed, rel=5e-3)


def test_both_proven_regions_lie_inside_the_computed_one() -> None:
    for mu2 in np.linspace(0.3, 10.0, 40):
        for bound in (regions.hba_mu1(mu2), regions.lfba_mu1(mu2)):
            if math.isfinite(bound):
                assert regions.half_cycle_contraction(bound * 1.0001, mu2) < 1.0


def test_a_gain_that_the_disturbance_outweighs_never_converges() -> None:
    assert regions.half_cycle_contraction(1.0, 5.0) == math.inf
    assert regions.worst_case_mu2(0.9) == math.inf
    assert regions.hba_mu1(2.0) == math.inf
    assert regions.lfba_mu1(0.0) == math.inf
    assert not regions.in_lfba(100.0, 0.0)
