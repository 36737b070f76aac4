"""The estimators of the C law equal the host's: fixed point to the bit, float32 to a stated rounding."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import estimators
from rig.control.estimators.arrays import inputs as estimator_inputs
from rig.control.estimators.arrays import run
from tests.conformance.estimator import REQUIRED
from tests.conformance.fixed_law import ExactFilter, golden_vectors
from tests.conformance.tiers import first_by_default
from tests.firmware.law.law_design import FLOAT, copy_filter, scale_of, set_estimator
from tests.firmware.law.law_library import Parameters, inputs

EPS = 2.0**-24  # half a unit in the last place of float32, relative
PERIOD_S, DELTA = 1 / 2000, 1e-6
WIDE = 3.0e38


def estimator_only(prepared: Any, divider: int = 1) -> Any:
    """Return float parameters of a law in which only the estimator has an effect."""
    p = Parameters(arithmetic=FLOAT, sense=1, velocity_divider=divider, slow_multiple=1, release_ticks=1)
    p.window_minimum, p.window_maximum = -(2**31), 2**31 - 1
    p.home_timeout_ticks = 2**32 - 1
    p.wall.side, p.wall.speed_limit, p.wall.velocity_lsb = 1.0, WIDE, 1.0
    set_estimator(p, prepared)
    return p


def motion(seed: Any, samples: int = 1500) -> Any:
    """Return counts and elapsed periods of a handle that moves, rings, rests and jumps, with gaps (5 %)."""
    random = np.random.default_rng(seed)
    elapsed = np.where(random.random(samples) < 0.05, random.integers(2, 12, samples), 1)
    elapsed[samples // 2] = 1200  # longer than any memory
    t = np.cumsum(elapsed) * PERIOD_S
    swing = 0.004 * np.sin(2 * np.pi * 3.0 * t) + 0.0005 * np.sin(2 * np.pi * 61.0 * t)
    place = np.where(t % 0.5 < 0.1, 0.002, swing) / DELTA
    place += np.cumsum(random.random(samples) < 0.004) * 300
    return (np.floor(place) + 2**31 - 3000).astype(np.int64), elapsed  # wraps on its way


def run_both(law: Any, name: Any, counts: Any, elapsed: Any, **given: Any) -> Any:
    """Return velocities (counts per period) and windows of the host's estimator and of the one in C."""
    prepared = estimators.get(name).prepare(given, DELTA, PERIOD_S)
    p = estimator_only(prepared)
    table = inputs(counts, elapsed)
    table["active"] = np.random.default_rng(7).integers(-500, 501, len(counts))  # quanta, of 1 N each
    ticks = law.run(p, table)
    arrays = estimator_inputs(counts, PERIOD_S, None, elapsed)
    velocities, windows = run(prepared, *arrays, table["active"].astype(float))
    return velocities / scale_of(prepared), windows, ticks


