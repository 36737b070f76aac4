"""Adaptive windowing against a textbook search in exact fractions, numpy's polyfit, and what the physics demands."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
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
    """Velocities in counts per period, and the window of each."""
    update, memory = prepared.estimator.update, (prepared.state_f, prepared.state_i, prepared.parameters)
    velocities, windows = [], []
    for count, periods in zip(counts, elapsed or [1] * len(counts), strict=True):
        velocities.append(update(int(count), 0.0, int(periods), *memory) / ONE_COUNT)
        windows.append(int(prepared.state_i[WINDOW]))
    return np.array(velocities), np.array(windows)


def textbook(fit: Any, anchor: Any, stop: Any, band: Any, limit: Any, counts: Any, times: Any) -> Any:
    """The algorithm as a book states it, newest sample last, in exact fractions: slope and window.

    Every line is drawn anew and every sample tested anew: O(W²) at least.
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


# --- the search -------------------------------------------------------------------------------------------


@settings(max_examples=150)
@given(
    option=OPTIONS,
    stop=st.sampled_from(["first", "global"]),
    band=st.sampled_from([0.5, 1.0, 1.5, 3.0]),
    limit=st.sampled_from([1, 2, 7, 16]),
    samples=SAMPLES,
)
def test_every_variant_finds_the_windows_of_the_textbook_search(
    option: Any, stop: Any, band: Any, limit: Any, samples: Any
) -> None:
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


@pytest.mark.parametrize(
    ("fit", "anchor"), [("foaw-end", "last"), ("foaw-best", "lsq"), ("foaw-best", "last")]
)
def test_the_longest_window_of_64_periods_is_searched_as_in_the_textbook(fit: str, anchor: str) -> None:
    counts = np.floor(40 * np.sin(np.arange(300) / 45) + 0.5).astype(int).tolist()
    chosen = {"anchor": anchor} if fit == "foaw-best" else {}
    v, windows = run(prepare(fit, window_limit=64, **chosen), counts)
    for k in range(100, 300, 23):
        expected = textbook(fit, anchor, "first", 1.0, 64, counts[: k + 1], list(range(k + 1)))
        assert (v[k], windows[k]) == (pytest.approx(expected[0], abs=1e-12), expected[1])
    assert windows.max() > 16


@settings(max_examples=60)
@given(steps=st.lists(st.integers(-40, 40), min_size=1, max_size=40))
def test_the_best_fit_is_polyfit_over_its_window(steps: list[int]) -> None:
    """PHYSICS 2i (A) 3, through equation (6)'s sums and numpy's QR decomposition alike."""
    counts = np.cumsum([0, *steps])
    v, windows = run(prepare("foaw-best", band=25.0), counts)
    n = windows[-1]
    expected = np.polyfit(np.arange(n + 1), counts[-n - 1 :].astype(float), 1)[0]
    assert v[-1] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    i, y = np.arange(n + 1), counts[::-1][: n + 1]
    printed = (n * y.sum() - 2 * (i * y).sum()) / (n * (n + 1) * (n + 2) / 6)
    assert v[-1] == pytest.approx(printed, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("fit", "counts", "first"),
    [("foaw-end", [0, 1, 4, 5, 5, 7, 9], 2), ("foaw-best", [0, 3, 5, 5, 8, 10, 10], 3)],
)
def test_global_stop_reaches_over_windows_that_fail(fit: str, counts: list[int], first: int) -> None:
    """Some lines in between leave a sample outside, the one over all six periods does not."""
    _, windows = run(prepare(fit, stop="first"), counts)
    _, longest = run(prepare(fit, stop="global"), counts)
    assert (windows[-1], longest[-1]) == (first, 6)


# --- the band ---------------------------------------------------------------------------------------------


def rounded_ramps(number: int = 2000, limit: int = 16) -> Any:
    """Random slopes and offsets, rounded as an encoder does, after the window has filled: (ramps, samples)."""
    random = np.random.default_rng(7)
    slope, offset = random.uniform(-5, 5, (number, 1)), random.uniform(0, 1, (number, 1))
    return np.floor(slope * np.arange(limit + 1) + offset).astype(int)


def share_cut(name: Any, **chosen: Any) -> Any:
    full = [run(prepare(name, **chosen), ramp)[1][-1] == len(ramp) - 1 for ramp in rounded_ramps()]
    return 1.0 - np.mean(full)


@pytest.mark.parametrize("fit", FITS)
def test_one_count_of_band_never_cuts_a_true_ramp(fit: Any) -> None:
    """PHYSICS 2i (A) 3: rounding moves each sample by half a count, hence a chord by up to one."""
    assert share_cut(fit) == 0.0


