"""The compiled numbers of a trial against scipy, numpy, closed forms, and trials of the simulated rig."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

from rig import config
from rig.config import controller, presets
from rig.control import measure
from rig.control.judging import meter
from rig.control.measure import FEWEST_TICKS, LOST_BITS, NUMBERS, OVERRULED, filters, toggling_floor
from rig.control.median import median
from rig.control.verdict import Thresholds, Verdict
from rig.core.sample import Phase, RowFlag
from sim_backend.plant import DiscretePlant
from sim_backend.trial import run_trial

RATE = 20_000
DELTA = 1.5708e-4  # Koul et al.: 1000 lines, x4, 10:1
LIMITS = Thresholds(
    tail_s=0.4,
    highpass_hz=30.0,
    lowpass_hz=500.0,
    felt_velocity=1e9,  # no floor hides it
    heard_effort=0.10,
    moved=1.25e-3,
    growth=1.2,
    late_fraction=0.01,
    longest_gap=2,
    lost_fraction=0.003,
    saturated_fraction=0.01,
)
TIME = np.arange(RATE) / RATE
QUIET = np.zeros(RATE)


def recorded(
    position: Any, *, effort: Any = None, resolution: Any = DELTA, rate: Any = RATE, limits: Any = LIMITS
) -> Any:
    """Numbers of a trial from its counts alone."""
    flags = np.zeros(len(position), np.int64)
    effort = np.zeros(len(position)) if effort is None else effort
    return meter(limits, 1.0 / rate, resolution).recorded(position, effort, position, flags)


def true(position: Any, velocity: Any, effort: Any) -> Any:
    flags = np.zeros(len(position), np.int64)
    return meter(LIMITS, 1.0 / RATE, DELTA).true(position, velocity, effort, position, flags)


def rms(signal: Any) -> Any:
    return math.sqrt(np.mean(np.square(signal)))


def by_scipy(position: Any, velocity: Any, effort: Any, rate: Any, limits: Any = LIMITS) -> Any:
    """Felt, heard, moved and growth with scipy's filters over the whole trial."""
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


# --- filters ----------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(
    ticks=st.integers(8, 700),
    rate=st.sampled_from([1_000, 2_000, 20_000]),
    has_velocity=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_trial_that_is_filtered_whole_gives_what_scipy_gives(
    ticks: int, rate: Any, has_velocity: bool, seed: int
) -> None:
    """Shorter than tail and lead-in: the same filters over the same samples, to rounding."""
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
    """Half a second of violence, then a tail that is a thousand times calmer."""
    rng = np.random.default_rng(seed)
    calm = 1e-3 * rng.normal(size=RATE)
    wild = np.where(TIME < 0.55, np.sin(2 * np.pi * 80 * TIME) + rng.normal(size=RATE), 0.0)
    return calm + wild


@pytest.mark.parametrize("seed", range(4))
def test_the_lead_in_stands_for_the_whole_trial(seed: int) -> None:
    """1 s at 20 kHz is filtered from 0.44 s on; what was before changes no number by a millionth."""
    effort, position = impact(seed), 1e-2 * impact(seed + 10)
    velocity = np.gradient(position, 1.0 / RATE)
    assert filters(1.0 / RATE, 30.0, 500.0).lead_ticks < 0.17 * RATE
    numbers = recorded(position, effort=effort, resolution=0.0)
    for name, value in by_scipy(position, velocity, effort, RATE).items():
        assert numbers[name] == pytest.approx(value, rel=1e-6), name


def test_what_a_filter_still_remembers_of_the_trial_before_the_lead_in_is_a_billionth() -> None:
    """A step of 1 before the lead-in and nothing since: the whole trial remembers it, the lead-in does not."""
    lead_s = filters(1.0 / RATE, 30.0, 500.0).lead_ticks / RATE
    step = np.where(0.599 - lead_s > TIME, 0.0, 1.0)
    whole = by_scipy(step, step, step, RATE)
    numbers = true(step, step, step)
    for name in ("felt", "heard", "moved"):
        assert numbers[name] == 0.0
        assert whole[name] < 1e-9, name


