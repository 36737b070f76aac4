"""The compiled measures of a trial against scipy, numpy, closed forms, and trials of the simulated rig."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt, sosfreqz

from rig.control._measure import FEWEST_TICKS, LOST_BITS, NUMBERS, OVERRULED, filters, toggling_floor
from rig.control._median import median
from rig.control.judging import meter
from rig.core.sample import RowFlag
from tests.rig.control.test_verdict import DELTA, RATE, TIME
from tests.rig.control.test_verdict import LIMITS as VERDICT_LIMITS

LIMITS = replace(VERDICT_LIMITS, felt_velocity=1e9)  # no floor hides it
QUIET = np.zeros(RATE)


def measure_counts(
    position: Any, *, effort: Any = None, resolution: Any = DELTA, limits: Any = LIMITS
) -> Any:
    """Return the measures of a trial whose position is known by counts only."""
    flags = np.zeros(len(position), np.int64)
    effort = np.zeros(len(position)) if effort is None else effort
    return meter(limits, 1.0 / RATE, resolution).recorded(position, effort, position, flags)


def rms(signal: Any) -> Any:
    return math.sqrt(np.mean(np.square(signal)))


def by_scipy(position: Any, velocity: Any, effort: Any, rate: Any, limits: Any = LIMITS) -> Any:
    """Return felt, heard, moved and growth, computed with scipy's filters over the whole trial."""
    tail = slice(max(0, len(position) - round(limits.tail_s * rate)), None)
    highpass = butter(2, limits.highpass_hz, "highpass", fs=rate, output="sos")
    band = highpass
    if limits.lowpass_hz < 0.45 * rate:
        band = butter(2, [limits.highpass_hz, limits.lowpass_hz], "bandpass", fs=rate, output="sos")
    pad = min(len(position) - 1, round(3.0 * rate / limits.highpass_hz))
    started = sosfilt_zi(highpass)
    ripple = sosfilt(highpass, effort, zi=started * effort[0])[0][tail]
    swing = sosfilt(highpass, position, zi=started * position[0])[0][tail]
    half = len(ripple) // 2
    return {
        "felt": rms(sosfiltfilt(band, velocity, padtype="even", padlen=pad)[tail]),
        "heard": rms(ripple),
        "moved": np.ptp(swing),
        "growth": rms(ripple[half:]) / rms(ripple[:half]),
    }


def counts(position: Any, offset: float = 0.3) -> Any:
    return np.floor(position / DELTA + offset) * DELTA


