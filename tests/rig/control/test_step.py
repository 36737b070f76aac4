"""One tick of the control law: order of its steps, two rates, phases, cuts to zero, and the motion of a handle."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import estimators, laws
from rig.control.law import Law
from rig.control.step import CONTROL, MEMORY, ControllerState, new_memory, step
from rig.core.errors import RecordingError
from rig.core.sample import Phase, RowFlag
from rig.realtime.kernel import kernel
from rig.realtime.plugs import ESTIMATOR_SIGNATURE, LAW_SIGNATURE
from tests.conformance.estimator import REQUIRED

ROOT = Path(__file__).parents[3]
DELTA = 1e-6  # 1 µm
TICK_S = 1e-3
WIDE = 1e9

# A rig that goes to its trial after two ticks: the handle is home wherever it is, nothing binds.
PLAIN = {
    "resolution": DELTA,
    "tick_s": TICK_S,
    "velocity_divider": 1,
    "wall_side": 1.0,
    "effort_limit": 100.0,
    "effort_quantum": 0.01,
    "trial_slew": WIDE,
    "homing_slew": WIDE,
    "window_minimum": -1.0,
    "window_maximum": 1.0,
    "speed_limit": WIDE,
    "home_tolerance": WIDE,
    "home_step": WIDE,
    "home_timeout_ticks": 10_000,
    "settle_ticks": 1,
    "trial_ticks": 1_000_000,
    "release_ticks": 10,
}


class Tick:
    """A controller driven by encoder counts: a call with a count returns quanta; attributes read its `memory`."""

    def __init__(
        self,
        *,
        estimator: str = "fdm",
        law: str = "spring-damper",
        wall: Any = None,
        skip_homing: bool = True,
        **changes: Any,
    ) -> None:
        self.active = 0  # current that the device reports as active (quanta)
        control = np.zeros(1, CONTROL)
        for name, value in {**PLAIN, **changes}.items():
            control[name] = value
        c = control[0]
        section = {"stiffness": 0.0, "damping": 0.0, "pull": "clamp", "damping_on": "both", **(wall or {})}
        kind = laws.get(law) if isinstance(law, str) else law
        family = estimators.get(estimator) if isinstance(estimator, str) else estimator
        period_s = c["tick_s"] * c["velocity_divider"]
        self.controller = ControllerState(
            control,
            new_memory(),
            family.prepare(REQUIRED.get(family.name, {}), float(c["resolution"]), period_s),
            kind.prepare(section),
        )
        if skip_homing:
            self.controller.memory["phase"] = Phase.TRIAL

    def __call__(self, count: int, elapsed: int = 1) -> int:
        return step(self.controller.arguments(), int(count), 0.0, elapsed, self.active)

    def __getattr__(self, name: Any) -> Any:
        if name not in MEMORY.names:
            raise AttributeError(name)
        return self.controller.memory[name].item()

    def has(self, flag: RowFlag) -> bool:
        return bool(self.flags & flag)


def law_of(function: Any) -> Law:
    return Law("test", "", function, 4, lambda _: [0.0])


def estimator_of(function: Any) -> Any:
    base = estimators.get("fdm")
    return type(base)("test", "", "", function, floats=8, ints=8)


@kernel(LAW_SIGNATURE)
def not_a_number(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    return math.nan if penetration > 0.0 else 0.0


@kernel(LAW_SIGNATURE)
def infinite(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    return -math.inf if penetration > 0.0 else 0.0


@kernel(LAW_SIGNATURE)
def spy(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    """Store the arguments in the state, after the word that marks clamping."""
    state[1] = penetration
    state[2] = velocity
    state[3] = elapsed_ticks
    return 0.0


@kernel(ESTIMATOR_SIGNATURE)
def recorder(
    count: Any, age: Any, elapsed_ticks: Any, effort: Any, state_f: Any, state_i: Any, p: Any
) -> Any:
    """Store the arguments in the state and return the number of calls."""
    state_i[0] += 1
    state_i[1] = count
    state_i[2] = elapsed_ticks
    state_f[0] = effort
    return float(state_i[0])


@kernel(ESTIMATOR_SIGNATURE)
def blind(count: Any, age: Any, elapsed_ticks: Any, effort: Any, state_f: Any, state_i: Any, p: Any) -> Any:
    return math.nan


# --- 1, 2: position and penetration -----------------------------------------------------------------------


@given(
    count=st.integers(-(10**6) + 1, 10**6 - 1),
    reference=st.integers(-(2**20), 2**20),
    side=st.sampled_from([-1.0, 1.0]),
    wall=st.floats(-0.5, 0.5, allow_subnormal=False),
)
def test_penetration_is_side_times_distance(count: int, reference: int, side: Any, wall: float) -> None:
    tick = Tick(reference_count=reference, wall_side=side, wall_position=wall)
    tick(count + reference)
    assert tick.position == count * DELTA
    assert tick.penetration == side * (count * DELTA - wall)
    assert tick.has(RowFlag.INSIDE) == (tick.penetration > 0.0)


def test_a_wall_on_the_other_side_is_the_mirror_image() -> None:
    """Entered with falling position, it pushes up, and its damping brakes inward motion too."""
    right = Tick(wall={"stiffness": 1e4, "damping": 5.0}, wall_position=1e-4)
    left = Tick(wall={"stiffness": 1e4, "damping": 5.0}, wall_position=-1e-4, wall_side=-1.0)
    backward = Tick(wall={"stiffness": 1e4, "damping": 5.0}, wall_position=1e-4, resolution=-DELTA)
    for count in (0, 90, 200, 420, 400):
        assert right(count) == backward(-count), "an encoder that counts backwards"
        left(-count)
        assert backward.velocity == right.velocity
        assert (right.penetration, right.effort_wall) == (left.penetration, left.effort_wall)
        assert right.effort_wanted == -left.effort_wanted


# --- 3: two rates -----------------------------------------------------------------------------------------


def test_the_law_receives_this_ticks_position_the_held_velocity_and_the_elapsed_ticks() -> None:
    tick = Tick(velocity_divider=4, law=law_of(spy))
    for k, elapsed in enumerate([1] * 10 + [2]):
        tick(100 * k * k, elapsed)
        assert tick.controller.law.state[1:].tolist() == [100 * k * k * DELTA, tick.velocity, elapsed]
    assert tick.velocity == pytest.approx(100 * (8**2 - 4**2) * DELTA / (4 * TICK_S), rel=1e-12)


@given(divider=st.integers(1, 12), gaps=st.lists(st.integers(1, 40), min_size=1, max_size=40))
def test_estimator_runs_once_per_new_velocity_period(divider: int, gaps: list[int]) -> None:
    tick = Tick(velocity_divider=divider, estimator=estimator_of(recorder))
    seen = tick.controller.estimator.state_i
    index, period, calls = -1, -1, 0
    for elapsed in [1, *gaps]:
        index += elapsed
        tick(index, elapsed)
        if index // divider != period:
            calls += 1
            assert seen[1] == index
            assert seen[2] == index // divider - period
        period = index // divider
        assert tick.index == index
        assert tick.has(RowFlag.VELOCITY_UPDATED) == (seen[0] == calls and seen[1] == index)
        assert seen[0] == calls


def test_estimator_receives_the_mean_effort_that_was_active_since_its_last_run() -> None:
    tick = Tick(velocity_divider=4, estimator=estimator_of(recorder))
    mean = tick.controller.estimator.state_f
    for tick.active in (0, 1, 2, 3, 6):
        tick(0)
    assert mean[0] == pytest.approx((1 + 2 + 3 + 6) / 4 * PLAIN["effort_quantum"], rel=1e-12)
    tick.active = 5
    tick(0, 6)  # over the gap the active current of its sample stands for all ticks
    assert mean[0] == pytest.approx(5 * PLAIN["effort_quantum"], rel=1e-12)


def test_the_estimator_runs_outside_the_wall_too() -> None:
    """An estimator restarted at the surface would read zero there: the first peak would change by a fifth."""
    tick = Tick(wall={"stiffness": 0.0, "damping": 10.0})
    for count in (-300, -200, -100, 0, 100):
        tick(count)
    assert tick.velocity == pytest.approx(0.1)
    assert tick.effort_wall == pytest.approx(1.0)  # damping in the very first tick inside


# --- 4, 5: law and sources --------------------------------------------------------------------------------


def test_a_wall_that_would_have_pulled_is_marked_in_the_row() -> None:
    tick = Tick(wall={"stiffness": 100.0, "damping": 50.0})
    tick(2000)
    assert not tick.has(RowFlag.CLAMPED)
    tick(1000)
    assert tick.effort_wall == 0.0
    assert tick.has(RowFlag.CLAMPED)
    tick(1000)
    assert not tick.has(RowFlag.CLAMPED)


# --- 6, 7: the guard --------------------------------------------------------------------------------------


@given(effort=st.floats(-150.0, 150.0, allow_subnormal=False), quantum=st.floats(0.01, 2.0))
def test_sent_effort_is_the_limited_sum_in_whole_quanta(effort: float, quantum: float) -> None:
    tick = Tick(constant_effort=effort, effort_quantum=quantum)
    quanta = tick(-1)
    assert tick.current_sent == quanta
    assert tick.effort_sent == quanta * quantum
    limited = max(-100.0, min(100.0, effort))
    assert abs(tick.effort_sent - limited) <= 0.5 * quantum * (1 + 1e-9)
    assert tick.has(RowFlag.SATURATED) == (abs(effort) > 100.0)
    assert tick.effort_wanted == effort


@pytest.mark.parametrize("law", [not_a_number, infinite])
def test_an_effort_or_a_velocity_that_is_not_finite_is_cut_to_zero_and_ends_the_run(law: Any) -> None:
    outside = Tick(estimator=estimator_of(blind), constant_effort=20.0)
    assert outside(-1) == 0
    assert outside.has(RowFlag.NONFINITE)
    assert outside.phase == Phase.DONE
    tick = Tick(law=law_of(law), constant_effort=20.0)
    assert tick(-1) == 2000
    assert tick(1) == 0
    assert tick.has(RowFlag.NONFINITE)
    assert tick.phase == Phase.DONE
    assert (tick.effort_sent, tick.current_sent) == (0.0, 0)
    assert not math.isfinite(tick.effort_wanted)  # the row shows what the law asked for
    assert tick(-1) == 0  # and it stays ended


@pytest.mark.parametrize("count", [1001, -501])
def test_leaving_the_window_cuts_the_effort_and_ends_the_run(count: int) -> None:
    tick = Tick(constant_effort=20.0, window_minimum=-500 * DELTA, window_maximum=1000 * DELTA)
    for inside in (1000, -500):
        assert tick(inside) == 2000
        assert tick.phase == Phase.TRIAL
    assert tick(count) == 0
    assert tick.has(RowFlag.OUT_OF_WINDOW)
    assert tick.phase == Phase.DONE


@pytest.mark.parametrize("way", [1, -1])
def test_too_much_speed_cuts_the_effort_and_ends_the_run(way: int) -> None:
    tick = Tick(constant_effort=20.0, speed_limit=1.0005)
    assert tick(0) == 2000
    assert tick(1000 * way) == 2000  # 1 m/s
    assert tick(2001 * way) == 0
    assert tick.has(RowFlag.OUT_OF_WINDOW)
    assert tick.phase == Phase.DONE


def test_a_slew_limit_that_binds_in_a_trial_is_marked_and_starts_from_the_effort_before() -> None:
    tick = Tick(constant_effort=20.0, trial_slew=8.0)
    sent = []
    for _ in range(4):
        tick(-1)
        sent.append((tick.effort_sent, tick.has(RowFlag.SLEW_BOUND)))
    assert sent == [(8.0, True), (16.0, True), (20.0, False), (20.0, False)]
    tick = Tick(constant_effort=20.0, trial_slew=8.0)
    tick(-1)
    tick(-1, 2)  # a lost tick counts
    assert (tick.effort_sent, tick.has(RowFlag.SLEW_BOUND)) == (20.0, False)


def test_rounding_does_not_pile_up_under_the_slew_limit() -> None:
    """The limit starts from the unrounded effort, so steps of 0.4 quanta a tick reach the target."""
    tick = Tick(constant_effort=1.0, trial_slew=0.4, effort_quantum=1.0)
    assert [tick(-1) for _ in range(4)] == [0, 1, 1, 1]


# --- phases -----------------------------------------------------------------------------------------------


def phases(tick: Tick, ticks: int, count: int = 0) -> list[Phase]:
    seen = []
    for _ in range(ticks):
        tick(count)
        seen.append(Phase(tick.phase))
    return seen


def test_a_run_goes_through_its_phases_tick_by_tick() -> None:
    """The handle is home already: one tick of homing, two of settling, five of trial, four of release."""
    tick = Tick(skip_homing=False, settle_ticks=3, trial_ticks=5, release_ticks=4)
    expected = [Phase.HOMING, Phase.SETTLE, Phase.SETTLE] + [Phase.TRIAL] * 5 + [Phase.RELEASE] * 4
    assert phases(tick, 14) == [*expected, Phase.DONE, Phase.DONE]


FREE = {"skip_homing": False, "settle_ticks": 1, "free_ticks": 4, "release_ticks": 2, "trial_ticks": 6}
STAY = {"free_minimum": -1.0, "free_maximum": 100 * DELTA, "wall_position": 200 * DELTA}


def test_in_free_space_nothing_pushes_and_the_trial_begins_after_it() -> None:
    tick = Tick(**FREE, **STAY, constant_effort=20.0)
    assert phases(tick, 6) == [Phase.HOMING, *[Phase.FREE] * 4, Phase.TRIAL]
    tick = Tick(**FREE, **STAY, constant_effort=20.0, wall={"stiffness": 1e3})
    sent = []
    for _ in range(6):
        tick(50)
        sent.append(tick.effort_sent)
    assert sent == [*[0.0] * 5, 20.0]


def test_person_who_moves_before_the_cue_has_no_trial() -> None:
    tick = Tick(**FREE, **STAY)
    phases(tick, 3)
    assert tick(100) == 0
    assert tick.phase == Phase.FREE
    assert phases(tick, 3, count=101) == [Phase.DONE] * 3


def test_the_hold_counts_from_the_first_contact_and_leaving_does_not_restart_it() -> None:
    tick = Tick(**FREE, **STAY, hold_ticks=5)
    phases(tick, 6)  # the first tick of the trial is behind
    assert phases(tick, 3) == [Phase.TRIAL] * 3
    assert phases(tick, 1, count=201) == [Phase.TRIAL]
    assert phases(tick, 2) == [Phase.TRIAL] * 2
    assert phases(tick, 3, count=201) == [Phase.TRIAL, Phase.TRIAL, Phase.RELEASE]
    never = Tick(**FREE, **STAY, hold_ticks=100)
    assert phases(never, 12)[5:] == [*[Phase.TRIAL] * 6, Phase.RELEASE], "without contact, its time ends it"


def test_lost_ticks_count_as_time_in_every_phase() -> None:
    tick = Tick(skip_homing=False, settle_ticks=3, trial_ticks=50, release_ticks=4)
    phases(tick, 4)
    assert tick.phase == Phase.TRIAL
    tick(0, 49)
    assert tick.phase == Phase.TRIAL
    tick(0, 1)
    assert tick.phase == Phase.RELEASE


def test_lost_ticks_count_as_rest_and_as_way_of_the_set_point_in_homing() -> None:
    tick = Tick(**HOME)
    tick(-250)
    tick(-250, 7)
    assert tick.setpoint == pytest.approx((-250 + 8 * 10) * DELTA)
    tick = Tick(**HOME)
    assert phases(tick, 2) == [Phase.HOMING, Phase.SETTLE]
    tick(0, 4)
    assert tick.phase == Phase.TRIAL


def test_the_wall_stands_during_the_release_and_fades_with_the_push() -> None:
    """Push and wall must fade together: a wall that vanished first would throw the handle."""
    tick = Tick(
        skip_homing=False, constant_effort=20.0, wall={"stiffness": 1e3}, trial_ticks=1, release_ticks=4
    )
    balance = []
    for _ in range(6):
        tick(15_000)
        balance.append((tick.effort_wall, tick.effort_sent))
    assert balance[1:] == [(15.0, 5.0), (15.0, 5.0), (15.0, 3.75), (15.0, 2.5), (15.0, 1.25)]
    for _ in range(2):
        assert tick(15_000) == 0


def test_a_release_of_no_length_ends_at_zero_and_not_in_a_division() -> None:
    tick = Tick(skip_homing=False, constant_effort=20.0, trial_ticks=2, release_ticks=0)
    for phase in (Phase.HOMING, Phase.TRIAL, Phase.TRIAL, Phase.RELEASE, Phase.DONE):
        tick(-1)
        assert tick.phase == phase
        assert not tick.has(RowFlag.NONFINITE)
        assert tick.effort_sent == (20.0 if phase == Phase.TRIAL else 0.0)


HOME = {
    "skip_homing": False,
    "home_target": 0.0,
    "home_step": 10 * DELTA,
    "home_stiffness": 1e4,
    "home_damping": 0.0,
    "home_effort": 2.0,
    "home_tolerance": 2.5 * DELTA,
    "settle_ticks": 5,
}


def test_the_homing_set_point_starts_at_the_handle_and_moves_at_limited_speed() -> None:
    tick = Tick(**HOME)
    setpoints = []
    for _ in range(30):
        tick(-250)
        setpoints.append(tick.setpoint)
    assert setpoints[0] == pytest.approx(-240 * DELTA)
    assert np.diff(setpoints[:25]) == pytest.approx(10 * DELTA)
    assert setpoints[-1] == 0.0  # arrives exactly


def test_homing_pushes_with_its_own_small_effort_at_most() -> None:
    tick = Tick(**HOME, constant_effort=50.0, wall={"stiffness": 1e6})
    efforts = []
    for _ in range(60):
        tick(-500)  # something holds the handle 500 counts off
        efforts.append(tick.effort_sent)
    assert max(efforts) == 2.0  # spring: 1e4 N/m · 0.5 mm = 5 N, clipped; neither push nor wall act yet
    assert efforts[0] == pytest.approx(0.1)


def test_a_handle_that_is_not_home_stays_in_homing_and_rest_counts_from_zero_again() -> None:
    tick = Tick(**HOME)
    assert phases(tick, 3, count=40) == [Phase.HOMING] * 3
    assert phases(tick, 5, count=2)[-1] == Phase.SETTLE
    assert phases(tick, 1, count=3) == [Phase.HOMING]
    assert phases(tick, 4, count=-2) == [Phase.SETTLE] * 4
    assert phases(tick, 1, count=-2) == [Phase.TRIAL]


def test_without_a_time_to_settle_the_trial_still_waits_for_the_handle_to_be_home() -> None:
    tick = Tick(**{**HOME, "settle_ticks": 0})
    assert phases(tick, 20, count=-250) == [Phase.HOMING] * 20
    assert Phase.TRIAL in phases(tick, 20, count=0)


def test_a_start_that_is_not_reached_in_time_ends_the_run_at_zero_effort() -> None:
    tick = Tick(**HOME, home_timeout_ticks=20)
    assert phases(tick, 21, count=-250) == [Phase.HOMING] * 21
    assert tick.current_sent != 0
    assert phases(tick, 1, count=-250) == [Phase.DONE]
    assert tick.has(RowFlag.HOMING_FAILED)
    assert tick.current_sent == 0


def test_homing_efforts_rise_no_faster_than_the_homing_slew() -> None:
    tick = Tick(**HOME, homing_slew=0.05)
    efforts = [0.0]
    for _ in range(40):
        tick(-500)
        efforts.append(tick.limited_effort)
    assert np.abs(np.diff(efforts)).max() <= 0.05 * (1 + 1e-9)
    assert efforts[-1] > 1.5


# --- saved and continued ----------------------------------------------------------------------------------


def lively(tick: Tick, ticks: int, seed: int) -> list[tuple]:
    random = np.random.default_rng(seed)
    trace, count = [], 0
    for _ in range(ticks):
        count += int(random.integers(-30, 31))
        tick(count, int(random.choice([1, 1, 1, 2, 5])))
        trace.append(tick.controller.memory[0].tolist())
    return trace


DUAL = {
    "velocity_divider": 10,
    "estimator": "fdm-butterworth",
    "constant_effort": 0.37,
    "wall": {"stiffness": 3001.7, "damping": 1.3},
    "trial_ticks": 350,
    "skip_homing": False,
    "home_stiffness": 900.0,
    "home_damping": 0.3,
    "home_effort": 0.2,
    "home_step": 3e-7,
    "home_tolerance": 1e-3,
    "trial_slew": 0.5,
    "homing_slew": 0.01,
    "tick_s": 1e-4,
    "release_ticks": 100,
}


def test_a_saved_controller_continues_bit_for_bit_after_json() -> None:
    """A recording's header stores the controller as JSON, and replay starts from it."""
    one = Tick(**DUAL)
    lively(one, 137, seed=1)
    two = Tick(**DUAL)
    two.controller = ControllerState.from_mapping(json.loads(json.dumps(one.controller.as_mapping())))
    assert lively(one, 200, seed=2) == lively(two, 200, seed=2)