def test_a_constant_leaves_no_ripple_at_all() -> None:
    numbers = recorded(np.full(RATE, 1.234e-3), effort=np.full(RATE, 0.7), resolution=0.0)
    assert [numbers[name] for name in ("felt", "heard", "moved", "growth", "felt_floor")] == [0.0] * 5


# --- selection and fits -----------------------------------------------------------------------------------


@settings(max_examples=100, deadline=None)
@given(values=st.lists(st.sampled_from([-2.0, 0.0, 0.5, 1e-9, 7.0]) | st.floats(-1e9, 1e9), min_size=1))
def test_the_median_is_that_of_numpy(values: Any) -> None:
    assert median(np.array(values), len(values)) == np.median(values)


@pytest.mark.parametrize("shape", ["constant", "ramp", "organ pipe", "sine", "nan"])
def test_the_median_ends_for_every_order_of_values(shape: str) -> None:
    n = 2_000
    values = {
        "constant": np.ones(n),
        "ramp": np.arange(n, dtype=float)[::-1].copy(),
        "organ pipe": np.concatenate([np.arange(n / 2), np.arange(n / 2)[::-1]]),
        "sine": np.sin(np.arange(n) / 50.0),
        "nan": np.where(np.arange(n) % 3, 1.0, np.nan),
    }[shape]
    middle = median(values.copy(), n)
    assert math.isnan(np.median(values)) or middle == np.median(values)


@settings(max_examples=50, deadline=None)
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


# --- the encoder's floor ----------------------------------------------------------------------------------


def square(hz: Any, duty: float = 0.5) -> Any:
    return DELTA * (10 + ((hz * TIME + 0.123) % 1.0 < duty))


def jittered(hz: Any, jitter: Any, seed: int = 0) -> Any:
    """A count that changes 2·hz times a second, each time off by `jitter` of half a period (rms)."""
    changes = np.arange(2 * hz) + jitter * np.random.default_rng(seed).normal(size=2 * hz)
    marks = np.bincount(np.clip(changes * RATE / (2 * hz), 0, RATE - 1).astype(int), minlength=RATE)
    return DELTA * (np.cumsum(marks) % 2)


def telegraph(changes_per_s: Any, seed: int = 0) -> Any:
    """A count that changes at random, without any period."""
    return DELTA * (np.cumsum(np.random.default_rng(seed).random(RATE) < changes_per_s / RATE) % 2)


def floor_of(position: Any) -> Any:
    return float(recorded(position)["felt_floor"])


def floor_at(hz: Any) -> Any:
    return toggling_floor(hz, DELTA, LIMITS.highpass_hz, LIMITS.lowpass_hz)


def dominant_hz(position: Any) -> Any:
    """Highest line in the spectrum of the tail, the other definition of the frequency of a toggling."""
    highpass = butter(2, 30.0, "highpass", fs=RATE, output="sos")
    tail = sosfilt(highpass, position - position[0])[-8_000:]
    return np.argmax(np.abs(np.fft.rfft(tail * np.hanning(8_000)))) * RATE / 8_000


def told_hz(position: Any) -> Any:
    """Frequency that the floor was told of, where no harmonic is left in the band."""
    one_line = replace(LIMITS, highpass_hz=30.0, lowpass_hz=31.0)
    numbers = recorded(position, limits=one_line)
    return numbers["felt_floor"] / (2.0 * math.sqrt(2.0) * DELTA)


def test_the_floor_of_a_frequency_sums_the_harmonics_in_the_band_in_power() -> None:
    """100 Hz: 100, 300 and 500 Hz; 20 Hz: 60, 100, … 500 Hz, twelve lines."""
    fundamental = 2.0 * math.sqrt(2.0) * DELTA
    assert floor_at(100.0) == pytest.approx(math.sqrt(3.0) * fundamental * 100.0)
    assert floor_at(20.0) == pytest.approx(math.sqrt(12.0) * fundamental * 20.0)
    assert floor_at(700.0) == pytest.approx(fundamental * 700.0)
    assert floor_at(0.0) == 0.0


