"""The same hit under several control schemes, and the conditions that make the comparison fair."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import config
from rig.config import presets
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.experiments.hits import compare as comparing
from rig.experiments.hits._impact import mean, measure, second_peak
from rig.experiments.hits.compare import Entry, Start, compare, default_entries, simulate
from sim_backend.mechanics.plant import energy

SHORT = {"trial.duration_s": 0.2, "verdict.tail_s": 0.05}


def short(name: str) -> Any:
    return config.override(presets.load(name), SHORT)


def swing(decay_s: float, *, rest: float = 10.0, first: float = 40.0, period_s: float = 0.02) -> Any:
    """Return times and whole counts of a damped oscillation about the rest depth that begins at the surface."""
    time_s = np.arange(8000) / 20_000
    phase = 2 * math.pi * time_s / period_s
    depth = rest * (1 - np.exp(-time_s / decay_s)) + first * np.exp(-time_s / decay_s) * np.sin(phase)
    counts = np.floor(depth + 0.5)
    first = int(np.flatnonzero(counts > 0)[0])
    return time_s[first:] - time_s[first], counts[first:]


def test_a_decaying_swing_gives_its_peaks_its_rest_and_its_decay() -> None:
    time_s, counts = swing(0.05)
    n = measure(time_s, counts, 1.0)
    assert (n.peak, n.rest) == (37.0, pytest.approx(10.0, abs=0.1))
    assert n.second_peak == pytest.approx(10.0 + 27.0 * math.exp(-0.02 / 0.05), abs=0.5)
    assert n.decay == pytest.approx(math.exp(-0.02 / 0.05), abs=0.05), "one period of the envelope"
    assert n.settling_s == pytest.approx(0.05 * math.log(40.0 / 2.8), abs=0.01)


def test_leaving_the_wall_and_coming_back_is_a_bounce() -> None:
    time_s, counts = swing(0.03)
    below = np.minimum.reduceat(counts, np.arange(0, 2000, 400))  # one minimum a period
    assert measure(time_s, counts, 1.0).bounces == np.count_nonzero(below < 0.5)


def test_a_toggling_count_is_no_second_peak_and_an_endless_swing_never_settles() -> None:
    time_s = np.arange(4000) / 20_000
    toggling = np.minimum(np.arange(4000) + 1.0, 30.0) + (np.arange(4000) % 2)
    n = measure(time_s, toggling, 1.0)
    assert (n.second_peak, n.decay, n.bounces) == (None, 0.0, 0.0)
    endless = np.round(20.0 + 15.0 * np.sin(2 * math.pi * 50.0 * time_s))
    n = measure(time_s, endless, 1.0)
    assert n.settling_s is None
    assert n.decay == pytest.approx(1.0)


@given(counts=st.lists(st.integers(-50, 50), min_size=4, max_size=80), least=st.floats(2.0, 20.0))
def test_a_second_peak_is_not_above_the_first_and_lies_beyond_a_dip(counts: list[int], least: float) -> None:
    depth = np.array(counts, dtype=np.float64)
    second = second_peak(depth, least)
    if second is not None:
        assert second <= depth.max()
        after = depth[int(np.argmax(depth)) :]
        assert after.min() <= min(depth.max(), second) - least


def test_a_mean_has_a_settling_time_only_if_all_settled() -> None:
    settled, endless = (measure(*swing(decay_s), 1.0) for decay_s in (0.03, 1e3))
    assert endless.settling_s is None
    assert mean([settled, settled]) == settled
    assert mean([settled, endless]).settling_s is None
    assert mean([settled, endless]).peak == (settled.peak + endless.peak) / 2


@pytest.mark.parametrize("name", presets.names())
def test_up_to_the_first_contact_all_schemes_move_alike_to_the_last_bit(name: Any) -> None:
    """No homing precedes the contact, because its servo would depend on the scheme's velocity estimate."""
    experiment = short(name)
    rate = experiment.controller.position_rate
    raw = Entry(name="raw", scheme=Scheme(position_rate=rate, velocity_rate=rate, estimator="fdm"))
    entries = (*default_entries(experiment), raw)
    start, model = Start.of(experiment), config.rig_model(experiment)
    before, arrival = set(), set()
    for entry in entries:
        _, plant, trace = simulate(entry.applied(experiment), start, 0.4)
        first = int(np.flatnonzero(trace.flags & 1)[0])
        before.add(trace.states[: first + 1].tobytes())
        arrival.add(energy(trace.states[first], model))
    assert len(before) == len(arrival) == 1
    assert plant.tick_s == 1.0 / rate


