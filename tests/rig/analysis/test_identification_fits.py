"""Fits of an identification recover the parameters of data integrated by scipy, independent of the simulation."""

import math
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from rig.analysis.identification._dynamics import fit_dynamics
from rig.analysis.identification._interval import Interval, from_scatter
from rig.analysis.identification._quality import (
    IdentificationError,
    check_excited,
    check_explained,
    find_band,
)
from rig.analysis.identification._signs import check_signs, stiction_warning
from rig.analysis.identification._sliding import Sliding, Stroke, fit_sliding
from rig.analysis.impedance._signals import ExcitedRun
from rig.control.excitation import Multisine
from rig.core.present import plain
from tests.conformance.tiers import first_by_default

MASS, DAMPING, UP, DOWN = 0.5, 8.0, 0.3, 0.2  # kg, N·s/m, N
RATE = 1000.0
QUANTUM = 1e-6
SLIP = 2e-4  # m/s in which friction turns round: a regularised law, unlike that of the simulated plant


def friction(v: Any) -> Any:
    at_rest = SLIP * math.atanh((DOWN - UP) / (UP + DOWN))
    return 0.5 * (UP - DOWN) + 0.5 * (UP + DOWN) * np.tanh((v - at_rest) / SLIP)


def integrate_linear(efforts: Any, derivative: Any, state: Any) -> Any:
    """Return the states at the samples, under efforts that are held between them; exact for a linear derivative."""
    size = len(state)
    a = np.array([derivative(one, 0.0) for one in np.eye(size)]).T
    b = np.array(derivative(np.zeros(size), 1.0))
    step = expm(np.block([[a, b[:, None]], [np.zeros((1, size + 1))]]) / RATE)
    return np.array(list(accumulate(efforts, lambda x, u: step[:size] @ [*x, u], initial=state)))[:-1]


def counted(position: Any) -> Any:
    return QUANTUM * np.floor(position / QUANTUM + 0.5)


def known_sliding(coulomb: float, damping: float) -> Any:
    exact = [Interval(value, 0.0) for value in (coulomb, coulomb, damping, coulomb, 0.0)]
    return Sliding(*exact, np.zeros(1), np.zeros(1), 0.0)


def test_an_interval_from_scatter_is_students() -> None:
    samples = [1.0, 2.0, 3.0, 4.0]
    found = from_scatter(2.5, samples)
    assert found.ci95 == pytest.approx(3.182446 * np.std(samples, ddof=1) / 2.0, rel=1e-6)
    assert found.holds(2.5)
    assert not found.holds(10.0)
    assert from_scatter(1.0, [1.0]).ci95 == math.inf
    assert Interval(3.2042e-4, 3.5e-7).text("kg") == "(3.2042 ± 0.0035)e-04 kg"
    assert plain(from_scatter(1.0, [1.0])) == {"value": 1.0, "ci95": None}


def push_handle(
    sign: float = 1.0, mass: Any = MASS, growth: float = 2.0, gap: bool = False, damping: float = 0.0
) -> Any:
    """Return two pushes each way of a handle with friction, to 30 counts; `gap`: a tenth of the mass at a reversal."""
    time_s, effort, position = [], [], []
    t, x, v, before = 0.0, 0.0, 0.0, 1.0
    for direction in (1.0, 1.0, -1.0, -1.0, 1.0, 1.0):
        moved, start, u = 0.0, x, 0.0
        m = mass * (0.1 if gap and direction != before else 1.0)
        before = direction
        while abs(moved) < 30 * QUANTUM:
            u += growth / RATE
            time_s.append(t), effort.append(direction * u), position.append(sign * x)
            net = u - (UP if direction > 0 else DOWN) - damping * abs(v)
            if net > 0.0 or v != 0.0:
                v += direction * net / m / RATE
            x += v / RATE
            t += 1.0 / RATE
            moved = x - start
        v = 0.0
        for _ in range(100):
            time_s.append(t), effort.append(0.0), position.append(sign * x)
            t += 1.0 / RATE
    return np.array(time_s), np.array(effort), counted(np.array(position))


def signs_of(data: Any, expected: Any = MASS, damping: float = 0.0) -> Any:
    return check_signs(*data, resolution=QUANTUM, expected_inertia=expected, rest_s=0.05, damping=damping)


def test_pushes_show_sign_breakaway_and_scale() -> None:
    found = signs_of(push_handle())
    assert (found.sign, found.ok, found.warnings, len(found.pushes)) == (1, True, (), 6)
    assert found.scale == pytest.approx(1.0, rel=0.3)
    assert found.breakaway_up == pytest.approx(UP, rel=0.2), "two counts later than the very first motion"
    assert found.breakaway_down == pytest.approx(DOWN, rel=0.2)
    assert [push.after_reversal for push in found.pushes] == [False, False, True, False, True, False]


