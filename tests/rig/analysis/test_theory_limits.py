"""K_max, B_max and stability islands: closed forms, results of earlier independent simulations, and scan limits."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig import config
from rig.analysis import theory
from rig.analysis.theory import _limits as limits
from rig.config import presets
from rig.core.errors import ConfigError
from tests.conformance.tiers import first_by_default

KOUL = config.rig_model(presets.load("koul-compliant"))
RIGID = config.rig_model(presets.load("koul-rigid"))


def with_delay(model: Any, ticks: Any) -> Any:
    return replace(model, simulation=replace(model.simulation, computation_delay_ticks=ticks))


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("scheme", ["uniform:20k", "dual:20k/2k", "uniform:5k", "dual:50k/2k"])
def test_rigid_rig_has_b_over_half_a_tick_and_lag_and_delay(scheme: str, delay: int) -> None:
    """The closed form is K_max(B = 0) = b/(T1/2 + lag + delay)."""
    found = theory.k_max(with_delay(RIGID, delay), scheme, 0.0)
    tick_s = theory.linear_loop(RIGID, scheme).tick_s
    assert found.stiffness == pytest.approx(3e-3 / (tick_s / 2 + 1.09e-4 + delay * tick_s), rel=0.01)


@pytest.mark.parametrize("estimator", ["fdm", "fdm-butterworth", "kalman"])
def test_chawdas_k_width_at_no_damping_is_26_4_kn_per_m_for_every_estimator(estimator: str) -> None:
    found = theory.k_max("chawda-linear", f"uniform:1k,estimator={estimator}")
    assert found.stiffness == pytest.approx(26.4e3, rel=5e-3)


def test_chawdas_rig_with_an_unfiltered_difference_has_the_exact_limits_on_record() -> None:
    """Independent discrete eigenvalues gave 64.2 and 188 kN/m at B = 20 and 100."""
    found = theory.k_max_curve("chawda-linear", "uniform:1k,estimator=fdm", [20.0, 100.0])
    assert [limit.stiffness for limit in found] == pytest.approx([64.2e3, 188e3], rel=2e-3)


def test_koul_by_hand_at_20_khz_without_damping() -> None:
    """An earlier simulation gave 515, and 330 with one tick of delay.

    519 agrees to 1 %. Back-EMF raises it to 721; directly on the rotor, not behind the lag, it would be 755. One tick
    of delay gives 359: the simulation of test_theory_lifted grows and decays on either side of it, so that 330 belongs
    to another plant than the preset with the normal grip.
    """
    found = theory.k_max(KOUL, "uniform:20k", 0.0, operator="normal")
    assert found.stiffness == pytest.approx(515, rel=0.015)
    voltage = replace(KOUL, amplifier=replace(KOUL.amplifier, drive="voltage"))
    found = theory.k_max(voltage, "uniform:20k", 0.0, operator="normal")
    assert found.stiffness == pytest.approx(721, rel=1e-3)
    late = theory.k_max(with_delay(KOUL, 1), "uniform:20k", 0.0, operator="normal")
    assert late.stiffness == pytest.approx(359, rel=0.01)


@pytest.mark.parametrize("rig", first_by_default(["koul-rigid", "koul-compliant", "chawda-linear"]))
@pytest.mark.parametrize("operator", ["none", "normal"])
def test_dual_rate_has_the_range_of_damping_of_its_velocity_rate(rig: str, operator: str) -> None:
    """Koul's first claim: T2, the filter and inertia determine the range, T1 does not."""
    slow = 200 if rig == "chawda-linear" else 2000
    settings = f"cutoff_hz={slow // 10}"
    uniform = theory.b_max(rig, f"uniform:{slow},{settings}", operator=operator)
    for n in (5, 25):
        dual = theory.b_max(rig, f"dual:{n * slow}/{slow},{settings}", operator=operator)
        assert dual.damping == pytest.approx(uniform.damping, rel=2e-3)


