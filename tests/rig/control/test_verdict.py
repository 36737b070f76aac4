"""The verdict of a hit, on signals whose measures are known in closed form."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.judging import TrialSignals, judge, measure_signals, meter, recorded_signals, true_signals
from rig.control.verdict import KINDS, Kind, Measured, Thresholds, kinds
from rig.core.present import plain
from rig.core.sample import ROW, TRUTH_COLUMNS, Phase, RowFlag

RATE = 20_000
T = 1.0 / RATE
DELTA = 1.5708e-4  # Koul et al.: 1000 lines, x4, 10:1
LIMITS = Thresholds(
    tail_s=0.4,
    highpass_hz=30.0,
    lowpass_hz=500.0,
    felt_velocity=0.05,
    heard_effort=0.10,
    moved=1.25e-3,
    growth=1.2,
    late_fraction=0.01,
    longest_gap=2,
    lost_fraction=0.003,
    saturated_fraction=0.01,
)
TIME = np.arange(RATE) * T
TAIL = TIME >= 0.6


def signals(
    position: Any,
    *,
    effort: Any = None,
    velocity: Any = None,
    resolution: float = 0.0,
    penetration: Any = None,
    **flags: Any,
) -> TrialSignals:
    """Return a trial of 1 s against a wall at zero, calm by default."""
    position = np.asarray(position, dtype=float)
    nothing = np.zeros(len(position), bool)
    quiet = dict.fromkeys(("saturated", "late", "slew_bound", "overruled"), nothing)
    quiet["lost"] = quiet["currents"] = np.zeros(len(position), np.int64)
    return TrialSignals(
        tick_s=T,
        resolution=resolution,
        position=position,
        velocity=velocity,
        effort=np.zeros(len(position)) if effort is None else np.asarray(effort, dtype=float),
        penetration=position if penetration is None else penetration,
        **{**quiet, **flags},
    )


def measured(position: Any, **options: Any) -> Measured:
    return measure_signals(signals(position, **options), LIMITS)


REST = np.full(RATE, 1e-3)  # a millimetre or milliradian deep, at rest


def ripple(amplitude: float, hz: float = 100.0) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * hz * TIME)


def toggling(hz: float) -> np.ndarray:
    return DELTA * (10 + (np.sin(2 * np.pi * hz * TIME + 0.3) > 0))


def test_a_handle_at_rest_in_the_wall_is_stable() -> None:
    verdict = judge(signals(REST, resolution=DELTA), LIMITS)
    assert verdict.kind is Kind.STABLE
    assert verdict.reasons == ()
    assert (verdict.felt, verdict.heard, verdict.moved, verdict.growth) == (0.0, 0.0, 0.0, 0.0)
    assert verdict.ticks == RATE


def test_a_hit_that_rings_down_before_the_tail_is_stable() -> None:
    ring = 5e-3 + 4e-3 * np.exp(-TIME / 0.05) * np.cos(2 * np.pi * 60 * TIME)
    assert judge(signals(ring, effort=300 * ring), LIMITS).kind is Kind.STABLE


def test_a_lasting_oscillation_inside_the_wall_is_a_limit_cycle() -> None:
    verdict = judge(signals(5e-3 + ripple(2e-3), effort=ripple(0.5)), LIMITS)
    assert verdict.kind is Kind.LIMIT_CYCLE
    assert verdict.settling_s is None
    assert [reason.split()[0] for reason in verdict.reasons] == ["felt", "heard", "moved"]


def test_a_growing_oscillation_is_unstable() -> None:
    grown = np.exp((TIME - 1.0) / 0.3)
    verdict = judge(signals(5e-3 + grown * ripple(2e-3), effort=grown * ripple(1.0)), LIMITS)
    assert verdict.kind is Kind.UNSTABLE
    assert verdict.growth == pytest.approx(math.exp(0.2 / 0.3), rel=0.02)
    assert verdict.reasons[0].startswith("ripple grows 1.9")


def test_a_handle_that_leaves_the_wall_in_the_tail_is_unstable() -> None:
    bouncing = 1e-3 + 2e-3 * np.sin(2 * np.pi * 5 * TIME)  # leaves in every period
    verdict = judge(signals(bouncing), LIMITS)
    assert verdict.kind is Kind.UNSTABLE
    assert verdict.exits == 5
    assert verdict.exits_in_tail == 2
    assert verdict.reasons[0] == "left the wall 2 times in the tail"


def test_leaving_the_wall_at_the_very_start_of_the_tail_counts() -> None:
    position = REST.copy()
    start = RATE - round(LIMITS.tail_s * RATE)
    position[start : start + 100] = -1e-4
    assert judge(signals(position), LIMITS).exits_in_tail == 1
    position[start - 1] = -1e-4
    assert judge(signals(position), LIMITS).exits_in_tail == 0  # it left before, and came back in the tail


PERSON = replace(LIMITS, may_leave=True)


def withdrawn_handle(at: float, speed: float = 3.0, depth: float = 1e-3) -> np.ndarray:
    """Return positions that rest in the wall, leave it from time `at` on, and stay 30 mrad away."""
    return np.maximum(depth - speed * np.maximum(TIME - at, 0.0), -0.03)


@pytest.mark.parametrize("at", [0.25, 0.45, 0.56, 0.82, 0.9, 0.97])
@pytest.mark.parametrize(("speed", "stiffness"), [(0.3, 200.0), (3.0, 200.0), (10.0, 800.0)])
def test_person_who_leaves_a_calm_wall_gives_no_verdict(at: float, speed: float, stiffness: float) -> None:
    """A motor does not let go: in its trials a handle that leaves in the tail, from 0.6 s on, shows instability."""
    position = withdrawn_handle(at, speed)
    s = signals(position, effort=-stiffness * np.maximum(position, 0.0), resolution=DELTA)
    verdict = judge(s, PERSON)
    assert verdict.kind is Kind.INVALID
    assert "left the calm wall" in " ".join(verdict.reasons)
    assert measure_signals(s, PERSON).passes("any") is False, "no map may count such a wall as stable"
    assert judge(s, LIMITS).kind is (Kind.UNSTABLE if at > 0.6 else Kind.INVALID)


@pytest.mark.parametrize(
    "position",
    [
        1e-3 + ripple(2e-3, 12.0),  # in and out, slowly
        np.where((TIME > 0.9) & (TIME < 0.902), -1e-4, 1e-3),  # out and in again
        np.where(
            (TIME > 0.9) & (TIME < 0.92), 1e-3, np.where(TIME < 0.5, 1e-3, -1e-2)
        ),  # a bounce in the tail
        withdrawn_handle(0.85) + np.where(TIME < 0.85, ripple(0.9e-3, 60.0), 0.0),  # it shook before
    ],
)
def test_a_wall_that_bounces_or_shakes_a_person_out_stays_unstable(position: Any) -> None:
    assert judge(signals(position), PERSON).kind is Kind.UNSTABLE


def test_wall_that_buzzed_until_a_person_left_stays_unstable() -> None:
    position = withdrawn_handle(0.85)
    effort = np.where(position > 0.0, -0.3 + ripple(0.2, 150.0), 0.0)
    assert judge(signals(position, effort=effort), PERSON).kind is Kind.UNSTABLE


def test_person_who_left_in_the_first_tick_of_the_tail_gives_no_verdict() -> None:
    s = signals(np.where(TAIL, -0.02, 1e-3), resolution=DELTA)
    verdict = judge(s, PERSON)
    assert (verdict.kind, verdict.exits_in_tail) == (Kind.INVALID, 1)
    assert "left the calm wall" in " ".join(verdict.reasons)


@pytest.mark.parametrize(
    "position",
    [
        np.where(TIME < 0.02, 1e-3, -0.02),  # a bounce
        withdrawn_handle(0.5) + np.where(TIME < 0.5, ripple(0.9e-3, 60.0), 0.0),  # it shook
        np.where(TIME < 0.5, 1e-3 + ripple(2e-3, 12.0), -0.02),  # in and out, and away
    ],
)
def test_a_hand_that_was_thrown_out_and_stays_away_was_at_an_unstable_wall(position: Any) -> None:
    """If such trials were invalid and repeated, unstable walls would be missing from the results."""
    verdict = judge(signals(position), PERSON)
    assert verdict.kind is Kind.UNSTABLE
    assert "threw the hand out" in " ".join(verdict.reasons)
    assert judge(signals(position), LIMITS).kind is Kind.INVALID


def test_a_wall_that_was_never_touched_says_nothing() -> None:
    verdict = judge(signals(REST - 2e-3), LIMITS)
    assert verdict.kind is Kind.INVALID
    assert verdict.reasons == ("the wall was never touched",)
    assert verdict.contact_s is None
    assert verdict.impact_velocity is None
    assert verdict.settling_s is None


@pytest.mark.parametrize("first", [0.0, 1.0, -1.0])
def test_a_reach_with_one_dead_channel_is_named(first: float) -> None:
    """With a dead channel the count only toggles; a trembling hand on an edge does so some twenty times a second."""
    count = np.arange(len(TIME)) // 2 % 2 + first
    verdict = judge(signals(REST - 2e-3 + DELTA * count, resolution=DELTA), LIMITS)
    assert verdict.kind is Kind.INVALID
    (reason,) = verdict.reasons
    assert f"the count changed {(len(TIME) - 1) // 2} times between two neighbours" in reason
    assert "one channel of the encoder is dead" in reason
    trembles = np.floor(0.7 + np.sin(2 * np.pi * 10.0 * TIME))
    calm = judge(signals(REST - 2e-3 + DELTA * trembles, resolution=DELTA), LIMITS)
    assert calm.reasons == ("the wall was never touched",)


def lost(gaps: dict[int, int]) -> np.ndarray:
    made = np.zeros(RATE, np.int64)
    made[list(gaps)] = list(gaps.values())
    return made


HIT = np.where(TIME < 0.2, -1e-3, 1e-3)  # touches at sample 4000


@pytest.mark.parametrize("place", [4000, 6000, -1], ids=["contact", "settling", "last"])
def test_a_gap_from_the_contact_on_spoils_a_trial_when_it_is_too_long(place: int) -> None:
    assert judge(signals(HIT, lost=lost({place: 2})), LIMITS).kind is Kind.STABLE
    verdict = judge(signals(HIT, lost=lost({place: 3})), LIMITS)
    assert verdict.kind is Kind.INVALID
    assert (verdict.gaps, verdict.lost_samples) == (1, 3)
    (reason,) = verdict.reasons
    assert "from contact on" in reason
    assert "3 in a row (limit 2)" in reason


def test_samples_lost_in_free_space_are_only_counted() -> None:
    verdict = judge(signals(HIT, lost=lost({10: 500, 3999: 30}), late=TIME < 0.19), LIMITS)
    assert verdict.kind is Kind.STABLE
    assert (verdict.gaps, verdict.lost_samples, verdict.late_ticks) == (2, 530, 3800)
    assert verdict.longest_gap == verdict.lost_fraction == verdict.late_fraction == 0.0


def test_saturation_at_impact_is_reported_and_forgiven() -> None:
    impact = (TIME > 0.05) & (TIME < 0.06)
    verdict = judge(signals(REST, saturated=impact), LIMITS)
    assert verdict.kind is Kind.STABLE
    assert verdict.saturated_fraction == pytest.approx(0.01, abs=1e-4)
    assert verdict.saturated_fraction_in_tail == 0.0


@pytest.mark.parametrize("count", [0, 1, 7])
def test_a_trial_without_samples_is_invalid_and_still_a_verdict(count: int) -> None:
    verdict = judge(signals(REST[:count]), LIMITS)
    assert verdict.kind is Kind.INVALID
    assert verdict.ticks == count
    assert verdict.reasons == (f"only {count} ticks in the trial",)
    json.dumps(plain(verdict), allow_nan=False)


@given(count=st.integers(8, 300), seed=st.integers(0, 2**32 - 1))
def test_any_short_trial_gets_a_verdict_in_finite_numbers(count: int, seed: int) -> None:
    noise = np.random.default_rng(seed).normal(size=count)
    verdict = judge(signals(noise, effort=noise, resolution=DELTA), LIMITS)
    json.dumps(plain(verdict), allow_nan=False)


def test_moved_is_less_one_count() -> None:
    smooth = judge(signals(5e-3 + ripple(5e-4, 300.0)), LIMITS).moved
    with_counts = judge(signals(5e-3 + ripple(5e-4, 300.0), resolution=DELTA), LIMITS).moved
    assert with_counts == pytest.approx(smooth - DELTA)


def test_a_slow_press_is_neither_felt_nor_heard_nor_moved() -> None:
    """A press that varies by a fifth at 2 Hz must not leak through the two poles at 30 Hz."""
    press = 1.3e-3 * (1 + 0.2 * np.sin(2 * np.pi * 2 * TIME))
    verdict = judge(signals(press, effort=300 * press), LIMITS)
    assert verdict.kind is Kind.STABLE
    assert verdict.moved < 0.02 * np.ptp(press)
    assert verdict.heard < 0.01 * LIMITS.heard_effort


def test_one_toggling_count_is_never_called_a_limit_cycle() -> None:
    for hz in (10, 20, 31, 40, 51, 60, 70, 80, 90, 100, 112, 120, 200, 400, 700, 1500):
        assert judge(signals(toggling(hz), resolution=DELTA), LIMITS).kind is Kind.STABLE, hz


def test_a_vote_that_is_not_measurable_does_not_silence_the_others() -> None:
    buzz = 5e-3 + ripple(2e-3, 150.0)
    counts = np.floor(buzz / DELTA + 0.5) * DELTA
    verdict = judge(signals(counts, resolution=DELTA), LIMITS)
    assert verdict.felt is None
    assert verdict.kind is Kind.LIMIT_CYCLE
    assert judge(signals(buzz), LIMITS).felt > 20 * LIMITS.felt_velocity  # the truth has no floor


PUSH, INERTIA, STIFFNESS, DAMPING, START = 0.15, 2.48e-3, 300.0, 0.12, -0.015


def hit() -> tuple[np.ndarray, np.ndarray, float]:
    """Return exact position, velocity and contact time of a rigid link pushed from rest into a wall."""
    fall = PUSH / INERTIA
    contact = math.sqrt(-2 * START / fall)
    speed = fall * contact
    omega = math.sqrt(STIFFNESS / INERTIA)
    zeta = DAMPING / (2 * math.sqrt(STIFFNESS * INERTIA))
    damped = omega * math.sqrt(1 - zeta**2)
    rest = PUSH / STIFFNESS
    t = TIME - contact
    # x = rest + e^(-ζωt)(A cos + B sin) with x(0) = 0 and v(0) = speed
    a, b = -rest, (speed - zeta * omega * rest) / damped
    decay = np.exp(-zeta * omega * np.maximum(t, 0))
    inside = rest + decay * (a * np.cos(damped * t) + b * np.sin(damped * t))
    inside_v = decay * (
        (b * damped - zeta * omega * a) * np.cos(damped * t)
        - (a * damped + zeta * omega * b) * np.sin(damped * t)
    )
    position = np.where(t < 0, START + 0.5 * fall * TIME**2, inside)
    return position, np.where(t < 0, fall * TIME, inside_v), contact


def test_the_measures_of_a_hit_are_those_of_the_closed_form() -> None:
    position, velocity, contact = hit()
    verdict = judge(signals(position, velocity=velocity, effort=PUSH - STIFFNESS * position), LIMITS)
    assert verdict.contact_s == pytest.approx(contact, abs=1.01 * T)
    assert verdict.impact_velocity == pytest.approx(math.sqrt(2 * PUSH / INERTIA * -START), rel=2e-3)
    assert verdict.peak_penetration == pytest.approx(position.max(), rel=1e-12)
    assert verdict.resting_penetration == pytest.approx(PUSH / STIFFNESS, rel=1e-6)
    off = np.abs(position - PUSH / STIFFNESS) > 0.05 * position.max()
    expected = TIME[np.flatnonzero(off & (contact < TIME))[-1]] - contact
    assert verdict.settling_s == pytest.approx(expected, abs=3 * T)
    assert 0.05 < verdict.settling_s < 0.3
    flags = np.zeros(RATE, np.int64)
    sweep = meter(LIMITS, T, 0.0).true(position, velocity, PUSH - STIFFNESS * position, position, flags)
    shown = {name: value for name, value in plain(verdict).items() if name not in ("kind", "reasons")}
    assert shown == {name: sweep[name].item() for name in shown}, "as a sweep measures it"


@pytest.mark.parametrize("offset", [0.1, 0.4, 0.7, 0.95])
@pytest.mark.parametrize("decimation", [1, 10, 20])
def test_impact_velocity_is_that_of_the_accelerating_handle(offset: float, decimation: int) -> None:
    """A mean over the last milliseconds would lag by half its length, 13 % here."""
    position, _, _ = hit()
    counts = np.floor(position[::decimation] / DELTA + offset) * DELTA
    s = signals(counts, resolution=DELTA)
    verdict = judge(replace(s, tick_s=T * decimation), LIMITS)
    assert verdict.impact_velocity == pytest.approx(math.sqrt(2 * PUSH / INERTIA * -START), rel=0.05)


def test_a_trial_that_begins_in_the_wall_has_no_impact_velocity_from_counts() -> None:
    assert judge(signals(REST, resolution=DELTA), LIMITS).impact_velocity is None


def test_settling_is_never_finer_than_two_counts() -> None:
    """5 % of a peak of 11 counts is half a count, which a toggling encoder would never satisfy."""
    short_pulses = DELTA * (10 + (np.sin(2 * np.pi * 20 * TIME) > 0.5))
    assert judge(signals(short_pulses, resolution=DELTA), LIMITS).settling_s == 0.0
    assert judge(signals(short_pulses), LIMITS).settling_s is None


def rows(truth: bool = False) -> np.ndarray:
    extra = [(column.name, column.dtype) for column in TRUTH_COLUMNS] if truth else []
    made = np.zeros(5, dtype=[*ROW.descr, *extra] if truth else ROW)
    made["phase"] = [Phase.SETTLE, Phase.TRIAL, Phase.TRIAL, Phase.TRIAL, Phase.RELEASE]
    made["position"] = made["penetration"] = [9, 1, 2, 3, 9]
    made["effort_sent"] = [9, 4, 5, 6, 9]
    made["elapsed_ticks"] = [1, 1, 1, 3, 4]
    made["flags"] = [
        0,
        RowFlag.SATURATED | RowFlag.INSIDE,
        RowFlag.LATE,
        RowFlag.GAP | RowFlag.SLEW_BOUND,
        RowFlag.GAP,
    ]
    return made


def test_only_the_trial_itself_is_judged_and_from_what_a_rig_records() -> None:
    s = recorded_signals(rows(), T, -DELTA)
    assert s.resolution == DELTA
    assert s.velocity is None
    assert s.position.tolist() == s.penetration.tolist() == [1, 2, 3]
    assert s.effort.tolist() == [4, 5, 6]
    assert s.saturated.tolist() == [True, False, False]
    assert s.late.tolist() == [False, True, False]
    assert s.slew_bound.tolist() == [False, False, True]
    assert s.lost.tolist() == [0, 0, 2 + 3], "with those lost between the trial and its release"


def test_the_truth_is_that_of_the_handle_and_its_penetration_that_of_the_side_that_the_law_sees() -> None:
    made = rows(truth=True)
    made["position_true"] = [9, 0.5, 0.6, 0.7, 9]
    made["handle_position_true"] = [9, 0.4, 0.5, 0.6, 9]
    made["handle_velocity_true"] = [9, 1, 2, 3, 9]
    made["effort_true"] = [9, 7, 8, 9, 9]
    s = true_signals(made, recorded_signals(made, T, DELTA), wall_position=0.65, wall_side=-1.0)
    assert s.resolution == 0.0
    assert s.position.tolist() == [0.4, 0.5, 0.6]
    assert s.penetration == pytest.approx([0.15, 0.05, -0.05])
    assert s.velocity.tolist() == [1, 2, 3]
    assert s.effort.tolist() == [7, 8, 9]
    assert s.lost.tolist() == [0, 0, 5]


REST_NUMBERS = measured(REST).numbers


@pytest.mark.parametrize(
    ("changed", "kind", "passes"),
    [
        ({}, Kind.STABLE, True),
        ({"tail_begins_s": math.nan}, Kind.INVALID, None),
        ({"contact_s": math.nan, "inside_ticks_in_tail": 0}, Kind.INVALID, None),
        ({"inside_ticks_in_tail": 0}, Kind.INVALID, False),
        ({"contact_s": 0.61}, Kind.INVALID, None),
        ({"longest_gap": 3}, Kind.INVALID, None),
        ({"lost_fraction": 0.0031}, Kind.INVALID, None),
        ({"late_fraction": 0.0099}, Kind.STABLE, True),
        ({"late_fraction": 0.01}, Kind.INVALID, None),
        ({"slew_bound_ticks": 1}, Kind.INVALID, None),
        ({"overruled_ticks": 1}, Kind.INVALID, None),
        ({"current_differs": 1}, Kind.INVALID, None),
        ({"other_current_ticks": 1}, Kind.INVALID, None),
        ({"saturated_fraction_in_tail": 0.01}, Kind.STABLE, True),
        ({"saturated_fraction_in_tail": 0.01, "heard": 0.11}, Kind.LIMIT_CYCLE, False),
        ({"saturated_fraction_in_tail": 0.011}, Kind.INVALID, None),
        ({"saturated_fraction_in_tail": 0.011, "moved": 1.3e-3}, Kind.UNSTABLE, False),
        ({"settling_in_tail_s": 0.1}, Kind.STABLE, True),
        ({"settling_in_tail_s": 0.1, "exits_in_tail": 1}, Kind.INVALID, False),
        ({"settling_in_tail_s": 0.1, "heard": 0.11}, Kind.INVALID, False),
        ({"exits_in_tail": 1}, Kind.UNSTABLE, False),
        ({"growth": 1.21}, Kind.STABLE, True),
        ({"growth": 1.21, "heard": 0.11}, Kind.UNSTABLE, False),
        ({"felt": 0.051}, Kind.LIMIT_CYCLE, False),
        ({"heard": 0.11}, Kind.LIMIT_CYCLE, False),
        ({"moved": 1.3e-3}, Kind.LIMIT_CYCLE, False),
    ],
)
def test_numbers_decide_kind_and_pass(changed: dict[str, float], kind: Kind, passes: bool | None) -> None:
    numbers = REST_NUMBERS.copy()
    for name, value in changed.items():
        numbers[name] = value
    trial = Measured(numbers, LIMITS)
    assert (trial.kind, trial.passes("any")) == (kind, passes)
    assert bool(trial.verdict.reasons) == (kind is not Kind.STABLE)
    assert [KINDS[code] for code in kinds(np.array([numbers, REST_NUMBERS]), LIMITS)] == [kind, Kind.STABLE]
    spoilt = numbers.copy()
    spoilt["longest_gap"] = 3
    assert Measured(spoilt, LIMITS).kind is Kind.INVALID
    assert Measured(spoilt, LIMITS).passes("any") is None


def test_a_wall_that_still_rings_when_the_trial_ends_fails_though_its_verdict_wants_a_longer_trial() -> None:
    ring = 5e-3 + 4e-3 * np.exp(-TIME / 0.32) * np.cos(2 * np.pi * 60 * TIME)
    ringing = measured(ring, effort=900 * ring)
    assert ringing.kind is Kind.INVALID
    assert ringing.passes("heard") is False


def test_a_buzz_that_is_heard_and_not_felt_fails_the_criteria_that_ask_for_it() -> None:
    buzz = measured(REST, effort=ripple(0.5))
    assert [buzz.passes(criterion) for criterion in ("felt", "heard", "any")] == [True, False, False]


def test_a_push_that_a_guard_ended_is_unstable_after_contact_and_says_nothing_without() -> None:
    thrown, lost = (replace(measured(position), thrown_out=True) for position in (REST, REST - 2e-3))
    assert (thrown.kind, lost.kind) == (Kind.UNSTABLE, Kind.INVALID)
    assert [side.passes("any") for side in (thrown, lost)] == [False, None]
    thrown.numbers["current_differs"] = 1
    broken = Measured(thrown.numbers, LIMITS, thrown_out=True)  # whatever a motor did that does not obey
    assert (broken.kind, broken.passes("any")) == (Kind.INVALID, None)


def test_only_gaps_and_late_ticks_by_themselves_are_the_machines_fault() -> None:
    calm, gone = measured(REST).numbers, measured(np.where(TIME < 0.2, 1e-3, -1e-3)).numbers
    lost, late, both, elsewhere = (numbers.copy() for numbers in (calm, calm, gone, calm))
    lost["longest_gap"] = both["longest_gap"] = 3
    late["late_fraction"], elsewhere["slew_bound_ticks"] = 0.02, 1
    found = [Measured(numbers, LIMITS) for numbers in (lost, late, both, elsewhere, calm)]
    assert [one.by_machine for one in found] == [True, True, False, False, False]
    assert not Measured(lost, LIMITS, thrown_out=True).by_machine
    lost["overruled_ticks"], elsewhere["overruled_ticks"], elsewhere["slew_bound_ticks"] = 1, 1, 0
    late["overruled_ticks"] = 1
    assert Measured(lost, LIMITS).by_machine  # a command that does not come is replaced by the device
    assert Measured(late, LIMITS).by_machine  # so is one that comes after its time
    assert not Measured(elsewhere, LIMITS).by_machine