@pytest.mark.parametrize("hz", [35, 60, 100, 151, 240, 400])
def test_for_whatever_has_a_period_in_the_band_it_is_the_highest_line_of_the_spectrum(hz: int) -> None:
    sine = 7.3 * DELTA * np.sin(2 * np.pi * hz * TIME)
    for position in (square(hz), square(hz, 0.3), square(hz, 0.7), jittered(hz, 0.05), counts(sine)):
        assert told_hz(position) == pytest.approx(
            dominant_hz(position), abs=3.75
        )  # its lines are 2.5 Hz apart


def away(floor: Any, reading: Any) -> Any:
    return abs(math.log(floor / reading))


def test_where_it_differs_from_the_highest_line_it_is_nearer_to_what_the_count_reads() -> None:
    """Toggling below the high pass, a short burst, a creeping count."""
    burst = DELTA * ((np.sin(2 * np.pi * 200 * TIME) > 0) & (TIME > 0.7) & (TIME < 0.74))
    for position in (square(10), burst, counts(30 * DELTA * TIME), counts(100 * DELTA * TIME)):
        reading = recorded(position)["felt"]
        assert away(floor_of(position), reading) < away(floor_at(dominant_hz(position)), reading)


@pytest.mark.parametrize("changes_per_s", [20, 60, 150])
def test_without_a_period_the_rate_of_changes_tells_what_the_count_reads(changes_per_s: int) -> None:
    for seed in range(8):
        position = telegraph(changes_per_s, seed)
        assert away(floor_of(position), recorded(position)["felt"]) < 0.3


@pytest.mark.parametrize(
    "position",
    [
        *(square(hz, duty) for hz in (5, 12, 31, 47, 52, 90, 130, 170) for duty in (0.5, 0.2, 0.05)),
        *(jittered(hz, jitter) for hz in (40, 80, 150) for jitter in (0.05, 0.2)),
        *(telegraph(rate, seed) for rate in (20, 60, 100, 200, 400, 1000) for seed in range(3)),
        *(counts(rate * DELTA * TIME) for rate in (10, 30, 50, 70, 110, 200, 400, 550)),
    ],
)
def test_one_count_that_changes_without_a_motion_in_the_band_reads_no_more_than_its_floor(
    position: Any,
) -> None:
    """A tenth more where a harmonic lies just above the band, which lets it through in part (510 Hz of 170)."""
    numbers = recorded(position)
    assert numbers["felt"] < 1.12 * numbers["felt_floor"]


@pytest.mark.parametrize("stiffness", [15, 20, 30, 60, 200])
def test_a_slow_press_on_a_soft_wall_is_never_called_felt(stiffness: int) -> None:
    """0.4 N·m that swells by a fifth at 2 Hz crosses many counts; its true velocity in the band is next to none."""
    press = 0.4 / stiffness * (1.0 + 0.2 * np.sin(2 * np.pi * 2.0 * TIME + 1.5))
    assert math.isnan(recorded(counts(press), limits=replace(LIMITS, felt_velocity=0.05))["felt"]) or (
        recorded(counts(press))["felt"] < 0.05
    )


@pytest.mark.parametrize("hz", [33.0, 40.0, 60.0, 150.0])
@pytest.mark.parametrize("amplitude", [3.0, 10.0, 40.0])
def test_an_oscillation_over_many_counts_has_the_floor_of_its_own_frequency(
    hz: float, amplitude: float
) -> None:
    """Not of the many counts that it crosses on its way."""
    position = counts(amplitude * DELTA * np.sin(2 * np.pi * hz * TIME))
    assert told_hz(position) == pytest.approx(hz, abs=1.3)  # one change more or less in 0.4 s


# --- the meter --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hits() -> Any:
    """Hits of the simulated rigs: a calm one, one that bounces for ever, and one on the linear rig."""
    return [
        hit("koul-compliant", {}),
        hit(
            "koul-compliant",
            {"wall.stiffness": 450.0, "wall.damping": 1.5, "controller.velocity_rate": 20000},
        ),
        hit("chawda-linear", {}),
    ]