# Error allowed, in units of EPS times the largest velocity that was. A difference and a FOAW slope are one division of
# whole numbers: rounded once. The others: three times what was measured with 20 seeds. Levant's with a C that cannot
# follow the jumps of the motion switches its sign at another moment for every rounding, which the steps then forget.
CASES = {
    "fdm": ("fdm", {}, 1),
    "butterworth-200": ("fdm-butterworth", {"cutoff_hz": 200.0}, 8),
    "butterworth-20": ("fdm-butterworth", {"cutoff_hz": 20.0}, 32),
    "butterworth-order-1": ("fdm-butterworth", {"order": 1}, 4),
    "butterworth-order-3": ("fdm-butterworth", {"order": 3}, 12),
    "butterworth-order-8": ("fdm-butterworth", {"order": 8, "cutoff_hz": 300.0}, 16),
    "foaw-end": ("foaw-end", {}, 1),
    "foaw-end-global": ("foaw-end", {"stop": "global", "window_limit": 64.0}, 1),
    "foaw-end-band": ("foaw-end", {"band": 1.3, "window_limit": 32.0}, 1),
    "foaw-best": ("foaw-best", {}, 1),
    "foaw-best-global": ("foaw-best", {"stop": "global", "window_limit": 40.0}, 1),
    "foaw-best-last": ("foaw-best", {"anchor": "last", "band": 1.5}, 1),
    "levant-implicit": ("levant", {}, 8),
    "levant-implicit-tight": ("levant", {"lipschitz": 1.0, "output": "u1"}, 1000),
    "kalman-steady": ("kalman", {"gain": "steady"}, 32),
    "kalman-steady-slow": ("kalman", {"gain": "steady", "bandwidth_hz": 20.0}, 32),
    "kalman-steady-double": ("kalman", {"gain": "steady", "model": "double"}, 12),
    "tracking": ("tracking", {}, 12),
    "disturbance": ("disturbance", REQUIRED["disturbance"], 32),
    "disturbance-two-mass": ("disturbance-two-mass", REQUIRED["disturbance-two-mass"], 32),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", first_by_default([1, 2]))
def test_float_velocity_equals_the_host_to_rounding(law: Any, case: Any, seed: int) -> None:
    name, settings_, allowed = CASES[case]
    host, windows, ticks = run_both(law, name, *motion(seed), **settings_)
    worst = np.abs(ticks["velocity"] - host).max() / (EPS * np.abs(host).max())
    assert worst <= allowed, worst
    assert (ticks["window"] == windows).all()


@given(st.data())
@pytest.mark.parametrize("name", ["foaw-end", "foaw-best"])
def test_windows_of_foaw_are_the_hosts(law: Any, name: str, data: st.DataObject) -> None:
    """Whole counts put samples exactly on the edge of the band, where rounding would show."""
    steps = data.draw(st.lists(st.integers(-3, 3), min_size=2, max_size=80))
    elapsed = data.draw(st.lists(st.integers(1, 4), min_size=len(steps), max_size=len(steps)))
    given_ = {
        "band": data.draw(st.sampled_from([0.5, 1.0, 1.5, 2.0])),
        "window_limit": float(data.draw(st.integers(1, 64))),
        "stop": data.draw(st.sampled_from(["first", "global"])),
    }
    host, windows, ticks = run_both(law, name, np.cumsum(steps), np.array(elapsed), **given_)
    assert ticks["window"].tolist() == windows.tolist()
    assert np.abs(ticks["velocity"] - host).max() <= 3 * EPS * max(1.0, np.abs(host).max())


@pytest.mark.parametrize("discretisation", ["explicit", "semi-implicit", "implicit"])
@pytest.mark.parametrize("output", ["u", "u1"])
def test_levant_equals_the_host_step_by_step(law: Any, discretisation: str, output: str) -> None:
    """Each step starts from the host's state, because one rounded sign would change the path."""
    counts, elapsed = motion(3)
    given_ = {"discretisation": discretisation, "output": output, "lipschitz": 20.0}
    prepared = estimators.get("levant").prepare(given_, DELTA, PERIOD_S)
    p = estimator_only(prepared)
    state = law.reset(p)
    update, worst, scale = prepared.estimator.update, 0.0, scale_of(prepared)
    for count, periods in zip(counts.tolist(), elapsed.tolist(), strict=True):
        error, integrator = state.of.levant.error, state.of.levant.integrator = prepared.state_f.tolist()
        prepared.state_f[:] = state.of.levant.error, state.of.levant.integrator  # as float32 has them
        law.tick(state, p, np.int64(count).astype(np.int32).item(), periods)
        of_the_host = prepared.state_f, prepared.state_i, prepared.parameters
        host = update(count, 0.0, periods, 0.0, *of_the_host) / scale
        size = max(abs(error), abs(integrator), abs(host), 1.0)
        if periods == 1:  # within a gap the sign may turn as well
            worst = max(worst, abs(state.velocity - host) / (size * EPS))
    assert worst <= 8.0, worst


@given(st.data())
def test_fixed_velocity_is_exact_after_gaps(law: Any, data: st.DataObject) -> None:
    vectors = golden_vectors(data.draw(st.integers(0, 1000)), ticks=1)
    p = estimator_only(estimators.get("fdm").prepare({}, 1.0, 1.0))
    p.estimator = 0
    copy_filter(p, vectors.filter)
    counts = data.draw(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=30))
    gaps = st.sampled_from([1, 1, 1, 2, 3, 7, 40, 1000, 5000])
    elapsed = data.draw(st.lists(gaps, min_size=len(counts), max_size=len(counts)))
    exact = ExactFilter(vectors.filter)
    expected = [exact.velocity(*sample) for sample in zip(counts, elapsed, strict=True)]
    assert law.run(p, inputs(counts, np.array(elapsed)))["velocity_fixed"].tolist() == expected