def test_damping_that_is_described_is_no_inertia() -> None:
    """A push lasts some 30 ms, the time constant of this damping 5 ms, as with back-EMF."""
    braked = push_handle(damping=200.0 * MASS)
    assert "times the described inertia" in signs_of(braked).warnings[0]
    assert signs_of(braked, damping=200.0 * MASS).ok


def test_an_encoder_that_counts_the_other_way_is_found() -> None:
    found = signs_of(push_handle(sign=-1.0))
    assert found.sign == -1
    assert not found.ok
    assert "connected in reverse" in found.warnings[0]


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_a_wrong_scale_is_found(factor: float) -> None:
    found = signs_of(push_handle(), expected=factor * MASS)
    assert found.sign == 1
    assert not found.ok
    assert "times the described inertia" in found.warnings[0]


def test_backlash_shows_as_a_light_handle_after_each_reversal() -> None:
    assert any("backlash" in warning for warning in signs_of(push_handle(gap=True)).warnings)


def test_handle_that_does_not_move_has_no_sign() -> None:
    time_s = np.arange(1000) / RATE
    effort = np.where(time_s % 0.5 < 0.3, time_s % 0.5, 0.0)
    found = signs_of((time_s, effort, np.zeros(1000)))
    assert found.sign == 0
    assert math.isnan(found.inertia)
    assert "the handle did not move with efforts of up to 0.299" in found.warnings[0]
    silent = signs_of((time_s, np.zeros(1000), np.zeros(1000)))
    assert silent.pushes == ()
    assert not silent.ok


def test_stiction_is_breakaway_well_above_sliding() -> None:
    assert stiction_warning(0.3, 0.25) is None
    assert "0.6" in stiction_warning(0.6, 0.3)
    assert stiction_warning(math.nan, 0.3) is None


@pytest.fixture(scope="module")
def servo_strokes() -> Any:
    """Return strokes by a servo, integrated by scipy, with effort and position as a rig records them."""
    strokes, time_s, setpoint = [], 0.0, []
    for length in (0.3, 0.6):
        for way in (0.015, -0.015):
            strokes.append(Stroke(time_s, time_s + length, way / length))
            start = -0.5 * way
            ticks = length * RATE
            setpoint += [(start + way * k / ticks, way / length) for k in range(round(ticks))]
            time_s += length
    state, states, efforts = np.array([-0.0075, 0.0]), [], []
    for target, speed in setpoint:
        effort = 2000.0 * (target - counted(state[0])) + 60.0 * (speed - state[1])
        states.append(state)
        efforts.append(effort)
        end = solve_ivp(
            lambda t, y, u=effort: (y[1], (u - DAMPING * y[1] - friction(y[1])) / MASS),
            (0.0, 1.0 / RATE), state, rtol=1e-6, atol=1e-10,
        )  # fmt: skip
        state = end.y[:, -1]
    return np.arange(len(efforts)) / RATE, np.array(efforts), counted(np.array(states)[:, 0]), strokes


def test_sliding_recovers_friction_each_way_and_damping(servo_strokes: Any) -> None:
    found = fit_sliding(*servo_strokes, resolution=QUANTUM)
    assert found.up.value == pytest.approx(UP, rel=0.02)
    assert found.down.value == pytest.approx(DOWN, rel=0.02)
    assert found.damping.value == pytest.approx(DAMPING, rel=0.03)
    assert found.coulomb.value == pytest.approx(0.5 * (UP + DOWN), rel=0.02)
    assert found.bias.value == pytest.approx(0.5 * (UP - DOWN), abs=0.005)
    for interval, true in ((found.up, UP), (found.down, DOWN), (found.damping, DAMPING)):
        assert 0.0 < interval.ci95 < 0.1 * true
    assert found.at(np.array([0.05]))[0] == pytest.approx(UP + 0.05 * DAMPING, rel=0.03)


def test_back_emf_that_is_given_is_no_friction(servo_strokes: Any) -> None:
    """The command is larger by b_e·v, while the same effort acts."""
    time_s, effort, position, strokes = servo_strokes
    command = effort + 20.0 * np.gradient(position, 1.0 / RATE)
    found = fit_sliding(time_s, command, position, strokes, resolution=QUANTUM, back_emf=20.0)
    plain_fit = fit_sliding(*servo_strokes, resolution=QUANTUM)
    assert found.damping.value == pytest.approx(plain_fit.damping.value, abs=0.05)
    assert found.coulomb.value == pytest.approx(plain_fit.coulomb.value, rel=0.005)


