"""Measured against active current: what must be noticed, and what must not be."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import current
from rig.control.current import AGREES, CURRENT, DISAGREES, FEWEST_TICKS
from rig.core.board import CurrentSensor

RATES = (100, 1_000, 4_000, 20_000, 50_000)
LAGS_S = (0.0, 1.0e-4, 1.09e-4, 1e-3)


def watched(
    rate: int, *, noise: float = 1.0, lag_s: float = 0.0, back_emf: float = 0.0, sign: int = 1
) -> Any:
    words = memoryview(np.zeros(len(CURRENT), np.int64))
    current.configure(words, CurrentSensor(noise=noise, lag_s=lag_s, back_emf=back_emf), rate, sign)
    return words


def answers(words: Any, active: Any, measured: Any, counts: Any = None) -> list[int]:
    counts = np.zeros(len(active), int) if counts is None else counts
    said = [
        current.compare(words, int(n), int(a), int(m))
        for n, a, m in zip(counts, active, measured, strict=True)
    ]
    return [one for one in said if one]


def lagged(active: Any, rate: int, lag_s: float) -> Any:
    """The exact current behind a first-order lag at the end of each tick, as a converter rounds it."""
    share = 1.0 if lag_s == 0.0 else -np.expm1(-1.0 / (rate * lag_s))
    flowing, found = 0.0, []
    for one in active:
        flowing += (one - flowing) * share
        found.append(flowing)
    return np.floor(np.array(found) + 0.5)


def commands(rate: int, seed: int, ticks: int = 0) -> Any:
    """Steps, ramps and oscillations of a wall, up to some amperes in quanta of a milliampere."""
    random = np.random.default_rng(seed)
    time = np.arange(ticks or max(2_000, rate // 10)) / rate
    hz, size = random.uniform(0.0, min(rate / 8, 400.0)), random.uniform(10.0, 6_000.0)
    wave = size * np.sin(2 * np.pi * hz * time + random.uniform(0.0, 6.0))
    return np.round(np.where(wave > random.uniform(-1.0, 1.0) * size, wave, 0.0))


@given(st.sampled_from(RATES), st.sampled_from(LAGS_S), st.integers(0, 2**32 - 1), st.floats(0.0, 20.0))
def test_a_sound_amplifier_never_disagrees(rate: int, lag_s: float, seed: int, noise: float) -> None:
    active = commands(rate, seed)
    measured = lagged(active, rate, lag_s) + np.round(
        np.random.default_rng(seed + 1).normal(0.0, noise, len(active))
    )
    total = float(np.hypot(noise, np.sqrt(2 / 12)))
    assert DISAGREES not in answers(watched(rate, noise=total, lag_s=lag_s), active, measured)


@given(
    st.sampled_from(RATES),
    st.sampled_from(LAGS_S),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, -1.0, 5.0, 0.5, 1.25]),
)
def test_another_current_disagrees_in_each_window_in_which_it_could_be_seen(
    rate: int, lag_s: float, seed: int, gain: float
) -> None:
    active = commands(rate, seed)
    flowing = lagged(active, rate, lag_s)
    words = watched(rate, noise=1.0, lag_s=lag_s)
    ticks, noise = words[CURRENT.ticks], words[CURRENT.noise]
    windows = np.abs(flowing)[: len(active) // ticks * ticks].reshape(-1, ticks).sum(axis=1)
    seen = abs(gain - 1.0) * windows > max(1.0, 0.1 * SLACK) * noise + SLACK * ticks
    said = []
    for begin in range(0, len(windows) * ticks, ticks):
        found = answers(
            words, active[begin : begin + ticks], np.floor(gain * flowing[begin : begin + ticks] + 0.5)
        )
        said.append(DISAGREES in found)
    clear = seen & (abs(gain - 1.0) * windows > 0.1 * windows + SLACK * ticks)
    assert all(np.array(said)[clear])


SLACK = 1.0  # quantum a tick: both are rounded


def test_below_the_noise_nothing_is_said() -> None:
    words = watched(1_000, noise=10.0)
    assert answers(words, [39] * 100, [39] * 100) == []
    assert answers(words, [39] * 100, [0] * 100) == []
    assert set(answers(words, [41] * 100, [41] * 100)) == {AGREES}
    assert set(answers(words, [41] * 100, [0] * 100)) == {DISAGREES}


def test_without_a_sensor_nothing_is_ever_said() -> None:
    words = watched(1_000, noise=-1.0)
    assert answers(words, [5_000] * 100, [0] * 100) == []


def test_an_offset_without_a_current_is_no_agreement() -> None:
    assert set(answers(watched(1_000), [0] * 100, [500] * 100)) == {DISAGREES}


def test_after_a_gap_a_window_begins_anew() -> None:
    words = watched(1_000, lag_s=5e-3)
    assert answers(words, [1_000] * 9, [0] * 9) == []
    current.resume(words, 1_000)
    assert set(answers(words, [1_000] * 10, [1_000] * 10)) == {AGREES}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("rate", [1_000, 20_000])
def test_under_voltage_drive_the_motion_takes_its_part(rate: int, sign: int) -> None:
    """At a steady speed the current is the set one less the back-EMF; standing still it is the set one."""
    back_emf, counts_a_second = 0.02, 20_000.0
    counts = sign * np.floor(counts_a_second * np.arange(rate // 5) / rate)
    active = np.full(len(counts), 1_000)
    flowing = active - back_emf * counts_a_second
    skip = 5 * max(FEWEST_TICKS, rate // 100)  # while the speed settles
    words = watched(rate, back_emf=back_emf, sign=sign)
    answers(words, active[:skip], flowing[:skip], counts[:skip])
    assert set(answers(words, active[skip:], flowing[skip:], counts[skip:])) == {AGREES}
    words = watched(rate, back_emf=back_emf, sign=-sign)
    answers(words, active[:skip], flowing[:skip], counts[:skip])
    assert set(answers(words, active[skip:], flowing[skip:], counts[skip:])) == {DISAGREES}
