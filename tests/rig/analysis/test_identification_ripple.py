"""Torque ripple from sweeps with and without a load is found within its interval, apart from cogging and friction."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig.analysis.identification._cogging import pairs_of
from rig.analysis.identification._quality import IdentificationError
from rig.analysis.identification._ripple import Ripple, fit_ripple
from rig.core.model import Cogging
from tests.rig.analysis.test_identification_cogging import DAMPING, INERTIA, PERIOD, swept

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
