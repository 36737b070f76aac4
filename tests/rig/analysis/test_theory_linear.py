"""Estimators as state spaces, against scipy's filters and closed forms, and which estimators are rejected."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, freqz_zpk, lfilter, sosfilt

import rig
from rig import config
from rig.analysis import theory
from rig.analysis.theory import _linear as linear
from rig.config import presets
from rig.control import estimators
from rig.control.estimators import _family as family
from rig.control.estimators._kalman_model import steady_gain
from rig.control.estimators.estimator import Estimator
from rig.core.errors import ConfigError
from tests.conformance.estimator import REQUIRED
from tests.conformance.tiers import first_by_default

RESOLUTION = 1.5708e-4


def test_a_finite_difference_is_one_delay() -> None:
    """v = (p − p₋)/T has one state and a pole at zero."""
    found = linear.realise("fdm", {}, 5e-4, RESOLUTION)
    assert found.order == 1
    assert found.d == pytest.approx(2000.0, rel=1e-12)
    assert found.impulse(4) == pytest.approx([2000.0, -2000.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("rate", "cutoff_hz", "order"),
    [(2_000, 200.0, 2), (20_000, 2_000.0, 2), (1_000, 499.0, 2), (2_000, 200.0, 1), (20_000, 200.0, 8)],
)
def test_difference_and_butterworth_are_scipys_to_nine_digits(rate: Any, cutoff_hz: Any, order: Any) -> None:
    """Impulse and frequency response equal those of scipy's sections; the order is filter plus difference."""
    settings = {"cutoff_hz": cutoff_hz, "order": order}
    found = linear.realise("fdm-butterworth", settings, 1.0 / rate, RESOLUTION)
    assert found.order == order + 1
    step = np.zeros(500)
    step[0] = 1.0
    difference = lfilter([1.0, -1.0], [1.0], step)
    expected = rate * sosfilt(butter(order, cutoff_hz, fs=rate, output="sos"), difference)
    assert np.abs(found.impulse(500) - expected).max() < 1e-9 * np.abs(expected).max()
    frequency_hz = np.linspace(1e-3, 0.5, 400) * rate
    zeros, poles, gain = butter(order, cutoff_hz, fs=rate, output="zpk")
    filtered = freqz_zpk(zeros, poles, gain, worN=2 * np.pi * frequency_hz / rate)[1]
    exact = rate * (1 - np.exp(-2j * np.pi * frequency_hz / rate)) * filtered
    assert np.abs(found.response(frequency_hz) - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize(("rate", "bandwidth_hz"), [(2_000, 200.0), (20_000, 200.0)])
def test_kalman_filter_is_realised_in_its_steady_state(rate: int, bandwidth_hz: float) -> None:
    """The oracle is a predictor–corrector with the gain of the Riccati equation."""
    turn = 2 * np.pi * bandwidth_hz / rate
    noise = linear_noise(3) * turn**6 / 12.0
    gain = steady_gain(noise, 1.0 / 12.0)
    a = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    x, expected = np.zeros(3), []
    for k in range(400):
        x = a @ x
        x = x + gain * ((1.0 if k == 0 else 0.0) - x[0])
        expected.append(rate * x[1])
    for how in ("recursive", "steady"):
        settings = {"bandwidth_hz": bandwidth_hz, "gain": how}
        found = linear.realise("kalman", settings, 1.0 / rate, RESOLUTION)
        assert found.order == 3
        assert np.abs(found.impulse(400) - expected).max() < 1e-8 * np.abs(expected).max()


def linear_noise(order: Any) -> Any:
    """Return ∫₀¹ e^{As}GGᵀe^{Aᵀs}ds by quadrature."""
    s, weights = np.polynomial.legendre.leggauss(8)
    s, weights = 0.5 * (s + 1.0), 0.5 * weights
    column = np.stack([s**2 / 2, s, np.ones_like(s)][-order:])
    return (column * weights) @ column.T


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        *((name, {}) for name in ("levant", "foaw-end", "foaw-best", "foaw-levant", "optimal")),
        *((name, {}) for name in ("period", "period-frequency", "fdm-butterworth-fixed")),
        *(("kalman", {"fading": fading}) for fading in ("stf", "instant", "window")),
    ],
)
def test_nonlinear_estimator_is_refused_by_name(name: str, settings: Any) -> None:
    with pytest.raises(ConfigError, match=f"estimator {name}.* is not linear") as caught:
        linear.realise(name, settings, 5e-4, RESOLUTION)
    assert caught.value.remedy
    assert all(str(value) in str(caught.value) for value in settings.values())


def test_an_adaptive_window_that_may_not_adapt_is_a_difference() -> None:
    """An estimator's behaviour decides if it is linear, not its name."""
    one = linear.realise("foaw-end", {"window_limit": 1}, 5e-4, RESOLUTION)
    assert one.impulse(9) == pytest.approx(linear.realise("fdm", {}, 5e-4, RESOLUTION).impulse(9), abs=1e-9)


def third_party(name: Any, update: Any) -> Any:
    """Return a third-party estimator in plain Python, called like the built-in ones."""
    return Estimator(name=name, summary="", source="", update=update, floats=64, ints=3)


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Register an estimator whose update is plain Python, and run it without the compiled loop."""

    def add(estimator: Any) -> None:
        known = estimators.get
        for module in (estimators, family):
            monkeypatch.setattr(module, "get", lambda n: estimator if n == estimator.name else known(n))

        def run(prepared: Any, counts: Any, ages: Any, elapsed: Any) -> Any:
            memory = (prepared.state_f, prepared.state_i, prepared.parameters)
            calls = zip(counts.tolist(), ages, elapsed.tolist(), strict=True)
            return np.array([prepared.estimator.update(c, a, n, *memory) for c, a, n in calls]), None

        monkeypatch.setattr(linear, "run", run)

    return add


def fed(travel: float, elapsed_s: float, effort: float, memory: rig.Memory) -> float:
    """A user's estimator of counts and effort, with a low-pass filter for each."""
    memory.velocity = 0.9 * (memory.velocity + 50.0 * effort * elapsed_s) + 0.1 * travel / elapsed_s
    return memory.velocity