def test_only_samples_at_the_asked_speed_are_used() -> None:
    """While a soft servo accelerates, its effort contains inertia, which would bias the friction line."""
    position, effort, strokes, time_s, at, speed = [], [], [], 0.0, 0.0, 0.0
    for length in (0.4, 0.8, 1.6):
        for asked in (0.04 / length, -0.04 / length):
            strokes.append(Stroke(time_s, time_s + length, asked))
            for _ in range(round(length * RATE)):
                rises = (asked - speed) / 0.12
                speed += rises / RATE
                at += speed / RATE
                position.append(at)
                effort.append((UP if speed > 0.0 else -DOWN) + DAMPING * speed + 2.0 * MASS * rises)
            time_s += length
    times = np.arange(len(effort)) / RATE
    found = fit_sliding(times, np.array(effort), np.array(position), strokes, resolution=QUANTUM)
    assert found.damping.value == pytest.approx(DAMPING, rel=0.03)
    assert found.coulomb.value == pytest.approx(0.5 * (UP + DOWN), rel=0.03)
    assert found.points < 18


def test_interval_of_the_bias_contains_it_beside_cogging() -> None:
    """A bug took the pieces of a stroke for independent: it held in 164, although all strokes pass the same cogging."""
    strokes, time_s, random, held = [], 0.0, np.random.default_rng(0), 0
    for length in (0.4, 0.4, 0.8, 0.8, 1.6, 1.6):
        way = 0.04 * (-1.0) ** len(strokes)
        strokes.append(Stroke(time_s, time_s + length, way / length))
        time_s += length
    velocity = np.concatenate([np.full(round(RATE * (s.end_s - s.begin_s)), s.velocity) for s in strokes])
    position, times = np.cumsum(velocity) / RATE, np.arange(len(velocity)) / RATE
    for wave, phase in zip(random.uniform(0.012, 0.06, 200), random.uniform(0.0, 6.28, 200), strict=True):
        cogging = 0.1 * UP * np.cos(2.0 * np.pi * position / wave + phase)
        effort = UP * np.sign(velocity) + DAMPING * velocity + cogging
        held += fit_sliding(times, effort, position, strokes, resolution=QUANTUM).bias.holds(0.0)
    assert 185 <= held < 200


def test_handle_that_did_not_slide_is_refused(servo_strokes: Any) -> None:
    time_s, effort, position, strokes = servo_strokes
    with pytest.raises(IdentificationError, match="0 in the positive direction, 0 in the negative"):
        fit_sliding(time_s, effort, np.zeros_like(position), strokes, resolution=QUANTUM)
    with pytest.raises(IdentificationError, match="0 in the negative"):
        fit_sliding(time_s, effort, position, strokes[::2], resolution=QUANTUM)
    noise = np.random.default_rng(0).normal(0.0, 50.0, len(effort))
    with pytest.raises(IdentificationError, match="scatters"):
        fit_sliding(time_s, effort + noise, position, strokes, resolution=QUANTUM)


def multisine(realisation: Any, top: float = 150.0) -> Any:
    lines = np.unique(np.rint(np.geomspace(4.0, top, 36) * 0.5)) / 0.5
    phases = np.random.default_rng(realisation).uniform(-np.pi, np.pi, len(lines))
    return Multisine(0.5, lines, 2.0 * np.minimum(lines / 25.0, 1.0), phases)


def record(derivative: Any, state: Any, realisation: Any, *, settle: int = 2) -> Any:
    """Return one realisation without its settling periods."""
    played = multisine(realisation)
    n = round(RATE * played.period_s)
    sent = np.tile(played.period(RATE), settle + 1)
    position = integrate_linear(sent, derivative, state)[settle * n :, 0]
    position = counted(position - position.mean())
    kept = sent[settle * n :]
    return ExcitedRun(RATE, n, 1, kept, kept, position, played.lines_hz, effort_hold_s=1.0 / RATE)


@pytest.fixture(scope="module")
def damped() -> Any:
    def derivative(y: Any, u: Any) -> Any:
        return (y[1], (u - DAMPING * y[1]) / MASS)

    return [record(derivative, (0.0, 0.0), realisation) for realisation in range(3)]


def random_rig(seed: int) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    mass = random.uniform(0.3, 0.8)
    return {
        "mass": mass, "damping": mass / random.uniform(0.05, 1.0), "coulomb": random.uniform(0.05, 0.4),
        "lag": random.uniform(2e-4, 2e-3), "late": int(random.integers(0, 9)), "step": random.choice([1e-3, 0.05]),
        "count": random.choice([2e-7, 1e-6, 5e-6]),
    }  # fmt: skip