@pytest.mark.parametrize("name", presets.names())
def test_the_traces_are_those_of_the_law_that_ran(name: Any) -> None:
    """The rows are recomputed from the counts; equal currents prove that they belong to the simulated law."""
    experiment = default_entries(short(name))[2].applied(short(name))
    law, plant, trace = simulate(experiment, Start.of(experiment), 0.7)
    rows = comparing._rows(law, plant, trace)
    np.testing.assert_array_equal(rows["current_sent"], trace.currents)
    np.testing.assert_array_equal(rows["flags"], trace.flags)


def test_an_external_effort_pushes_the_rig_and_a_small_one_does_not_overcome_friction() -> None:
    experiment = config.override(presets.load("koul-rigid"), SHORT)
    far = Start(position=-0.1, external_effort=0.019)
    _, plant, trace = simulate(experiment, far, 0.5)
    assert (trace.states[:, plant.sensed_position] == -0.1).all()
    _, plant, trace = simulate(experiment, replace(far, external_effort=0.03), 0.5)
    assert trace.states[-1, plant.sensed_position] > -0.1


def test_a_comparison_is_the_same_again_and_each_offset_is_a_trial_of_its_own() -> None:
    experiment = short("koul-compliant")
    first, second = (compare(experiment, offsets=(0.2, 0.6)) for _ in range(2))
    assert plain(first) == plain(second)
    for one, two in zip(first.outcomes, second.outcomes, strict=True):
        assert [i.velocity.tobytes() for i in one.impacts] == [i.velocity.tobytes() for i in two.impacts]
    dual = first["dual"]
    assert [impact.offset for impact in dual.impacts] == [0.2, 0.6]
    assert dual.peaks[0] <= dual.numbers.peak <= dual.peaks[1]
    resolution, mechanics = experiment.rig.encoder.resolution, experiment.rig.mechanics
    give = 2.0 * experiment.rig.limits.effort / mechanics.transmission_stiffness  # of the capstan
    for impact in dual.impacts:
        assert (impact.counts[0] >= 1.0, impact.time_s[0]) == (True, 0.0), "traces begin inside the wall"
        np.testing.assert_allclose(impact.penetration, impact.counts * resolution)
        assert np.abs(impact.penetration - impact.penetration_true).max() < give + resolution
    alone = compare(experiment, [dual.entry], offsets=(0.6,)).outcomes[0].impacts[0]
    assert alone.counts.tobytes() == dual.impacts[1].counts.tobytes()
    json.dumps(plain(first), allow_nan=False)
    with pytest.raises(KeyError):
        first["triple"]


def test_a_wall_on_the_other_side_gives_the_same_depths() -> None:
    experiment = short("koul-rigid")
    mirror = {"wall.side": -1, "trial.start": 0.015, "trial.effort": -0.15, "rig.encoder.sign": -1}
    mirrored = config.override(experiment, mirror)
    one, other = (compare(x, offsets=(0.5,))["dual"].numbers for x in (experiment, mirrored))
    assert other.impact_velocity == pytest.approx(one.impact_velocity, rel=0.02)
    assert other.peak == pytest.approx(one.peak, abs=1.0)


def test_a_uniform_experiment_is_compared_with_a_dual_rate_of_half() -> None:
    none, _, dual = default_entries(presets.load("chawda-linear"))  # 1 kHz
    assert (none.damping, dual.scheme.velocity_rate) == (0.0, 500)


def test_an_impossible_comparison_is_refused_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = short("koul-rigid")
    with pytest.raises(ConfigError, match=r"never reached the wall.*raise trial.effort"):
        compare(experiment, start=Start(position=-0.1))
    for entries, offsets in (([], (0.1,)), (None, ()), (None, (1.0,))):
        with pytest.raises(ConfigError, match="at least one of each is needed"):
            compare(experiment, entries, offsets=offsets)
    unknown = Scheme(position_rate=20_000, velocity_rate=2000, estimator="fmd")
    with pytest.raises(ConfigError, match="fmd"):
        compare(experiment, [Entry(name="typo", scheme=unknown)])
    held = replace(experiment, trial=replace(experiment.trial, kind="human"))
    with pytest.raises(ConfigError, match="compared without a hand"):
        compare(held)
