"""Levant's differentiator: chatter, rest, convergence and error, each against a published or derived number."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.estimators import _levant as levant
from rig.control.estimators import arrays, levant_regions
from rig.control.estimators._levant import ALPHA, ERROR, LAMBDA, U1, step
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator, velocities

RESOLUTION, PERIOD = 1e-6, 1e-4
MOTION = st.lists(st.integers(-1000, 1000), min_size=1, max_size=60)


def prepare(resolution: Any = RESOLUTION, period_s: Any = PERIOD, **given: Any) -> Any:
    return levant.ESTIMATOR.prepare(given, resolution, period_s)


def run(counts: Any, resolution: Any = RESOLUTION, period_s: Any = PERIOD, **given: Any) -> Any:
    prepared = prepare(resolution, period_s, **given)
    return arrays.run(prepared, *arrays.inputs(counts, period_s))[0]


def rms(values: Any) -> Any:
    return float(np.sqrt(np.mean(np.square(values))))


def textbook(position: Any, period_s: Any, bound: Any, gains: Any, scheme: Any) -> Any:
    """Return u and u1 at each sample by equation (9) of the paper, in SI units."""
    alpha, gain = gains[0] * bound, gains[1] * math.sqrt(bound)
    x, u1, out = position[0], 0.0, [(0.0, 0.0)]
    for f in position[1:]:
        e = x - f
        if scheme == "explicit":
            u = u1 - gain * math.sqrt(abs(e)) * np.sign(e)
            u1 -= period_s * alpha * np.sign(e)
        elif scheme == "semi-implicit":
            u1 -= period_s * alpha * np.sign(e)
            u = u1 - gain * math.sqrt(abs(e)) * np.sign(e)
        else:
            a, b, c = period_s * gain, f - x - period_s * u1, period_s**2 * alpha
            if b < -c:
                u1 -= period_s * alpha
                u = u1 - gain * (-a + math.sqrt(a * a - 4 * (b + c))) / 2
            elif b > c:
                u1 += period_s * alpha
                u = u1 + gain * (-a + math.sqrt(a * a + 4 * (b - c))) / 2
            else:
                u1 += b / period_s
                u = u1
        x += period_s * u
        out.append((u, u1))
    return np.array(out)


@pytest.mark.parametrize("output", levant.OUTPUTS)
@pytest.mark.parametrize("scheme", levant.SCHEMES)
def test_every_scheme_and_output_keeps_the_promises_of_the_family(scheme: Any, output: Any) -> None:
    chatter = 0.01 if scheme == "implicit" else 0.1  # 1.7·α·T against the ramp of 7 counts a period
    check_estimator(
        levant.ESTIMATOR, {"discretisation": scheme, "output": output}, linear=False, ramp_tolerance=chatter
    )


@pytest.mark.parametrize("gains", ["levant", "hba-sc"])
@pytest.mark.parametrize("scheme", levant.SCHEMES)
def test_levant_in_counts_is_the_textbook_in_si(scheme: Any, gains: str) -> None:
    counts = np.cumsum(np.random.default_rng(2).integers(-40, 60, 2000))
    pair = levant_regions.NAMED_GAINS[gains]
    expected = textbook(counts * RESOLUTION, PERIOD, 30.0, pair, scheme)
    for column, output in enumerate(levant.OUTPUTS):
        seen = run(counts, lipschitz=30.0, gains=gains, discretisation=scheme, output=output)
        assert seen == pytest.approx(expected[:, column], abs=1e-6)  # of a count a period, 0.01 m/s


@given(
    motion=MOTION,
    jump=st.integers(-100, 100),
    lost=st.integers(1, 40),
    scheme=st.sampled_from(levant.SCHEMES),
)
def test_lost_periods_follow_a_straight_line(motion: Any, jump: int, lost: int, scheme: Any) -> None:
    counts = [0, *np.cumsum(motion).tolist()]
    whole = [*counts, *(counts[-1] + jump * np.arange(1, lost + 1)).tolist()]
    given = {"lipschitz": 30.0, "discretisation": scheme}
    seen = velocities(prepare(**given), [*counts, whole[-1]], [1] * len(counts) + [lost])
    assert seen[-1] == velocities(prepare(**given), whole)[-1]


def test_after_a_gap_too_long_to_run_through_it_starts_anew_on_the_mean_slope() -> None:
    gap = levant.LONGEST_GAP + 1
    prepared = prepare()
    v = velocities(prepared, [0, 5, 5 + 3 * gap, 8 + 3 * gap], [1, 1, gap, 1])
    assert v[2:] == pytest.approx(3 * RESOLUTION / PERIOD, rel=1e-12)
    assert prepared.state_f[U1] == 3.0
    assert prepared.state_f[ERROR] == 0.0


CHATTER = [  # gains, scheme, rms and peak of u in α·T: PHYSICS 2c
    ("hba-sc", "explicit", 1.167, 1.665),
    ("levant", "explicit", 0.707, 1.000),
    ("hba-sc", "semi-implicit", 1.234, 1.391),
    ("levant", "semi-implicit", 1.734, 1.734),
]


@pytest.mark.parametrize(
    ("period_s", "bound", "offset"), [(1e-3, 6.0, 100), (5e-5, 30.0, 1000), (1e-4, 100.0, 1)]
)
@pytest.mark.parametrize(("gains", "scheme", "expected_rms", "peak"), CHATTER)
def test_explicit_scheme_chatters_by_a_fixed_number_of_alpha_t(
    gains: Any, scheme: Any, expected_rms: Any, peak: Any, period_s: float, bound: float, offset: int
) -> None:
    """It holds for any T, C and initial offset: 0.77 N of force at B = 100, C = 6, 1 kHz."""
    counts = np.full(15_000, offset)
    counts[0] = 0
    v = run(counts, RESOLUTION, period_s, lipschitz=bound, gains=gains, discretisation=scheme)[-10_000:]
    unit = 1.1 * bound * period_s
    assert rms(v) == pytest.approx(expected_rms * unit, rel=2e-3)
    assert np.abs(v).max() == pytest.approx(peak * unit, rel=2e-3)


@pytest.mark.parametrize(
    ("period_s", "bound", "offset"), [(1e-3, 6.0, 100), (5e-5, 30.0, 1000), (1e-4, 100.0, 1)]
)
@pytest.mark.parametrize("gains", ["hba-sc", "levant"])
@pytest.mark.parametrize("output", levant.OUTPUTS)
def test_implicit_rests_exactly(gains: str, output: Any, period_s: float, bound: float, offset: int) -> None:
    counts = np.full(15_000, offset)
    counts[0] = 0
    v = run(counts, RESOLUTION, period_s, lipschitz=bound, gains=gains, output=output)
    assert (v[-1000:] == 0.0).all()


@given(
    error=st.floats(-1e6, 1e6, allow_subnormal=False),
    u1=st.floats(-1e5, 1e5, allow_subnormal=False),
    alpha=st.floats(1e-6, 1e3),
    gain=st.floats(1e-3, 100.0),
)
def test_the_implicit_step_solves_its_inclusion(error: float, u1: float, alpha: float, gain: float) -> None:
    """Check x⁺ = x + u, u = u1⁺ − λ·|e⁺|^½·σ, u1⁺ = u1 − α·σ with one σ ∈ sign(e⁺), the set [−1, 1] at zero."""
    after, u1_after, u = step(error, u1, alpha, gain, 2)
    scale = 1e-9 * (abs(error) + abs(u1) + alpha)
    assert after == pytest.approx(error + u, abs=scale)
    sigma = (u1 - u1_after) / alpha
    assert abs(sigma) <= 1.0 + scale / alpha
    if abs(after) <= scale:
        assert u == pytest.approx(u1_after, abs=scale + gain * math.sqrt(scale))
    else:
        assert sigma == pytest.approx(math.copysign(1.0, after), abs=scale / alpha)
        root = (u1_after - u) / gain * math.copysign(1.0, after)
        assert root >= -scale / gain
        assert root**2 == pytest.approx(abs(after), abs=scale * (1 + root / gain))


def si_gains(prepared: Any) -> Any:
    alpha = prepared.parameters[ALPHA] * abs(prepared.parameters[0]) / prepared.parameters[1] ** 2
    gain = prepared.parameters[LAMBDA] * math.sqrt(abs(prepared.parameters[0])) / prepared.parameters[1]
    return alpha, gain


def test_the_papers_gains_are_those_of_c_6() -> None:
    """PHYSICS 2i (A) 8: α/1.1 = 6.000, λ² = 6.0025 ≈ C."""
    assert si_gains(prepare(lipschitz=6.0, gains="hba-sc")) == pytest.approx((6.6, 2.45), rel=3e-4)
    assert si_gains(prepare(lipschitz=6.0)) == pytest.approx((6.6, 1.5 * math.sqrt(6.0)))
    custom = prepare(lipschitz=6.0, gains="custom", mu1=2.0, mu2=0.5)
    assert si_gains(custom) == pytest.approx((12.0, 0.5 * 6**0.5))


def test_a_pair_outside_its_region_is_refused_with_the_one_that_is_needed() -> None:
    with pytest.raises(ConfigError, match=r"mu1 = 2, mu2 = 3 lie outside the region 'hba'.*mu1 ≥ 2\.6"):
        prepare(gains="hba", mu1=2.0, mu2=3.0)
    with pytest.raises(ConfigError, match=r"outside the region 'hba'.*choose a larger mu2 \(above 2\)"):
        prepare(gains="hba", mu1=50.0, mu2=2.0)
    with pytest.raises(ConfigError, match=r"outside the region 'lfba'.*mu1 > 3\.5"):
        prepare(gains="lfba", mu1=3.5, mu2=2.0)
    prepare(gains="hba", mu1=2.6, mu2=3.0)
    prepare(gains="lfba", mu1=3.51, mu2=2.0)
    prepare(gains="custom", mu1=0.5, mu2=0.1)


def test_gains_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"'levant' fixes mu1 and mu2"):
        prepare(mu1=2.0)
    with pytest.raises(ConfigError, match=r"'custom' needs mu1 and mu2"):
        prepare(gains="custom", mu1=2.0)
    with pytest.raises(ConfigError, match=r"lipschitz = 0 .* out of range"):
        prepare(lipschitz=0.0)
