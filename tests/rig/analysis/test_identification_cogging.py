"""Cogging and torque ripple from slow sweeps are found within their intervals, apart from friction and each other."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.analysis.identification._cogging import fit_cogging, pairs_of
from rig.analysis.identification._quality import IdentificationError
from rig.analysis.identification._ripple import Ripple, fit_ripple
from rig.analysis.identification._sliding import Stroke
from rig.core.model import Cogging

RATE, TRAVEL, SPEEDS, REST_S = 500.0, 0.5, (0.10, 0.08, 0.06), 0.2
PERIOD, QUANTUM, EFFORT_QUANTUM = 2.0 * math.pi / 10.0, 1.57e-4, 2.3e-4
INERTIA, DAMPING, UP, DOWN = 1.8e-3, 4e-3, 0.008, 0.006


def swept(cogging: Cogging, wobble: float = 0.2, travel: float = TRAVEL, load: float = 0.0) -> Any:
    """Return time, effort, position and sweeps of a prescribed motion, with the effort by Newton's law."""
    sweeps, at, speeds, time_s = [], [], [], 0.0
    for speed in SPEEDS:
        for side in (1.0, -1.0):
            n = round(2.0 * travel / speed * RATE)
            t = np.arange(n) / RATE
            swing = wobble * speed / 30.0 * np.sin(30.0 * t)  # no servo keeps a speed
            at.append(side * (speed * t - travel + swing))
            speeds.append(np.full(n, side))
            sweeps.append(Stroke(time_s, time_s + n / RATE, side * speed))
            rest = round(REST_S * RATE)
            at.append(np.full(rest, at[-1][-1]))
            speeds.append(np.zeros(rest))
            time_s += (n + rest) / RATE
    x, side = np.concatenate(at), np.concatenate(speeds)
    velocity = np.gradient(x, 1.0 / RATE)
    rubs = np.where(side > 0.0, UP, -DOWN) + DAMPING * velocity
    needed = INERTIA * np.gradient(velocity, 1.0 / RATE) + rubs + load - cogging.effort(x)
    effort = needed / (1.0 + cogging.share(x))
    counted = QUANTUM * np.floor(x / QUANTUM + 0.5)
    sent = EFFORT_QUANTUM * np.rint(effort / EFFORT_QUANTUM)
    return np.arange(len(x)) / RATE, sent, counted, sweeps


def fitted(cogging: Cogging, most: int = 14, **options: Any) -> Any:
    return fit_cogging(
        *swept(cogging, **options), period=PERIOD, most_order=most, inertia=INERTIA, damping=DAMPING
    )


AMPLITUDE_AND_PHASE = st.tuples(st.floats(0.002, 0.02), st.floats(-math.pi, math.pi))


@given(harmonics=st.dictionaries(st.integers(1, 14), AMPLITUDE_AND_PHASE, min_size=1, max_size=3))
@settings(max_examples=2)
def test_true_harmonics_and_no_others_come_out_within_the_interval(harmonics: Any) -> None:
    """Three intervals bound the scatter of three pairs of coefficients; harmonics not found are reported."""
    true = Cogging(
        period=PERIOD,
        orders=tuple(harmonics),
        cosine=tuple(a * math.cos(phase) for a, phase in harmonics.values()),
        sine=tuple(a * math.sin(phase) for a, phase in harmonics.values()),
    )
    found = fitted(true)
    assert set(found.orders) >= {n for n, (a, _) in harmonics.items() if a > found.unseen}
    assert found.unseen < 1e-3
    at = np.linspace(found.minimum, found.maximum, 500)
    spread = 3.0 * found.ci95 + 0.5 * EFFORT_QUANTUM
    assert np.abs(found.cogging.effort(at) - true.effort(at)).max() <= spread
    assert found.ci95 < 5e-4
    assert found.friction.value == pytest.approx(0.5 * (UP + DOWN), abs=1e-4)  # the half difference
    measured = ~np.isnan(found.effort)
    assert np.abs(found.effort - true.effort(found.position))[measured].mean() < 6e-4
    assert np.nanmedian(found.rubbing) == pytest.approx(found.friction.value, abs=5e-4)
    assert found.peak == pytest.approx(np.abs(true.effort(at)).max(), abs=spread)


def test_without_cogging_no_harmonic_is_certain_and_a_bound_is_stated() -> None:
    found = fitted(Cogging())
    assert all(math.hypot(c.value, s.value) < 1e-4 for c, s in zip(found.cosine, found.sine, strict=True))
    assert 0.0 < found.unseen < 3e-4


def test_the_interval_of_the_map_holds_the_truth_as_often_as_stated() -> None:
    """In white noise, at 50 positions of 12 maps; it is the interval at the position where it is widest."""
    rng, (time_s, effort, position, sweeps) = np.random.default_rng(3), swept(COGS)
    known = {"period": PERIOD, "most_order": MOST, "inertia": INERTIA, "damping": DAMPING}
    shares = []
    for _ in range(12):
        found = fit_cogging(time_s, effort + rng.normal(0.0, NOISE, len(effort)), position, sweeps, **known)
        at = np.linspace(found.minimum, found.maximum, 50)
        shares.append(np.mean(np.abs(found.cogging.effort(at) - COGS.effort(at)) <= found.ci95))
        assert found.ci95 < 0.03 * found.peak
    assert np.mean(shares) > 0.95