def stuck_records(rigs: list[dict[str, Any]], realisations: int, steps: int = 20) -> list[list[Any]]:
    """Return records of rigs with Coulomb friction and stepwise effort, integrated together in small steps."""
    keys = ("mass", "damping", "coulomb", "lag")
    mass, damping, coulomb, lag = (np.array([[one[key]] for one in rigs]) for key in keys)
    played = [multisine(realisation) for realisation in range(realisations)]
    n, dt = round(RATE * played[0].period_s), 1.0 / RATE / steps
    decay = np.exp(-dt / lag)
    asked = np.array([one.period(RATE) for one in played])
    sent = np.array([one["step"] * np.rint(asked / one["step"]) for one in rigs])
    acting = np.array([np.roll(effort, one["late"], axis=-1) for effort, one in zip(sent, rigs, strict=True)])
    effort = velocity = position = np.zeros(sent.shape[:2])
    seen = []
    for tick in range(4 * n):
        seen.append(position)
        for _ in range(steps):
            before, missing = velocity, (effort - acting[..., tick % n]) * decay
            mean = 0.5 * (effort + acting[..., tick % n] + missing)
            effort = acting[..., tick % n] + missing
            free = velocity + dt / mass * (mean - damping * velocity)
            velocity = free - np.clip(free, -dt / mass * coulomb, dt / mass * coulomb)
            position = position + 0.5 * dt * (before + velocity)
    positions = np.moveaxis(np.array(seen[-2 * n :]), 0, -1)
    sent = np.tile(sent, 2)

    def run(i: int, j: int) -> ExcitedRun:
        count, effort = rigs[i]["count"], sent[i, j]
        counts = count * np.rint(positions[i, j] / count)
        return ExcitedRun(RATE, n, 2, effort, effort, counts, played[j].lines_hz, effort_hold_s=1.0 / RATE)

    return [[run(i, j) for j in range(realisations)] for i in range(len(rigs))]


@pytest.mark.parametrize(
    ("seeds", "realisations", "steps", "widest"),
    first_by_default([(range(2, 3), 3, 10, 0.001), (range(6), 4, 20, 0.002)]),
)
def test_the_intervals_of_random_rigs_hold_inertia_delay_and_lag(
    seeds: range, realisations: int, steps: int, widest: float
) -> None:
    """More in `tests.benchmarks.identified_intervals`."""
    rigs = [random_rig(seed) for seed in seeds]
    held, widths = np.zeros(3), []
    for one, runs in zip(rigs, stuck_records(rigs, realisations, steps), strict=True):
        sliding = known_sliding(one["coulomb"], one["damping"])
        known = {"sliding": sliding, "damping": sliding.damping}
        found = fit_dynamics(runs, resolution=one["count"], inertia=0.5, **known)
        assert found.delay_ticks == one["late"]
        true = np.array([one["mass"], one["late"] / RATE + one["lag"], one["lag"]])
        intervals = (found.inertia, found.delay_s, found.lag_s)
        off = np.abs([interval.value for interval in intervals] - true)
        # The steps of these records are good to 0.6 µs of delay.
        held += off <= [
            interval.ci95 + slack for interval, slack in zip(intervals, (0.0, 1e-6, 1e-6), strict=True)
        ]
        widths.append(found.inertia.ci95 / one["mass"])
    assert held.min() >= 0.9 * len(rigs), held
    assert np.median(widths) < widest


def test_a_known_damping_is_kept(damped: Any) -> None:
    damping = Interval(DAMPING, 0.1)
    found = fit_dynamics(damped, resolution=QUANTUM, inertia=MASS, damping=damping)
    assert found.damping == damping
    assert found.inertia.value == pytest.approx(MASS, rel=0.005)


def test_lines_beyond_the_band_of_a_coarse_encoder_do_not_enter_the_fit(damped: Any) -> None:
    count = 3e-4
    coarse = [replace(run, position=count * np.rint(run.position / count)) for run in damped]
    found = fit_dynamics(coarse, resolution=count, inertia=MASS)
    assert found.lines_hz[-1] == found.band.high_hz < damped[0].lines_hz[-1]
    assert found.band.above
    assert abs(found.inertia.value - MASS) < found.inertia.ci95 < 0.01 * MASS


