"""The optimal robust exact differentiator: its error bound, its exactness, and brute force over its definition."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.estimators import _optimal as optimal
from rig.control.estimators import arrays
from rig.core.errors import ConfigError
from rig.testing.estimators import velocities

RESOLUTION, PERIOD = 1e-6, 1e-4


def prepare(resolution: Any = RESOLUTION, period_s: Any = PERIOD, **given: Any) -> Any:
    return optimal.ESTIMATOR.prepare(given, resolution, period_s)


def brute_force(counts: Any, bend: Any, longest: Any) -> Any:
    """Return slopes (counts per period) and chords by the definition in the docstring of the product's module."""
    slopes, chords = [0.0], [0]
    for k in range(1, len(counts)):
        n, noise = min(k, longest), 0.0
        for l in range(2, n + 1):  # noqa: E741
            for j in range(1, l):
                away = abs(counts[k - j] - counts[k] + (counts[k] - counts[k - l]) * j / l)
                noise = max(noise, 0.5 * (away - bend * j * (l - j) / 2))
        chord = min(n, max(1, math.ceil(2 * math.sqrt(noise / bend))))
        slopes.append((counts[k] - counts[k - chord]) / chord)
        chords.append(chord)
    return np.array(slopes), np.array(chords)


@given(
    motion=st.lists(st.integers(-6, 6), min_size=1, max_size=40),
    bound=st.sampled_from([3.0, 20.3, 100.0, 711.0]),
)
def test_optimal_differentiator_is_its_definition(motion: list[int], bound: Any) -> None:
    counts = [0, *np.cumsum(motion).tolist()]
    prepared = prepare(lipschitz=bound)
    bend, longest = prepared.parameters[2:]
    slopes, chords = brute_force(counts, bend, int(longest))
    seen, windows = arrays.run(prepared, *arrays.inputs(counts, PERIOD))
    assert seen == pytest.approx(slopes * RESOLUTION / PERIOD, rel=1e-12)
    assert (windows == chords).all()


def swing(period_s: Any, resolution: Any, offset: float = 0.5) -> Any:
    t = np.arange(0.0, 0.4, period_s)
    w = 2 * math.pi * 11.0
    return (
        arrays.quantise(3e-3 * np.sin(w * t), resolution, offset=offset),
        3e-3 * w * np.cos(w * t),
        3e-3 * w * w,
    )


@pytest.mark.parametrize("period_s", [1e-3, 2e-4, 5e-5])
@pytest.mark.parametrize("resolution", [1e-6, 5e-6, 2e-5])
def test_error_keeps_to_the_theoretical_bound(period_s: float, resolution: float) -> None:
    """Check |v̂ − v| ≤ 2·√(2·N·C) + C·T/2 with N half a count, once enough samples fill the longest chord."""
    counts, velocity, bound = swing(period_s, resolution)
    prepared = prepare(resolution, period_s, lipschitz=bound, window_limit=64.0)
    error = np.abs(arrays.run(prepared, *arrays.inputs(counts, period_s))[0] - velocity)
    filled = int(prepared.parameters[3]) + 1
    assert error[filled:].max() <= 2 * math.sqrt(resolution * bound) + bound * period_s / 2


def test_samples_lost_within_the_chord_bend_nothing() -> None:
    counts = 3 * np.cumsum([1, 1, 1, 2, 1, 3, 1, 1])
    v = velocities(prepare(lipschitz=0.5), counts.tolist(), [1, 1, 1, 2, 1, 3, 1, 1])
    assert v[1:] == pytest.approx(3 * RESOLUTION / PERIOD)


def test_the_longest_chord_follows_from_noise_and_bound_within_the_limit() -> None:
    assert prepare(lipschitz=20.0).parameters[3] == 4
    assert prepare(lipschitz=20.0, noise=2.0).parameters[3] == 7
    assert prepare(lipschitz=1e6).parameters[3] == 2
    assert prepare(lipschitz=1e-3, window_limit=20.0).parameters[3] == 20
    with pytest.raises(ConfigError, match=r"window_limit = 7\.5 is not a whole number"):
        prepare(window_limit=7.5)