@pytest.mark.parametrize("part", ["control", "memory"])
def test_a_saved_controller_of_another_version_is_refused_not_filled_up_with_zeros(part: str) -> None:
    saved = Tick(**DUAL).controller.as_mapping()
    removed = next(iter(saved[part]))
    lacking = {**saved, part: {k: v for k, v in saved[part].items() if k != removed}}
    with pytest.raises(RecordingError, match=removed):
        ControllerState.from_mapping(lacking)
    with pytest.raises(RecordingError, match="friction_compensation"):
        ControllerState.from_mapping({**saved, part: {**saved[part], "friction_compensation": 1.0}})


def test_a_saved_controller_with_a_memory_of_another_size_is_refused() -> None:
    """Compiled code does not check sizes."""
    for part, name in (("estimator", "state_f"), ("estimator", "state_i"), ("law", "state")):
        saved = Tick(**DUAL).controller.as_mapping()
        with pytest.raises(RecordingError, match="a different size"):
            ControllerState.from_mapping({**saved, part: {**saved[part], name: [0.0] * 1000}})


def digest() -> str:
    """Return every bit of 400 ticks through homing, trial and release."""
    return "\n".join(
        " ".join(v.hex() if isinstance(v, float) else str(v) for v in row)
        for row in lively(Tick(**DUAL), 400, 7)
    )