def test_two_masses_show_their_mode_and_how_the_inertia_splits() -> None:
    motor, link, stiffness, damper = 0.1, 0.4, 8000.0, 1.5

    def derivative(y: Any, u: Any) -> Any:
        across = stiffness * (y[2] - y[0]) + damper * (y[3] - y[1])
        return (y[1], (u + across - 1.0 * y[1]) / motor, y[3], -across / link)

    runs = [record(derivative, (0.0,) * 4, realisation, settle=6) for realisation in range(3)]
    found = fit_dynamics(runs, resolution=QUANTUM, inertia=0.3)
    mode = found.mode
    assert mode is not None
    assert found.inertia.value == pytest.approx(motor + link, rel=0.01)
    assert mode.resonance_hz.value == pytest.approx(math.sqrt(stiffness * 12.5) / (2 * np.pi), rel=0.003)
    assert mode.antiresonance_hz.value == pytest.approx(math.sqrt(stiffness / link) / (2 * np.pi), rel=0.003)
    assert mode.motor_inertia.value == pytest.approx(motor, rel=0.02)
    assert mode.link_inertia.value == pytest.approx(link, rel=0.02)
    assert mode.stiffness.value == pytest.approx(stiffness, rel=0.02)
    omega = 2.0 * np.pi * mode.resonance_hz.value
    ratio = damper / (2.0 * math.sqrt(stiffness * motor * link / (motor + link)))
    ratio += 1.0 * link / (motor + link) / (2.0 * omega * motor)  # what the motor's viscous damping adds
    assert mode.resonance_ratio.value == pytest.approx(ratio, rel=0.05)
    assert set(plain(found)["mode"]) == set(mode.__slots__)


def test_one_realisation_is_refused(damped: Any) -> None:
    with pytest.raises(IdentificationError, match="number of realisations: 1"):
        fit_dynamics(damped[:1], resolution=QUANTUM, inertia=MASS)


def test_motion_that_does_not_follow_the_excitation_is_refused(damped: Any) -> None:
    rng = np.random.default_rng(3)
    noisy = [replace(run, position=rng.normal(0.0, 1e-3, len(run.position))) for run in damped]
    with pytest.raises(IdentificationError, match="2 of 28 frequencies have a coherence of"):
        check_excited(noisy, QUANTUM)


def test_the_band_is_the_lowest_row_of_coherent_lines_and_an_octave_may_lie_in_a_notch() -> None:
    lines_hz = np.arange(100) + 1.0
    found = np.full(100, 0.95)
    found[:2] = 0.5  # friction holds the handle at the lowest lines
    found[30:40] = 0.1
    found[50] = 0.0  # one line alone says nothing
    found[80:] = 0.3
    band = find_band(lines_hz, found)
    assert (band.low_hz, band.high_hz) == (3.0, 80.0)
    assert "coherence 0.30 at 81 Hz, at least 0.8 is needed" in band.text
    found[:6], found[30:50] = 0.5, 0.1
    band = find_band(lines_hz, found)
    assert (band.low_hz, band.high_hz) == (7.0, 30.0)
    assert "below: coherence 0.50 at 6 Hz" in band.text
    assert find_band(lines_hz, np.full(100, 0.5)).lines == 0
    assert find_band(lines_hz, np.full(100, 0.9)).text == "1 to 100 Hz, 100 lines, all excited ones"


def test_a_held_handle_is_refused(damped: Any) -> None:
    held = [replace(run, position=np.zeros(len(run.position))) for run in damped]
    with pytest.raises(IdentificationError, match=r"moved 0\.0 counts"):
        check_excited(held, QUANTUM)


def test_motion_that_has_not_settled_is_refused(damped: Any) -> None:
    run = damped[0]
    twice = {name: np.tile(getattr(run, name), 2) for name in ("excitation", "effort", "position")}
    twice["position"][: run.period_samples] *= 0.5
    with pytest.raises(IdentificationError, match="from one period to the next"):
        check_excited([replace(run, periods=2, **twice)] * 2, QUANTUM)


@pytest.mark.exhaustive("::test_motion_that_does_not_follow_the_excitation_is_refused")
def test_a_motion_that_no_model_explains_is_refused(damped: Any) -> None:
    with pytest.raises(IdentificationError, match="50 % of the motion"):
        check_explained(0.5)
    bent = []
    for run in damped[:2]:
        spectrum = np.fft.rfft(run.position)
        spectrum[run.bins] *= 1.0 + 1.5 * np.sin(run.lines_hz)
        position = np.fft.irfft(spectrum, len(run.position))
        bent.append(replace(run, position=position, lines_hz=run.lines_hz[::2]))
    with pytest.raises(IdentificationError, match="unexplained"):
        fit_dynamics(bent, resolution=QUANTUM, inertia=MASS, damping=Interval(DAMPING, 0.0))