def test_sweeps_of_less_than_a_period_are_refused() -> None:
    with pytest.raises(IdentificationError, match="needed to separate its harmonics"):
        fitted(Cogging(), travel=0.25)


def test_a_handle_that_is_held_is_refused() -> None:
    time_s, effort, _, sweeps = swept(Cogging())
    held, known = np.zeros(len(time_s)), {"inertia": INERTIA, "damping": DAMPING}
    for seen, message in ((sweeps, "a common range of 0 rad"), (sweeps[:2], "fewer than two pairs")):
        with pytest.raises(IdentificationError, match=message):
            fit_cogging(time_s, effort, held, seen, period=PERIOD, most_order=7, **known)


# ---------------------------------------------------------------------- ripple

MOST, LOAD, NOISE = 4, 0.08, 5e-4
COGS = Cogging(period=PERIOD, orders=(1, 2, 4), cosine=(0.004, 0.0, 0.01), sine=(0.0, -0.003, 0.006))
RIPPLES = replace(COGS, ripple_cosine=(0.02, 0.0, 0.03), ripple_sine=(-0.01, 0.05, 0.02))


def pairs(run: Any, noise: Any = 0.0) -> Any:
    time_s, effort, position, sweeps = run
    return pairs_of(
        time_s, effort + noise, position, sweeps, wave=PERIOD / MOST, inertia=INERTIA, damping=DAMPING
    )


def fit_rig(rig: Cogging, load: float = LOAD) -> Ripple:
    free, loaded = (pairs(swept(rig, load=hung)) for hung in (0.0, load))
    return fit_ripple(free, loaded, period=PERIOD, most_order=MOST)


def test_amplitude_and_phase_of_each_harmonic_are_those_of_the_motor() -> None:
    """Load, cogging and friction do not affect them; the error is by quanta of effort and position."""
    ripple = fit_rig(RIPPLES)
    assert ripple.orders == COGS.orders
    for i, (c, s) in enumerate(zip(RIPPLES.ripple_cosine, RIPPLES.ripple_sine, strict=True)):
        assert ripple.amplitude[i].value == pytest.approx(math.hypot(c, s), abs=1e-4)
        assert ripple.phase[i].value == pytest.approx(math.atan2(s, c), abs=3e-3)
        assert ripple.phase[i].ci95 * ripple.amplitude[i].value == pytest.approx(
            math.hypot(s * ripple.cosine[i].ci95, c * ripple.sine[i].ci95) / math.hypot(c, s), rel=0.05
        )
    assert ripple.load.value == pytest.approx(LOAD, rel=1e-4)
    assert ripple.unseen < 5e-4


def test_a_motor_that_only_cogs_has_no_ripple_worth_the_name() -> None:
    ripple = fit_rig(COGS)
    assert all(amplitude.value < 1e-4 for amplitude in ripple.amplitude)
    assert ripple.unseen < 5e-4


@pytest.mark.parametrize("rig", [COGS, RIPPLES], ids=["cogging", "ripple"])
@pytest.mark.parametrize("most", [MOST, 14])
def test_the_interval_of_friction_holds_it_beside_ripple(rig: Cogging, most: int) -> None:
    """Ripple of 4 % and a range of one and a half periods added 0.7 % to a value with an interval of 0.05 %."""
    friction = fitted(rig, most).friction
    assert friction.holds(0.5 * (UP + DOWN))
    assert friction.ci95 < 0.004 * friction.value


def test_interval_holds_the_truth_as_often_as_stated() -> None:
    """95 % intervals in white noise contain it within four standard deviations of the binomial count."""
    rng, runs = np.random.default_rng(3), [swept(RIPPLES, load=hung) for hung in (0.0, LOAD)]
    held, trials = 0, 0
    for _ in range(12):
        free, loaded = (pairs(run, rng.normal(0.0, NOISE, len(run[0]))) for run in runs)
        ripple = fit_ripple(free, loaded, period=PERIOD, most_order=MOST)
        truth = zip(RIPPLES.orders, RIPPLES.ripple_cosine, RIPPLES.ripple_sine, strict=True)
        for order, cosine, sine in truth:
            at = ripple.orders.index(order)
            held += ripple.cosine[at].holds(cosine) + ripple.sine[at].holds(sine)
            trials += 2
    assert abs(held - 0.95 * trials) <= 4.0 * math.sqrt(0.95 * 0.05 * trials)


def test_a_load_that_is_lost_in_the_friction_is_refused() -> None:
    with pytest.raises(IdentificationError, match="friction masks"):
        fit_rig(RIPPLES, load=1e-7)