@pytest.mark.exhaustive("tests/firmware/law/test_law_float.py::test_every_option_and_limit_is_the_hosts")
def test_compiled_and_plain_python_give_the_same_bits() -> None:
    script = f"import runpy; print(runpy.run_path({str(Path(__file__))!r})['digest']())"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    compiled = digest()
    phases_seen = {line.split()[2] for line in compiled.splitlines()}
    assert phases_seen >= {str(int(p)) for p in (Phase.HOMING, Phase.TRIAL, Phase.RELEASE, Phase.DONE)}
    assert done.stdout.strip() == compiled


def test_between_velocity_samples_the_velocity_is_held_or_extrapolated_to_first_order() -> None:
    """At constant acceleration the finite difference rises linearly, and so does the prediction."""
    counts = [k * k for k in range(41)]
    for extrapolate in (0, 1):
        tick = Tick(velocity_divider=10, extrapolate=extrapolate)
        seen = []
        for count in counts:
            tick(count)
            seen.append((tick.velocity, tick.velocity_sampled))
        for k in range(20, 40):
            sample, since = seen[k - k % 10][1], k % 10
            before = seen[k - k % 10 - 10][1]
            slope = (sample - before) / 10
            assert seen[k][0] == pytest.approx(sample + extrapolate * slope * since, rel=1e-12)


