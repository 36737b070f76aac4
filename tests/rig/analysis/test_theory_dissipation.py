"""Passivity with lag and delay, against the work of motions in fine steps, and against other definitions."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter

from rig import config
from rig.analysis import theory
from rig.analysis.theory._dissipation import Damping, passive_stiffness
from rig.config import presets
from tests.conformance.tiers import first_by_default

RIGID = config.rig_model(presets.load("koul-rigid"))
COMPLIANT = config.rig_model(presets.load("koul-compliant"))


def late_rig(damping: float = 3e-3, lag_s: float = 1e-4, ticks: int = 0, **mechanics: Any) -> Any:
    return replace(
        RIGID,
        mechanics=replace(RIGID.mechanics, motor_damping=damping, link_damping=0.0, **mechanics),
        amplifier=replace(RIGID.amplifier, lag_s=lag_s),
        simulation=replace(RIGID.simulation, computation_delay_ticks=ticks),
    )


def passive_k(model: Any, scheme: Any, damping: Any) -> Any:
    return theory.passivity_bound(model, scheme, damping).stiffness


FINE = 16  # steps of a tick


def work_matrices(
    k: Any, b: Any, *, n: Any, lag_s: Any, ticks: Any, cutoff_hz: Any, extrapolate: bool = False,
    back_emf: float = 0.0,
) -> Callable[[float], Any]:  # fmt: skip
    """Return mean efforts in each fine step by unit velocities in each; all repeats but for a phase θ each period.

    One state [position; Butterworth (2) and the position before; velocity, slope, velocity before; lag, back-EMF
    in it; commands in transit] is stepped in time with velocities as inputs: no harmonics, no closed form.
    """
    tick_s = 5e-5
    ((b0, b1, b2, _, a1, a2),) = butter(2, cutoff_hz, fs=1.0 / (n * tick_s), output="sos")
    step = tick_s / FINE
    rho = math.exp(-step / lag_s) if lag_s else 0.0
    mean = lag_s / step * (1.0 - rho) if lag_s else 0.0
    size, steps = 8 + ticks, n * FINE
    # Rows: states in states and inputs.
    x = np.hstack([np.eye(size), np.zeros((size, steps))]).astype(complex)
    efforts = []
    for i in range(n):
        if i == 0:
            raw = (x[0] - x[1]) / (n * tick_s)
            new = b0 * raw + x[2]
            x[1], x[2], x[3] = x[0].copy(), b1 * raw - a1 * new + x[3], b2 * raw - a2 * new
            x[5], x[4], x[6] = (new - x[6]) / n, new, new
        elif extrapolate:
            x[4] = x[4] + x[5]
        command = k * x[0] + b * x[4]
        if ticks:
            acting = x[8].copy()
            x[8:-1] = x[9:]
            x[-1] = command
        else:
            acting = command.copy()
        for j in range(FINE):
            settled = acting.copy()
            settled[size + i * FINE + j] += back_emf
            efforts.append(settled + (x[7] - settled) * mean)
            x[7] = settled + (x[7] - settled) * rho
            x[0, size + i * FINE + j] += step
    efforts = np.array(efforts)

    def at(theta: float) -> Any:
        begin = np.linalg.solve(np.exp(1j * theta) * np.eye(size) - x[:, :size], x[:, size:])
        return efforts[:, :size] @ begin + efforts[:, size:]

    return at


def worst_work(k: Any, b: Any, **case: Any) -> Any:
    """Return the damping with which no motion can extract work: the largest eigenvalue over all phases."""
    work = work_matrices(k, b, **case)

    def needed(theta: Any) -> Any:
        matrix = work(theta)
        return float(np.linalg.eigvalsh(-(matrix + matrix.conj().T) / 2)[-1])

    phases = np.concatenate([np.geomspace(1e-3, 0.3, 8), np.linspace(0.35, math.pi, 24)])
    worst = np.array([needed(theta) for theta in phases])
    at = int(worst.argmax())
    near = np.linspace(phases[max(at - 1, 0)], phases[min(at + 1, len(phases) - 1)], 15)
    return max(worst[at], *(needed(theta) for theta in near))


@pytest.mark.parametrize(
    ("scheme", "n", "lag_s", "ticks", "cutoff_hz"),
    first_by_default(
        [
            ("uniform:20k,cutoff_hz=2000", 1, 1e-4, 0, 2000.0),
            ("dual:20k/4k,cutoff_hz=400,prediction=extrapolate", 5, 1.09e-4, 1, 400.0),
            ("uniform:20k,cutoff_hz=2000", 1, 1e-5, 1, 2000.0),
            ("uniform:20k,cutoff_hz=1000", 1, 1e-3, 0, 1000.0),
            ("dual:20k/4k,cutoff_hz=400", 5, 1.09e-4, 0, 400.0),
            ("dual:20k/4k,cutoff_hz=400", 5, 0.0, 2, 400.0),
            ("dual:20k/4k,cutoff_hz=400", 5, 1e-3, 1, 400.0),
            ("dual:20k/4k,cutoff_hz=400,prediction=extrapolate", 5, 0.0, 0, 400.0),
        ],
        2,
    ),
)
@pytest.mark.parametrize("share", first_by_default([0.9, 0.0, 0.5]))
def test_worst_motion_at_the_limit_gets_the_work_that_the_rig_dissipates(
    scheme: str, n: int, lag_s: float, ticks: int, cutoff_hz: float, share: float
) -> None:
    """Brute force over the definition: every motion in steps of 1/16 tick, without knowledge of the worst one.

    The limit is necessary and sufficient: with slightly less damping that motion extracts work.
    """
    model = late_rig(lag_s=lag_s, ticks=ticks)
    b = share * theory.passivity_bound(model, scheme).largest_damping
    k = passive_k(model, scheme, b)
    case = {"n": n, "lag_s": lag_s, "ticks": ticks, "cutoff_hz": cutoff_hz, "extrapolate": "extra" in scheme}
    assert worst_work(k, b, **case) == pytest.approx(3e-3, rel=2e-3)


@pytest.mark.parametrize(
    ("scheme", "n", "lag_s", "cutoff_hz"),
    first_by_default(
        [
            ("uniform:20k,cutoff_hz=2000", 1, 1e-4, 2000.0),
            ("dual:20k/4k,cutoff_hz=400", 5, 1.09e-4, 400.0),
            ("dual:20k/4k,cutoff_hz=400", 5, 1e-3, 400.0),
        ]
    ),
)
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_back_emf_dissipates_only_as_fast_as_its_current(
    scheme: str, n: int, lag_s: float, cutoff_hz: float, share: float
) -> None:
    """The same brute force on a voltage-driven rig, in which viscous damping dissipates the rest."""
    model = voltage_driven(late_rig(lag_s=lag_s))
    b = share * theory.passivity_bound(model, scheme).largest_damping
    k = passive_k(model, scheme, b)
    assert k > 0.0
    case = {"n": n, "lag_s": lag_s, "ticks": 0, "cutoff_hz": cutoff_hz, "back_emf": 0.0253}
    assert worst_work(k, b, **case) == pytest.approx(3e-3, rel=5e-3)
    at_once = late_rig(damping=0.0283, lag_s=lag_s)
    assert k < passive_k(at_once, scheme, b)
    assert theory.passivity_bound(model, scheme).bounds[0].meaning == "exact"


def voltage_driven(model: Any) -> Any:
    return replace(model, amplifier=replace(model.amplifier, drive="voltage", back_emf_damping=0.0253))


def test_back_emf_alone_makes_no_wall_passive_behind_a_lag() -> None:
    assert passive_k(voltage_driven(late_rig(damping=0.0)), "uniform:20k", 0.0) == 0.0
    assert theory.passivity_bound(voltage_driven(late_rig(damping=0.0)), "uniform:20k").largest_damping == 0.0
    assert passive_k(voltage_driven(late_rig(damping=0.0, lag_s=0.0)), "uniform:20k", 0.0) > 0.0


@pytest.mark.parametrize("scheme", ["uniform:20k", "dual:20k/2k", "dual:20k/2k,prediction=extrapolate"])
def test_without_lag_and_delay_it_is_the_closed_form_for_one_rate_and_for_many(scheme: str) -> None:
    """K·T1/2 is the same for every motion of a period, so the demands of K and B add exactly, also for N > 1."""
    loop = theory.linear_loop(late_rig(lag_s=0.0), scheme)
    for b in (0.0, 1e-3, 4e-3, 6e-3):
        closed = (3e-3 - theory.beta(loop) * b) / 0.25e-4
        assert passive_stiffness(loop, [b], Damping(3e-3))[0] == pytest.approx(closed, rel=1e-5)
        first = theory.passivity_bound(late_rig(lag_s=0.0), scheme, b).bounds[0]
        assert (first.meaning, first.stiffness) == ("exact", pytest.approx(closed, rel=1e-9))


def test_the_passive_walls_form_a_convex_set_that_ends_at_the_largest_damping() -> None:
    model = late_rig(lag_s=1.09e-4, ticks=1)
    found = theory.passivity_bound(model, "dual:20k/2k")
    b = np.linspace(0.0, found.largest_damping, 6)
    k = np.array([passive_k(model, "dual:20k/2k", damping) for damping in b[:-1]] + [0.0])
    assert (np.diff(k, 2) <= 1e-3 * k[0]).all()
    assert passive_k(model, "dual:20k/2k", 1.001 * found.largest_damping) == 0.0
    assert passive_k(model, "dual:20k/2k", 0.999 * found.largest_damping) > 0.0


def test_the_line_with_lag_errs_to_either_side_and_is_called_necessary_at_b_zero_only() -> None:
    scheme = "uniform:20k,cutoff_hz=2000"
    for lag_s, b in ((1e-4, 0.0), (1e-4, 2e-3), (1e-3, 1e-3)):
        model = late_rig(lag_s=lag_s)
        bounds = {bound.name: bound for bound in theory.passivity_bound(model, scheme, b).bounds}
        exact = bounds["passivity, lag and delay counted"]
        line, ideal = bounds["Colgate and Schenkel, lag and delay"], bounds["Colgate and Schenkel"]
        assert exact.meaning == "exact"
        assert {line.meaning, ideal.meaning} == {"necessary" if b == 0.0 else "approximate"}
        if b == 0.0:
            assert 0.99 * line.stiffness < exact.stiffness <= line.stiffness <= ideal.stiffness
        else:
            assert exact.stiffness > 1.5 * line.stiffness
    compliant = theory.passivity_bound(COMPLIANT, "dual:20k/2k", 1e-3)
    assert [bound.meaning for bound in compliant.bounds[:3]] == ["sufficient", "approximate", "approximate"]
    assert compliant.binding is compliant.bounds[0]


def test_a_rig_without_damping_has_no_passive_wall() -> None:
    assert passive_k(late_rig(damping=0.0), "uniform:20k", 0.0) == 0.0
    assert passive_k(late_rig(), "uniform:20k", 1.0) == 0.0
    assert passive_k(late_rig(), "uniform:20k", -1.0) == 0.0
