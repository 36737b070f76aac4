"""Measured against active current: a sound motor never disagrees, a dead or reversed one does."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import types
from scipy.signal import lfilter

from rig.control import current
from rig.control.current import AGREES, CURRENT, DISAGREES, FEWEST_TICKS, WORDS, compare
from rig.core.board import ROUNDED
from rig.core.current_sensor import SPEED_LAG_S, CurrentSensor
from rig.realtime.kernel import kernel

INTS = types.int64[::1]

RATES = (100, 1_000, 4_000, 20_000, 50_000)
LAGS_S = (0.0, 1.0e-4, 1.09e-4, 1e-3)


def new_check(
    rate: int,
    *,
    noise: float = 1.0,
    lag_s: float = 0.0,
    delay_s: float = 0.0,
    back_emf: float = 0.0,
    sign: int = 1,
) -> Any:
    words = memoryview(np.zeros(WORDS, np.int64))
    sensor = CurrentSensor(noise=noise, lag_s=lag_s, delay_s=delay_s, back_emf=back_emf)
    current.configure(words, sensor, rate, sign)
    return words


@kernel(types.void(INTS, INTS, INTS, INTS, INTS))
def run(words: Any, counts: Any, active: Any, measured: Any, found: Any) -> None:
    for i in range(len(found)):
        found[i] = compare(words, counts[i], active[i], measured[i])


def answers(words: Any, active: Any, measured: Any, counts: Any = None) -> list[int]:
    counts = np.zeros(len(active)) if counts is None else counts
    assert len(counts) == len(active) == len(measured)
    found = np.zeros(len(active), np.int64)
    ticks = (np.asarray(each).astype(np.int64) for each in (counts, active, measured))
    run(np.asarray(words), *ticks, found)
    return [int(one) for one in found[found != 0]]


def lagged(active: Any, rate: int, lag_s: float) -> Any:
    """Return the current behind a first-order lag at the end of each tick, exact, rounded as by a converter."""
    share = 1.0 if lag_s == 0.0 else -np.expm1(-1.0 / (rate * lag_s))
    return np.floor(lfilter([share], [1.0, share - 1.0], active) + 0.5)


def distance_outside(active: Any, measured: Any, rate: int, lag_s: float) -> Any:
    """Return the distance of a current from those behind the lag, half of it and twice of it (quanta)."""
    flowing = [lagged(active, rate, share * lag_s) for share in (1.0, 0.5, 2.0)]
    return np.abs(measured - np.clip(measured, np.min(flowing, axis=0), np.max(flowing, axis=0)))


def commands(rate: int, seed: int, ticks: int = 0) -> Any:
    """Return currents of steps, ramps and oscillations as of a wall, up to 6 A in quanta of 1 mA."""
    random = np.random.default_rng(seed)
    time = np.arange(ticks or max(2_000, rate // 10)) / rate
    hz, size = random.uniform(0.0, min(rate / 8, 400.0)), random.uniform(10.0, 6_000.0)
    wave = size * np.sin(2 * np.pi * hz * time + random.uniform(0.0, 6.0))
    return np.round(np.where(wave > random.uniform(-1.0, 1.0) * size, wave, 0.0))


@given(
    st.sampled_from(RATES),
    st.sampled_from(LAGS_S),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.integers(0, 2**32 - 1),
    st.floats(0.0, 20.0, allow_subnormal=False),
)
def test_sound_motor_never_disagrees(rate: int, lag_s: float, share: float, seed: int, noise: float) -> None:
    """The true lag is one of those for which the check predicts the current."""
    active = commands(rate, seed)
    random = np.random.default_rng(seed + 1)
    measured = lagged(active, rate, share * lag_s) + np.round(random.normal(0.0, noise, len(active)))
    total = float(np.hypot(noise, np.sqrt(2 / 12)))
    assert DISAGREES not in answers(new_check(rate, noise=total, lag_s=lag_s), active, measured)


def delayed(active: Any, rate: int, delay_s: float, lag_s: float) -> Any:
    """Return the exact current of set-points that act late, also by fractions of a tick, rounded as by a converter."""
    fine = 16  # parts of a tick
    parts = round(delay_s * rate * fine)
    acting = np.concatenate([np.zeros(parts), np.repeat(active, fine)])[: fine * len(active)]
    share = 1.0 if lag_s == 0.0 else -np.expm1(-1.0 / (fine * rate * lag_s))
    return np.floor(lfilter([share], [1.0, share - 1.0], acting)[fine - 1 :: fine] + 0.5)


@given(
    st.sampled_from(RATES),
    st.sampled_from(LAGS_S),
    st.sampled_from([2e-5, 1e-4, 2.5e-4, 7e-4, 1e-3, 9.5e-3]),
    st.sampled_from(["half", "as stated", "whole ticks", "twice"]),
    st.integers(0, 2**32 - 1),
)
def test_late_set_point_never_disagrees_and_a_dead_motor_does(
    rate: int, lag_s: float, delay_s: float, share: str, seed: int
) -> None:
    """The true delay is as stated, half or twice of it, or rounded up to whole ticks as in the simulation."""
    whole = np.ceil(delay_s * rate - 1e-9) / rate
    late_s = {"half": 0.5 * delay_s, "as stated": delay_s, "whole ticks": whole, "twice": 2.0 * delay_s}[
        share
    ]
    sensor = {"noise": ROUNDED, "lag_s": lag_s, "delay_s": delay_s}
    active = commands(rate, seed)
    flowing = delayed(active, rate, late_s, lag_s)
    assert DISAGREES not in answers(new_check(rate, **sensor), active, flowing)
    steady = np.full(max(200, rate // 10), 500)
    assert set(answers(new_check(rate, **sensor), steady, delayed(steady, rate, late_s, lag_s))) <= {AGREES}
    assert DISAGREES in answers(new_check(rate, **sensor), steady, 0 * steady)
    assert DISAGREES in answers(new_check(rate, **sensor), steady, -steady)


def test_currents_on_their_way_when_samples_were_lost_are_not_compared() -> None:
    """At 1 kHz with a delay of 3 ms, currents set before the gap flow for up to 6 ms after it."""
    words = new_check(1_000, delay_s=3e-3)
    current.resume(words, 0)
    active, before = np.full(200, 900), np.full(3, -800)
    flowing = np.concatenate([before, active])[: len(active)]
    assert set(answers(words, active, flowing)) == {AGREES}


@given(
    st.sampled_from(RATES),
    st.sampled_from(LAGS_S),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, -1.0, 5.0, 0.5, 1.25]),
)
def test_other_current_disagrees_in_clear_windows(rate: int, lag_s: float, seed: int, gain: float) -> None:
    active = commands(rate, seed)
    flowing = lagged(active, rate, lag_s)
    words = new_check(rate, noise=1.0, lag_s=lag_s)
    ticks, noise = words[CURRENT.ticks], words[CURRENT.noise]
    whole = len(active) // ticks * ticks
    windows = np.abs(flowing)[:whole].reshape(-1, ticks).sum(axis=1)
    left = distance_outside(active, gain * flowing, rate, lag_s)[:whole].reshape(-1, ticks).sum(axis=1)
    # One might be a spike.
    counted = left - np.abs((gain - 1.0) * flowing)[:whole].reshape(-1, ticks).max(axis=1)
    seen = counted > max(1.0, 0.1 * SLACK) * noise + SLACK * ticks
    disagrees = []
    for begin in range(0, len(windows) * ticks, ticks):
        found = answers(
            words, active[begin : begin + ticks], np.floor(gain * flowing[begin : begin + ticks] + 0.5)
        )
        disagrees.append(DISAGREES in found)
    clear = seen & (counted > 0.1 * windows + SLACK * ticks)
    assert all(np.array(disagrees)[clear])


SLACK = 1.0  # quantum a tick: both are rounded


@given(
    st.sampled_from(RATES),
    st.sampled_from(LAGS_S),
    st.integers(0, 2**32 - 1),
    st.sampled_from([-32_767, 32_767]),
)
def test_one_spike_in_a_window_is_no_disagreement(rate: int, lag_s: float, seed: int, spike: int) -> None:
    active = commands(rate, seed)
    measured = lagged(active, rate, lag_s)
    words = new_check(rate, lag_s=lag_s)
    ticks, random = words[CURRENT.ticks], np.random.default_rng(seed)
    measured[[begin + random.integers(ticks) for begin in range(0, len(active) - ticks + 1, ticks)]] = spike
    assert DISAGREES not in answers(words, active, measured)


def test_current_below_the_noise_gives_no_answer() -> None:
    words = new_check(1_000, noise=10.0)  # 400 in a window; nine of its ten count
    assert answers(words, [44] * 100, [44] * 100) == []
    assert answers(words, [44] * 100, [0] * 100) == []
    assert set(answers(words, [45] * 100, [45] * 100)) == {AGREES}
    assert set(answers(words, [45] * 100, [0] * 100)) == {DISAGREES}


def test_board_without_a_sensor_gives_no_answer() -> None:
    words = new_check(1_000, noise=-1.0)
    assert answers(words, [5_000] * 100, [0] * 100) == []


def test_an_offset_without_a_current_is_no_agreement() -> None:
    assert set(answers(new_check(1_000), [0] * 100, [500] * 100)) == {DISAGREES}


def test_after_a_gap_a_window_begins_anew() -> None:
    words = new_check(1_000, lag_s=5e-3)
    assert answers(words, [1_000] * 9, [0] * 9) == []
    current.resume(words, 1_000)
    assert set(answers(words, [1_000] * 10, [1_000] * 10)) == {AGREES}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("rate", [1_000, 20_000])
def test_under_voltage_drive_the_motion_takes_its_part(rate: int, sign: int) -> None:
    """At steady speed the current is the set one minus back-EMF; at standstill it is the set one."""
    back_emf, counts_a_second = 0.02, 20_000.0
    counts = sign * np.floor(counts_a_second * np.arange(rate // 5) / rate)
    active = np.full(len(counts), 1_000)
    flowing = active - back_emf * counts_a_second
    skip = 5 * max(FEWEST_TICKS, rate // 100)  # while the speed settles
    words = new_check(rate, back_emf=back_emf, sign=sign)
    answers(words, active[:skip], flowing[:skip], counts[:skip])
    assert set(answers(words, active[skip:], flowing[skip:], counts[skip:])) == {AGREES}
    words = new_check(rate, back_emf=back_emf, sign=-sign)
    answers(words, active[:skip], flowing[:skip], counts[:skip])
    assert set(answers(words, active[skip:], flowing[skip:], counts[skip:])) == {DISAGREES}


def moving_motor(rate: int, lag_s: float, back_emf: float, most: float, seed: int) -> tuple[Any, Any, Any]:
    """Return counts, active and flowing current of a driven motor that is moved at up to 60 Hz.

    `most` is the largest back-EMF (quanta). At a speed v·cos ωt it reduces the current by v·Re(e^{jωt}/(1 + jωτ)).
    """
    random = np.random.default_rng(seed)
    ticks = max(400, rate // 5)
    time = np.arange(1, ticks + 1) / rate
    counts, taken = np.zeros(ticks), np.zeros(ticks)
    for _ in range(3):
        omega, phase = 2 * np.pi * random.uniform(0.5, 60.0), random.uniform(0.0, 6.0)
        speed = min(most / back_emf, 30_000.0 * rate) * random.uniform(0.0, 1 / 3)
        counts += speed / omega * np.sin(omega * time + phase)
        taken += back_emf * speed * (np.exp(1j * (omega * time + phase)) / (1 + 1j * omega * lag_s)).real
    active = commands(rate, seed + 1, ticks)
    return np.floor(counts + 0.5), active, lagged(active, rate, lag_s) - taken


VOLTAGE = given(
    st.sampled_from([rate for rate in RATES if rate >= 1_000]),
    st.sampled_from(LAGS_S),
    st.floats(1e-3, 0.1),
    st.floats(100.0, 20_000.0),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, -1]),
)


def voltage_drive_check(rate: int, lag_s: float, back_emf: float, sign: int) -> Any:
    noise = float(np.hypot(ROUNDED, ROUNDED * back_emf / SPEED_LAG_S))
    return new_check(rate, noise=noise, lag_s=lag_s, back_emf=back_emf, sign=sign)


@VOLTAGE
def test_sound_motor_under_voltage_drive_never_disagrees(
    rate: int, lag_s: float, back_emf: float, most: float, seed: int, sign: int
) -> None:
    counts, active, flowing = moving_motor(rate, lag_s, back_emf, most, seed)
    words = voltage_drive_check(rate, lag_s, back_emf, sign)
    assert DISAGREES not in answers(words, active, np.floor(flowing + 0.5), sign * counts)
    current.resume(words, int(flowing[0]))
    assert DISAGREES not in answers(words, active, np.floor(flowing + 0.5), sign * counts), "nor after a gap"


@VOLTAGE
def test_dead_or_reversed_motor_under_voltage_drive_disagrees(
    rate: int, lag_s: float, back_emf: float, most: float, seed: int, sign: int
) -> None:
    """Judged where the expected current, smoothed like the speed, is clearly above the noise."""
    counts, active, flowing = moving_motor(rate, lag_s, back_emf, most, seed)
    for gain in (0.0, -1.0):
        words = voltage_drive_check(rate, lag_s, back_emf, sign)
        ticks, noise = words[CURRENT.ticks], words[CURRENT.noise]
        windows = len(flowing) // ticks
        smoothed = lagged(flowing, rate, SPEED_LAG_S)
        smooth = np.abs(smoothed)[: windows * ticks].reshape(-1, ticks).sum(axis=1)
        # a smoothed difference is at most as large as the difference was lately: twice the windows before
        lags = (
            sum(np.abs(lagged(active, rate, f * lag_s) - lagged(active, rate, lag_s)) for f in (0.5, 2.0))
            + SLACK
        )
        answers(words, active[:1], gain * flowing[:1], sign * counts[:1])  # it begins with a count
        for begin, total in zip(range(0, windows * ticks, ticks), smooth, strict=True):
            here = slice(begin + 1, begin + ticks + 1)
            found = answers(words, active[here], np.floor(gain * flowing[here] + 0.5), sign * counts[here])
            if begin < 3 * ticks or begin + ticks >= len(flowing):
                continue
            spared = (np.abs(flowing) + np.abs(active))[begin - ticks : begin + ticks + 1].max()
            lag = lags[begin - 2 * ticks : begin + ticks].sum()
            if total > 2.0 * noise + 0.2 * smooth.max() + spared + lag:
                assert found == [DISAGREES]


@pytest.mark.parametrize("rate", [1_000, 20_000])
@pytest.mark.parametrize("at", [3, 9])
def test_one_spike_across_windows_is_forgiven_under_voltage_drive(rate: int, at: int) -> None:
    counts, active, flowing = moving_motor(rate, 1e-4, 0.017, 500.0, 3)
    words = voltage_drive_check(rate, 1e-4, 0.017, 1)
    measured = np.floor(flowing + 0.5)
    measured[1 + words[CURRENT.ticks] * at // 10 :: 4 * words[CURRENT.ticks]] += 12_000
    assert set(answers(words, active, np.minimum(measured, 32_767), counts)) <= {AGREES}