def hit(name: Any, changes: Any) -> Any:
    """Arrays of the trial phase of one hit, as a sweep has them: columns of its states, and what was recorded."""
    experiment = config.override(presets.load(name), changes)
    tick_s = 1.0 / experiment.controller.position_rate
    quantum = experiment.rig.amplifier.current_quantum_a
    law = controller.for_experiment(experiment, current_quantum_a=quantum)
    plant = DiscretePlant.build(config.rig_model(experiment), tick_s)
    trace = run_trial(law, plant, experiment.trial.start, most_ticks=round(2.5 / tick_s))
    trial = np.flatnonzero(trace.phases == Phase.TRIAL)
    span = slice(trial[0], trial[-1] + 1)
    encoder, wall = experiment.rig.encoder, experiment.wall
    states, flags = trace.states[span], trace.flags[span]
    position = trace.counts[span] * encoder.resolution * encoder.sign
    return {
        "tick_s": tick_s,
        "resolution": encoder.resolution,
        "limits": config.verdict_thresholds(experiment),
        "recorded": (
            position,
            trace.currents[span] * float(law.control["effort_quantum"][0]),
            wall.side * (position - wall.position),
            flags,
        ),
        "true": (
            states[:, plant.sensed_position],
            states[:, plant.sensed_position + 1],
            states[:, plant.effort],
            wall.side * (states[:, plant.sensed_position] - wall.position),
            flags,
        ),
    }


def test_hits_of_the_simulated_rigs_have_the_numbers_that_scipy_gives_for_the_whole_trial(hits: Any) -> None:
    for trial in hits:
        limits = replace(trial["limits"], felt_velocity=1e9)
        rate = 1.0 / trial["tick_s"]
        measuring = meter(limits, trial["tick_s"], trial["resolution"])
        position, effort, _, _ = trial["recorded"]
        velocity = np.gradient(position, trial["tick_s"])
        expected = by_scipy(position, velocity, effort, rate, limits)
        expected["moved"] = max(0.0, expected["moved"] - trial["resolution"])
        compare(measuring.recorded(*trial["recorded"]), expected)
        position, velocity, effort, _, _ = trial["true"]
        compare(measuring.true(*trial["true"]), by_scipy(position, velocity, effort, rate, limits))


def compare(numbers: Any, expected: Any) -> None:
    """A millionth of the value, or the billionth of the impact that a filter may still remember."""
    assert numbers["felt"] == pytest.approx(expected["felt"], rel=1e-6, abs=1e-9)
    assert numbers["heard"] == pytest.approx(expected["heard"], rel=1e-6, abs=1e-8)
    assert numbers["moved"] == pytest.approx(expected["moved"], rel=1e-6, abs=1e-11)
    if expected["heard"] > 1e-4:
        assert numbers["growth"] == pytest.approx(expected["growth"], rel=1e-5)


def test_the_floor_of_a_hit_at_rest_on_the_edge_of_a_count_is_that_of_all_its_changes(hits: Any) -> None:
    """Friction holds the handle where the count toggles in pulses, 407 of them a second; the highest line is at 115 Hz.

    Pulses that short read a quarter of their floor: it is no estimate but a bound, also with the highest line.
    """
    position, *others = hits[0]["recorded"]
    toggled = int(np.count_nonzero(np.diff(position[-8_001:])))
    numbers = meter(LIMITS, 1.0 / RATE, DELTA).recorded(position, *others)
    assert np.ptp(position[-8_000:]) == pytest.approx(DELTA, rel=1e-3)
    assert numbers["felt_floor"] == pytest.approx(floor_at(toggled / 0.8))
    assert numbers["felt"] < floor_at(dominant_hz(position)) < numbers["felt_floor"]