def test_half_a_count_of_band_often_does() -> None:
    assert share_cut("foaw-end", band=0.5) > 0.1


def test_anchored_at_the_newest_sample_a_best_fit_cuts_one_ramp_in_fifty() -> None:
    """PHYSICS 2i (A) 3: the least-squares line through a rounded sample misses others by up to 1.37 counts."""
    assert 0.01 < share_cut("foaw-best", anchor="last") < 0.03
    assert share_cut("foaw-best", anchor="last", band=1.5) == 0.0


def test_the_anchor_as_printed_drifts_until_windows_of_two_periods_are_left() -> None:
    """Equation (6) turns the line about t = 0, so one and the same ramp passes less and less as the run grows older.

    Over one or two periods chord and least-squares line are the same, so that those windows always have a chance.
    """
    counts = np.floor(0.37 * np.arange(1000) + 0.1).astype(int)
    v, windows = run(prepare("foaw-best", anchor="literal"), counts)
    sound, full = run(prepare("foaw-best", anchor="lsq"), counts)
    assert windows[8:11].min() > 4
    assert (windows[100:] <= 2).all()
    assert (full[16:] == 16).all()
    assert np.std(v[100:] - 0.37) > 10 * np.std(sound[100:] - 0.37)


@pytest.mark.parametrize("fit", FITS)
def test_the_window_shrinks_at_an_impact_and_grows_again(fit: Any) -> None:
    k = np.arange(80)
    counts = np.where(k < 40, 10 * k, 400 - 10 * (k - 40))
    v, windows = run(prepare(fit), counts)
    assert windows[40] == 16
    assert windows[41] == 1
    assert v[41] == pytest.approx(-10.0, rel=1e-15)
    assert windows[60] == 16


# --- time -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fit", FITS)
def test_lost_samples_leave_a_ramp_exact_and_the_window_in_periods(fit: Any) -> None:
    elapsed = [1] * 20 + [3, 1, 1, 4, 1]
    v, windows = run(prepare(fit), (7 * np.cumsum(elapsed)).tolist(), elapsed)
    assert v[1:] == pytest.approx(7.0, rel=1e-12)
    assert windows[20:].tolist() == [16] * 5  # periods, over fewer samples


@pytest.mark.parametrize("fit", FITS)
def test_a_gap_longer_than_the_limit_is_a_restart_from_the_mean_slope(fit: Any) -> None:
    counts, elapsed = [0, 5, 10, 1010, 1013], [1, 1, 1, 50, 1]
    v, windows = run(prepare(fit), counts, elapsed)
    assert v[3:].tolist() == pytest.approx([20.0, 3.0])
    assert windows[3:].tolist() == [50, 1]


@pytest.mark.parametrize("fit", FITS)
def test_no_window_before_the_second_sample_and_none_longer_than_the_run(fit: Any) -> None:
    v, windows = run(prepare(fit), [4] * 20)
    assert windows.tolist() == [*range(17), 16, 16, 16]
    assert not v.any()


# --- laws of the family -----------------------------------------------------------------------------------

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


@settings(max_examples=60)
@given(
    fit=st.sampled_from(FITS),
    steps=st.lists(st.integers(-50, 50), min_size=1, max_size=50),
    shift=st.integers(-(2**31), 2**31 - 1),
)
def test_shift_sign_and_scale_with_the_band_change_nothing_else(
    fit: Any, steps: list[int], shift: int
) -> None:
    """Exactly: shifts cancel in integers, and the factor four of counts and band is one of the exponent."""
    counts = np.cumsum(steps)
    v, windows = run(prepare(fit), counts)
    shifted, mirrored = (counts + shift + 2**31) % 2**32 - 2**31, -counts
    for other, factor, band in ((shifted, 1, 1.0), (mirrored, -1, 1.0), (4 * counts, 4, 4.0)):
        w, other_windows = run(prepare(fit, band=band), other)
        assert (w == factor * v).all()
        assert (other_windows == windows).all()


@pytest.mark.parametrize("fit", FITS)
def test_half_a_period_of_window_is_refused(fit: Any) -> None:
    with pytest.raises(ConfigError, match=r"window_limit = 7.5 is not a whole number.*7 or 8"):
        prepare(fit, window_limit=7.5)
    with pytest.raises(ConfigError, match=r"window_limit = 65 velocity periods is out of range.*1 to 64"):
        prepare(fit, window_limit=65)
