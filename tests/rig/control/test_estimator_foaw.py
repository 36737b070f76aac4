"""Adaptive windowing against a textbook search in exact fractions, numpy's polyfit, and physical requirements."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import estimators
from rig.control.estimators.estimator import WINDOW
from rig.core.errors import ConfigError
from rig.testing.estimators import check_estimator
from tests.conformance.estimator import KNOWN_LIMITS

RESOLUTION, PERIOD = 1e-6, 1e-3
ONE_COUNT = RESOLUTION / PERIOD
FITS = ("foaw-end", "foaw-best")

OPTIONS = st.one_of(
    st.tuples(st.just("foaw-end"), st.just("last")),
    st.tuples(st.just("foaw-best"), st.sampled_from(["lsq", "last", "literal"])),
)
# Steps of a slow handle, so that windows of every length are met; now and then a jump.
STEP = st.one_of(st.integers(-2, 2), st.integers(0, 1), st.integers(-300, 300))
SAMPLES = st.lists(st.tuples(STEP, st.sampled_from([1, 1, 1, 1, 2, 3, 20])), min_size=1, max_size=50)


def prepare(name: Any, **given_settings: Any) -> Any:
    return estimators.get(name).prepare(given_settings, RESOLUTION, PERIOD)


def run(prepared: Any, counts: Any, elapsed: Any = None) -> Any:
    """Return the velocities (counts per period) and the window of each."""
    update, memory = prepared.estimator.update, (prepared.state_f, prepared.state_i, prepared.parameters)
    velocities, windows = [], []
    for count, periods in zip(counts, elapsed or [1] * len(counts), strict=True):
        velocities.append(update(int(count), 0.0, int(periods), 0.0, *memory) / ONE_COUNT)
        windows.append(int(prepared.state_i[WINDOW]))
    return np.array(velocities), np.array(windows)


def textbook(fit: Any, anchor: Any, stop: Any, band: Any, limit: Any, counts: Any, times: Any) -> Any:
    """Return slope and window by the textbook algorithm in exact fractions, newest sample last.

    It draws every line and tests every sample again: O(W²) at least.
    """
    now, newest = times[-1], counts[-1]
    band = Fraction(band * (1 + 1e-9))
    slope, window = Fraction(0), 0
    for n in range(1, len(counts)):
        t, y = times[-n - 1 :], counts[-n - 1 :]
        if n > 1 and now - t[0] > limit:
            break
        mean_t, mean_y = Fraction(sum(t), n + 1), Fraction(sum(y), n + 1)
        chord = Fraction(newest - y[0], now - t[0])
        least_squares = sum((a - mean_t) * (b - mean_y) for a, b in zip(t, y, strict=True)) / sum(
            (a - mean_t) ** 2 for a in t
        )
        b = chord if fit == "foaw-end" else least_squares
        at_zero = {
            "last": newest - b * now,
            "lsq": mean_y - b * mean_t,
            "literal": newest - chord * now,  # equation (6): (k·y_{k-n} + (n-k)·y_k)/n, for lost samples too
        }[anchor]
        tested = zip(t, y, strict=True) if anchor == "lsq" else zip(t[:-1], y[:-1], strict=True)
        if n == 1 or all(abs(y_i - at_zero - b * t_i) <= band for t_i, y_i in tested):
            slope, window = b, now - t[0]
        elif stop == "first":
            break
    return float(slope), window


@given(
    option=OPTIONS,
    stop=st.sampled_from(["first", "global"]),
    band=st.sampled_from([0.5, 1.0, 1.5, 3.0]),
    limit=st.sampled_from([1, 2, 7, 16, 64]),
    samples=SAMPLES,
)
def test_windows_are_the_textbooks(option: Any, stop: Any, band: Any, limit: Any, samples: Any) -> None:
    """Cones and running sums give the same windows as testing every line, also where samples were lost."""
    fit, anchor = option
    counts = np.cumsum([step for step, _ in samples]).tolist()
    elapsed = [periods for _, periods in samples]
    times = (np.cumsum(elapsed) - elapsed[0]).tolist()
    chosen = {"anchor": anchor} if fit == "foaw-best" else {}
    v, windows = run(prepare(fit, band=band, window_limit=limit, stop=stop, **chosen), counts, elapsed)
    for k in range(len(counts)):
        oldest = max(0, k - limit)
        expected = textbook(fit, anchor, stop, band, limit, counts[oldest : k + 1], times[oldest : k + 1])
        assert windows[k] == expected[1], f"sample {k}"
        assert v[k] == pytest.approx(expected[0], rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("fit", FITS)
def test_one_count_of_band_never_cuts_a_true_ramp(fit: Any) -> None:
    """PHYSICS 2i (A) 3: rounding moves each sample by up to half a count, hence a chord by up to one."""
    random = np.random.default_rng(7)
    slope, offset = random.uniform(-5, 5, (500, 1)), random.uniform(0, 1, (500, 1))
    for ramp in np.floor(slope * np.arange(17) + offset).astype(int):
        assert run(prepare(fit), ramp)[1][-1] == 16


VARIANTS = [
    ("foaw-end", {}),
    ("foaw-end", {"stop": "global", "window_limit": 64}),
    ("foaw-best", {}),
    ("foaw-best", {"anchor": "last", "band": 1.5, "window_limit": 64}),
    ("foaw-best", {"anchor": "literal"}),
    ("foaw-best", {"stop": "global"}),
]


@pytest.mark.parametrize(("name", "chosen"), VARIANTS)
def test_every_variant_keeps_the_promises_of_the_family(name: Any, chosen: Any) -> None:
    check_estimator(name, chosen, **KNOWN_LIMITS[name])


@pytest.mark.parametrize("fit", FITS)
def test_half_a_period_of_window_is_refused(fit: Any) -> None:
    with pytest.raises(ConfigError, match=r"window_limit = 7.5 is not a whole number.*7 or 8"):
        prepare(fit, window_limit=7.5)
    with pytest.raises(ConfigError, match=r"window_limit = 65 velocity periods is out of range.*1 to 64"):
        prepare(fit, window_limit=65)