def test_a_slow_handle_is_sampled_more_rarely_and_a_fast_one_at_the_velocity_rate() -> None:
    tick = Tick(velocity_divider=2, slow_multiple=5, slow_speed=2.5 * DELTA / TICK_S)
    updated = []
    for k in range(100):
        tick(4 * k)  # 4 counts a tick: fast
        updated.append(tick.has(RowFlag.VELOCITY_UPDATED))
    assert updated[20:] == [k % 2 == 0 for k in range(20, 100)]
    updated = []
    for k in range(100):
        tick(400 + k)  # 1 count a tick: slow
        updated.append(tick.has(RowFlag.VELOCITY_UPDATED))
    assert np.diff(np.flatnonzero(updated)[3:]).tolist() == [10] * (len(np.flatnonzero(updated)) - 4)
    assert tick.velocity == pytest.approx(DELTA / TICK_S), "the slope is over the whole slow period"
    assert tick.window == 5


def test_the_passivity_observer_adds_up_the_effort_that_was_active() -> None:
    """A command becomes active after it was computed; the energy of that delay counts as the wall's, too."""
    tick = Tick(wall={"stiffness": 1e4}, passive_damping=1.0, constant_effort=0.5)
    tick(1_000)
    energy = tick.wall_energy
    for active, travel in ((-7, 30), (5, -10), (40, -20)):
        tick.active = active
        tick(round(tick.position / DELTA) + travel)
        energy += (active * PLAIN["effort_quantum"] - 0.5) * travel * DELTA
        assert tick.wall_energy == pytest.approx(energy, abs=1e-15)