def test_the_floor_of_a_hit_that_bounces_is_that_of_the_mode_that_excites_the_encoder(hits: Any) -> None:
    """The handle hops at a low frequency, while the capstan's mode at 586 Hz moves the motor by some counts."""
    numbers = meter(LIMITS, 1.0 / RATE, DELTA).recorded(*hits[1]["recorded"])
    assert numbers["exits_in_tail"] > 50
    assert numbers["felt_floor"] == pytest.approx(floor_at(586.0), rel=0.05)
    assert dominant_hz(hits[1]["recorded"][0]) < 60.0


def test_columns_of_a_bigger_array_give_the_same_bits_as_copies_and_nothing_is_written_to_them(
    hits: Any,
) -> None:
    trial = hits[0]
    measuring = meter(trial["limits"], trial["tick_s"], trial["resolution"])
    assert not trial["true"][0].flags.c_contiguous
    copies = [np.ascontiguousarray(signal) for signal in trial["true"]]
    for signal in copies:
        signal.flags.writeable = False
    assert measuring.true(*trial["true"]).tobytes() == measuring.true(*copies).tobytes()


def test_a_meter_remembers_nothing_of_the_trial_before(hits: Any) -> None:
    trial = hits[0]
    used, fresh = (meter(trial["limits"], trial["tick_s"], trial["resolution"]) for _ in range(2))
    first = used.recorded(*trial["recorded"])
    kept = first.tobytes()
    used.true(*trial["true"])
    used.recorded(*(signal[:100] for signal in trial["recorded"]))
    assert first.tobytes() == kept, "a record is the caller's"
    assert used.recorded(*trial["recorded"]).tobytes() == fresh.recorded(*trial["recorded"]).tobytes() == kept


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


@given(
    contact=st.integers(0, 120),
    drawn=st.binary(min_size=100, max_size=100),
)
def test_what_was_lost_is_counted_in_all_and_from_the_first_contact_on(contact: int, drawn: bytes) -> None:
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


def test_every_number_of_a_verdict_is_measured() -> None:
    assert set(Verdict.__dataclass_fields__) - {"kind", "reasons"} <= set(NUMBERS.names)


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


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="plain Python allocates")
def test_measuring_allocates_nothing() -> None:
    """Without numba's runtime a kernel that makes an array does not compile."""
    assert measure.measure.targetoptions["_nrt"] is False


def test_filters_are_designed_once_for_a_rate() -> None:
    assert filters(1e-3, 30.0, 500.0) is filters(1e-3, 30.0, 500.0)
    assert asdict(LIMITS)["lowpass_hz"] >= 0.45 * 1_000.0  # dropped: what is left passes 400 Hz
    tone = np.sin(2 * np.pi * 400.0 * np.arange(1_000) * 1e-3)
    numbers = meter(LIMITS, 1e-3, 0.0).recorded(tone, tone, tone, np.zeros(1_000, np.int64), tone)
    assert numbers["felt"] == pytest.approx(math.sqrt(0.5), rel=0.01)


@pytest.mark.parametrize("hz", [800.0, 1300.0, 2000.0])
def test_a_ripple_above_the_band_is_felt_as_little_as_the_filter_lets_through(hz: float) -> None:
    """Whatever its phase where the trial ends: an extension must not make a step of it."""
    rate, amplitude = 20_000, 0.05 * math.sqrt(2.0)
    time = np.arange(rate) / rate
    w = butter(2, [30.0, 500.0], "bandpass", fs=rate, output="sos")
    gain = abs(sosfreqz_at(w, hz, rate)) ** 2
    for phase in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        velocity = amplitude * np.sin(2.0 * np.pi * hz * time + phase)
        calm = np.zeros(rate)
        numbers = meter(replace(LIMITS, felt_velocity=1e9), 1.0 / rate, 0.0).true(
            calm, velocity, calm, calm + 1e-3, np.zeros(rate, np.int64)
        )
        assert numbers["felt"] == pytest.approx(0.05 * gain, rel=0.25, abs=0.005 * amplitude)


def sosfreqz_at(sections: Any, hz: Any, rate: Any) -> Any:
    z = np.exp(2j * np.pi * hz / rate)
    return np.prod([np.polyval(s[:3], z) / np.polyval(s[3:], z) for s in sections])