def test_near_the_end_of_the_range_low_stiffness_fails_first_and_an_island_remains() -> None:
    found = theory.k_max_curve("koul-compliant", "dual:20k/2k", [2.9, 3.0, 3.5, 4.5, 5.0])
    inside, *beyond, nothing = found
    assert inside.stiffness > 800.0
    assert inside.islands == ()
    for limit in beyond:
        assert limit.stiffness == 0.0
        (island,) = limit.islands
        assert island.low > 0.0
        assert limit.highest == island.high
    assert nothing.highest == 0.0
    end = theory.b_max("koul-compliant", "dual:20k/2k")
    assert 2.9 < end.damping < 3.0
    assert 4.5 < end.with_islands < 5.0
    wall = (end.island_stiffness, 0.999 * end.with_islands)
    assert theory.spectral_radius("koul-compliant", "dual:20k/2k", *wall) < 1.0


def test_islands_and_limits_agree_with_a_map() -> None:
    stiffness, damping = np.geomspace(1.0, 3e3, 120), np.linspace(0.0, 5.0, 11)
    grid = theory.stability_map("koul-compliant", "dual:20k/2k", stiffness, damping)
    assert grid.radius.shape == (120, 11)
    for column, limit in enumerate(theory.k_max_curve("koul-compliant", "dual:20k/2k", damping)):
        stable = stiffness < limit.stiffness
        for island in limit.islands:
            stable |= (stiffness > island.low) & (stiffness < island.high)
        assert (stable == grid.stable[:, column]).all()


@settings(max_examples=15)
@given(damping=st.floats(0.01, 4.5), scheme=st.sampled_from(["dual:20k/2k", "uniform:20k", "uniform:2k"]))
def test_a_limit_lies_between_stable_and_unstable(damping: float, scheme: Any) -> None:
    limit = theory.k_max("koul-compliant", scheme, damping)
    edges = [limit.stiffness, *(k for island in limit.islands for k in (island.low, island.high))]
    k = np.array([edge for edge in edges if edge > 0.0])
    below = theory.spectral_radius("koul-compliant", scheme, k * (1 - 1e-5), damping) < 1.0
    above = theory.spectral_radius("koul-compliant", scheme, k * (1 + 1e-5), damping) < 1.0
    assert (below != above).all()


def test_a_cap_is_flagged_and_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end of the scanned stiffnesses must not look like a stability limit."""
    monkeypatch.setattr(limits, "stiffnesses", lambda lifted, damping: np.geomspace(1.0, 500.0, 100))
    below, beyond = theory.k_max_curve("koul-compliant", "dual:20k/2k", [2.0, 3.5])
    assert below.capped
    assert below.stiffness == pytest.approx(500.0)
    assert math.isnan(below.frequency_hz)
    assert not beyond.capped
    (island,) = beyond.islands
    assert island.capped
    assert island.high == pytest.approx(500.0)
    monkeypatch.setattr(limits, "DAMPING_REACH", 0.1)
    end = theory.b_max("koul-compliant", "dual:20k/2k")
    assert end.capped
    assert end.damping < 2.0


def test_a_rig_without_damping_has_no_stable_wall_until_the_wall_brings_some() -> None:
    bare = replace(RIGID, mechanics=replace(RIGID.mechanics, motor_damping=0.0, link_damping=0.0))
    none, some = theory.k_max_curve(bare, "dual:20k/2k", [0.0, 0.1])
    assert none.stiffness == 0.0
    assert none.highest == 0.0
    assert some.stiffness > 100.0
    end = theory.b_max(bare, "dual:20k/2k")
    assert end.damping == pytest.approx(0.98, rel=0.01)
    assert end.frequency_hz == pytest.approx(137, rel=0.01)


def test_a_damping_must_be_a_number() -> None:
    with pytest.raises(ConfigError, match="must be finite"):
        theory.k_max("koul-rigid", "uniform:1k", math.nan)