@given(
    ticks=st.integers(8, 700),
    rate=st.sampled_from([1_000, 2_000, 20_000]),
    has_velocity=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_trial_filtered_whole_is_as_by_scipy(ticks: int, rate: Any, has_velocity: bool, seed: int) -> None:
    """The trial is shorter than tail and lead-in, so both filter the same samples and differ by rounding only."""
    position, effort, velocity = np.cumsum(np.random.default_rng(seed).normal(size=(3, ticks)), axis=1)
    if not has_velocity:
        velocity = np.gradient(position, 1.0 / rate)
    flags = np.zeros(ticks, np.int64)
    measuring = meter(LIMITS, 1.0 / rate, 0.0)
    given_velocity = velocity if has_velocity else None
    numbers = measuring.recorded(position, effort, position, flags, given_velocity)
    for name, value in by_scipy(position, velocity, effort, rate).items():
        assert numbers[name] == pytest.approx(value, rel=1e-8, abs=1e-10), name


def impact(seed: Any) -> Any:
    """Return a signal with half a second of violent motion, then a tail that is a thousand times calmer."""
    rng = np.random.default_rng(seed)
    calm = 1e-3 * rng.normal(size=RATE)
    wild = np.where(TIME < 0.55, np.sin(2 * np.pi * 80 * TIME) + rng.normal(size=RATE), 0.0)
    return calm + wild


@pytest.mark.parametrize("seed", range(4))
def test_the_lead_in_stands_for_the_whole_trial(seed: int) -> None:
    """1 s at 20 kHz is filtered from 0.44 s on; earlier samples change no measure by more than 1e-6."""
    effort, position = impact(seed), 1e-2 * impact(seed + 10)
    velocity = np.gradient(position, 1.0 / RATE)
    assert filters(1.0 / RATE, 30.0, 500.0).lead_ticks < 0.17 * RATE
    numbers = measure_counts(position, effort=effort, resolution=0.0)
    for name, value in by_scipy(position, velocity, effort, RATE).items():
        assert numbers[name] == pytest.approx(value, rel=1e-6), name


@given(
    values=st.lists(
        st.sampled_from([-2.0, 0.0, 0.5, 1e-9, 7.0]) | st.floats(-1e9, 1e9, allow_subnormal=False), min_size=1
    )
)
def test_the_median_is_that_of_numpy(values: Any) -> None:
    assert median(np.array(values), len(values)) == np.median(values)


@given(contact=st.integers(4, 300), seed=st.integers(0, 2**32 - 1))
def test_the_velocity_at_impact_is_that_of_the_parabola_with_least_squares(contact: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    position = -1.0 + 1e-3 * np.arange(400) + rng.normal(size=400) * 1e-4
    penetration = np.where(np.arange(400) >= contact, 1.0, -1.0)
    numbers = meter(LIMITS, 1.0 / RATE, DELTA).recorded(
        position, np.zeros(400), penetration, np.zeros(400, np.int64)
    )
    first = max(0, contact - 200)  # 10 ms
    fitted = np.polyfit(np.arange(first - contact, 1.0), position[first : contact + 1], 2)[1] * RATE
    assert numbers["contact_s"] == contact * (1.0 / RATE)
    assert numbers["impact_velocity"] == pytest.approx(fitted, rel=1e-7)


def square(hz: Any, duty: float = 0.5) -> Any:
    return DELTA * (10 + ((hz * TIME + 0.123) % 1.0 < duty))


def jittered(hz: Any, jitter: Any, seed: int = 0) -> Any:
    """Return a position that toggles by a count 2·hz times a second, each time off by `jitter` half periods (rms)."""
    changes = np.arange(2 * hz) + jitter * np.random.default_rng(seed).normal(size=2 * hz)
    marks = np.bincount(np.clip(changes * RATE / (2 * hz), 0, RATE - 1).astype(int), minlength=RATE)
    return DELTA * (np.cumsum(marks) % 2)


def telegraph(changes_per_s: Any, seed: int = 0) -> Any:
    return DELTA * (np.cumsum(np.random.default_rng(seed).random(RATE) < changes_per_s / RATE) % 2)


def floor_at(hz: Any) -> Any:
    return toggling_floor(hz, DELTA, LIMITS.highpass_hz, LIMITS.lowpass_hz)


def floor_hz(position: Any) -> Any:
    """Return the toggling frequency that the measured floor implies, where no harmonic is in the band."""
    one_line = replace(LIMITS, highpass_hz=30.0, lowpass_hz=31.0)
    numbers = measure_counts(position, limits=one_line)
    return numbers["felt_floor"] / (2.0 * math.sqrt(2.0) * DELTA)


def test_the_floor_of_a_frequency_sums_the_harmonics_in_the_band_in_power() -> None:
    """In the band 100 Hz has lines at 100, 300 and 500 Hz; 20 Hz has twelve: 60, 100, … 500 Hz."""
    fundamental = 2.0 * math.sqrt(2.0) * DELTA
    assert floor_at(100.0) == pytest.approx(math.sqrt(3.0) * fundamental * 100.0)
    assert floor_at(20.0) == pytest.approx(math.sqrt(12.0) * fundamental * 20.0)
    assert floor_at(700.0) == pytest.approx(fundamental * 700.0)
    assert floor_at(0.0) == 0.0


def test_one_changing_count_reads_no_more_than_its_floor() -> None:
    """A harmonic just above the band passes in part and adds a tenth (510 Hz of 170)."""
    for position in (
        *(square(hz, duty) for hz in (5, 12, 31, 47, 52, 90, 130, 170) for duty in (0.5, 0.2, 0.05)),
        *(jittered(hz, jitter) for hz in (40, 80, 150) for jitter in (0.05, 0.2)),
        *(telegraph(rate, seed) for rate in (20, 60, 100, 200, 400, 1000) for seed in range(3)),
        *(counts(rate * DELTA * TIME) for rate in (10, 30, 50, 70, 110, 200, 400, 550)),
    ):
        numbers = measure_counts(position)
        assert numbers["felt"] < 1.12 * numbers["felt_floor"]


@pytest.mark.parametrize("stiffness", [15, 20, 30, 60, 200])
def test_a_slow_press_on_a_soft_wall_is_never_called_felt(stiffness: int) -> None:
    """0.4 N·m that varies by a fifth at 2 Hz crosses many counts, but has almost no true velocity in the band."""
    press = 0.4 / stiffness * (1.0 + 0.2 * np.sin(2 * np.pi * 2.0 * TIME + 1.5))
    felt = measure_counts(counts(press), limits=replace(LIMITS, felt_velocity=0.05))["felt"]
    assert math.isnan(felt) or felt < 0.05


@pytest.mark.parametrize("hz", [33.0, 40.0, 60.0, 150.0])
@pytest.mark.parametrize("amplitude", [3.0, 10.0, 40.0])
def test_oscillation_over_many_counts_has_its_own_floor(hz: float, amplitude: float) -> None:
    position = counts(amplitude * DELTA * np.sin(2 * np.pi * hz * TIME))
    assert floor_hz(position) == pytest.approx(hz, abs=1.3)  # one change more or less in 0.4 s


def test_columns_of_a_larger_array_give_the_same_bits() -> None:
    """A sweep passes columns of a trial's state array, which are not contiguous."""
    position = 1e-2 * impact(1)
    states = np.stack([position, np.gradient(position, 1.0 / RATE), impact(2), position], axis=1)
    columns = [*states.T, np.zeros(RATE, np.int64)]
    assert not columns[0].flags.c_contiguous
    copies = [np.ascontiguousarray(signal) for signal in columns]
    for signal in copies:
        signal.flags.writeable = False
    measuring = meter(LIMITS, 1.0 / RATE, DELTA)
    assert measuring.true(*columns).tobytes() == measuring.true(*copies).tobytes()


def test_a_meter_remembers_nothing_of_the_trial_before() -> None:
    position, effort, flags = counts(1e-2 * impact(1)), impact(2), np.zeros(RATE, np.int64)
    trial = position, effort, position, flags
    used, fresh = (meter(LIMITS, 1.0 / RATE, DELTA) for _ in range(2))
    first = used.recorded(*trial)
    kept = first.tobytes()
    used.true(position, effort, effort, position, flags)
    used.recorded(*(signal[:100] for signal in trial))
    assert first.tobytes() == kept, "a record is the caller's"
    assert used.recorded(*trial).tobytes() == fresh.recorded(*trial).tobytes() == kept


def test_flags_are_counted_in_the_trial_and_in_its_tail() -> None:
    flags = np.zeros(RATE, np.int64)
    flags[[0, 5, -1]] |= int(RowFlag.SATURATED | RowFlag.INSIDE)
    flags[3:303] |= int(RowFlag.LATE)
    flags[-4:] |= int(RowFlag.SLEW_BOUND)
    flags[-5:] |= OVERRULED
    numbers = meter(LIMITS, 1.0 / RATE, DELTA).recorded(QUIET, QUIET, QUIET, flags)
    assert numbers["saturated_fraction"] == 3 / RATE
    assert numbers["saturated_fraction_in_tail"] == 1 / 8_000
    assert (numbers["late_ticks"], numbers["late_fraction"]) == (300, 0.0), "the wall was not touched"
    assert (numbers["slew_bound_ticks"], numbers["overruled_ticks"]) == (4, 5)
    assert not any(OVERRULED & flag for flag in RowFlag)


@given(contact=st.integers(0, 120), drawn=st.binary(min_size=100, max_size=100))
def test_lost_samples_are_counted_in_all_and_from_the_contact_on(contact: int, drawn: bytes) -> None:
    each = np.frombuffer(drawn, np.uint8).astype(np.int64)
    lost, late = each & 3, each >> 2 & 1
    flags = (lost << LOST_BITS) | int(RowFlag.LATE) * late | OVERRULED
    penetration = np.where(np.arange(100) >= contact, 1.0, -1.0)
    zeros = np.zeros(100)
    n = meter(LIMITS, 1.0 / RATE, DELTA).recorded(zeros, zeros, penetration, flags)
    assert (n["gaps"], n["lost_samples"], n["late_ticks"]) == ((lost > 0).sum(), lost.sum(), late.sum())
    assert n["overruled_ticks"] == 100
    after, late_after = lost[contact:], late[contact:]
    assert n["longest_gap"] == after.max(initial=0)
    assert n["lost_fraction"] == pytest.approx(after.sum() / max(1, len(after) + after.sum()))
    assert n["late_fraction"] == pytest.approx(late_after.sum() / max(1, len(after)))


@pytest.mark.parametrize("ticks", [0, 1, FEWEST_TICKS - 1])
def test_a_trial_too_short_to_be_measured_is_written_whole(ticks: Any) -> None:
    measuring = meter(LIMITS, 1.0 / RATE, DELTA)
    measuring.recorded(TIME, TIME, TIME, np.ones(RATE, np.int64) * 0xFF)  # leaves nothing behind
    few = TIME[:ticks]
    numbers = measuring.recorded(few, few, few, np.zeros(ticks, np.int64))
    assert numbers["ticks"] == ticks
    assert math.isnan(numbers["tail_begins_s"])
    rest = {name: numbers[name] for name in NUMBERS.names if name != "ticks"}
    assert all(value == 0 or math.isnan(value) for value in rest.values())


@pytest.mark.parametrize("hz", [800.0, 1300.0, 2000.0])
def test_a_ripple_above_the_band_is_felt_as_little_as_the_filter_lets_through(hz: float) -> None:
    """At any phase at the trial's end, the filter's extension must not create a step."""
    rate, amplitude = 20_000, 0.05 * math.sqrt(2.0)
    time = np.arange(rate) / rate
    w = butter(2, [30.0, 500.0], "bandpass", fs=rate, output="sos")
    gain = abs(sosfreqz(w, [hz], fs=rate)[1][0]) ** 2
    for phase in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        velocity = amplitude * np.sin(2.0 * np.pi * hz * time + phase)
        calm = np.zeros(rate)
        numbers = meter(replace(LIMITS, felt_velocity=1e9), 1.0 / rate, 0.0).true(
            calm, velocity, calm, calm + 1e-3, np.zeros(rate, np.int64)
        )
        assert numbers["felt"] == pytest.approx(0.05 * gain, rel=0.25, abs=0.005 * amplitude)