@pytest.mark.parametrize(
    ("name", "settings"), first_by_default([*REQUIRED.items(), ("fed", {})], len(REQUIRED))
)
def test_an_estimator_of_the_effort_is_the_sum_of_two_state_spaces(
    name: str, settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug probed a user's estimator without effort, so theory judged the wall with another estimator."""
    estimator = rig.estimator(memory=("velocity",))(fed) if name == "fed" else estimators.get(name)
    monkeypatch.setattr(estimators, "get", lambda name: estimator)
    found = linear.realise(estimator.name, settings, 5e-4, RESOLUTION)
    assert found.of_effort is not None
    random = np.random.default_rng(4)
    counts, effort = np.cumsum(random.integers(-9, 10, 700)), random.normal(size=700)
    counts[:300], effort[:300] = 0, 0.0
    prepared = estimator.prepare(settings, RESOLUTION, 5e-4)
    own, _ = linear.run(prepared, *estimators.inputs(counts, 5e-4), effort)
    parts = (RESOLUTION * counts, found), (effort, found.of_effort)
    again = sum(np.convolve(values, one.impulse(700))[:700] for values, one in parts)
    assert np.abs(again - own).max() < 1e-8 * np.abs(own).max()
    with pytest.raises(theory.NotLinearError, match=f"{estimator.name}: .*with the effort"):
        found.response(10.0)


def idle(travel: float, elapsed_s: float, effort: float) -> float:
    return travel / elapsed_s


def gated(travel: float, elapsed_s: float, effort: float) -> float:
    """A user's estimator that ignores an effort beyond any motor's."""
    return travel / elapsed_s + (50.0 * effort if abs(effort) < 10.0 else 0.0)


def test_the_response_decides_whether_the_effort_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bug called a linear estimator with an unused argument not linear."""
    known = {one.__name__: rig.estimator()(one) for one in (idle, gated)}
    monkeypatch.setattr(estimators, "get", known.__getitem__)
    found = linear.realise("idle", {}, 5e-4, RESOLUTION)
    assert found.of_effort is None
    assert found.impulse(3) == pytest.approx([2000.0, -2000.0, 0.0], abs=1e-9)
    with pytest.raises(linear.NotLinearError, match="counts and efforts together"):
        linear.realise("gated", {}, 5e-4, RESOLUTION)


def moving_chord(count: Any, age: Any, elapsed: Any, state_f: Any, state_i: Any, parameters: Any) -> Any:
    """Return the slope over the last twelve samples, a finite impulse response of order 12."""
    if state_i[1] == 0:
        state_i[1], state_i[2] = 1, count
    state_f[1:13] = state_f[0:12]
    state_f[0] = count - state_i[2]
    return (state_f[0] - state_f[12]) * parameters[0] / (12 * parameters[1])


def test_a_third_partys_linear_estimator_is_realised_too(foreign: Any) -> None:
    foreign(third_party("chord", moving_chord))
    found = linear.realise("chord", {}, 1e-3, RESOLUTION)
    expected = np.zeros(30)
    expected[0], expected[12] = 1e3 / 12, -1e3 / 12
    assert found.order == 12
    assert found.impulse(30) == pytest.approx(expected, abs=1e-9)


def test_an_estimator_is_watched_once_and_another_of_its_name_anew(foreign: Any) -> None:
    foreign(third_party("chord", moving_chord))
    once = linear.realise("chord", {}, 1e-3, RESOLUTION)
    assert linear.realise("chord", {}, 1e-3, RESOLUTION) is once
    foreign(third_party("chord", lambda *arguments: 2.0 * moving_chord(*arguments)))
    assert linear.realise("chord", {}, 1e-3, RESOLUTION).impulse(30) == pytest.approx(2.0 * once.impulse(30))


@pytest.mark.exhaustive("::test_nonlinear_estimator_is_refused_by_name")
def test_estimator_that_changes_with_time_is_refused(foreign: Any) -> None:
    def tiring(count: Any, edge: Any, elapsed: Any, state_f: Any, state_i: Any, parameters: Any) -> Any:
        state_f[40] += 1.0
        return moving_chord(count, edge, elapsed, state_f, state_i, parameters) / (1.0 + 1e-6 * state_f[40])

    foreign(third_party("tiring", tiring))
    with pytest.raises(ConfigError, match="depends on the time of an impulse"):
        linear.realise("tiring", {}, 1e-3, RESOLUTION)


def test_the_sign_of_the_encoder_and_its_resolution_change_nothing() -> None:
    there = linear.realise("fdm-butterworth", {"cutoff_hz": 200.0}, 5e-4, RESOLUTION)
    back = linear.realise("fdm-butterworth", {"cutoff_hz": 200.0}, 5e-4, -1e-6)
    assert there.impulse(100) == pytest.approx(back.impulse(100), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"wall.passive_damping": 1.0}, "passivity controller"),
        ({"wall.position_from": "estimator", "controller.estimator": "tracking",
          "controller.velocity_rate": 20_000}, "estimated position"),
    ],
)  # fmt: skip
def test_a_wall_or_an_estimator_that_theory_lacks_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(linear.NotLinearError) as refused:
        theory.linear_loop(config.override(presets.load("koul-rigid"), changes))
    assert reason in refused.value.reason
