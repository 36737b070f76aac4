"""Assertions and golden recordings for a lab's tests: messages name place, time, value and unit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rig
from rig.control.law import Law
from rig.core.errors import RecordingError
from rig.core.sample import Phase
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from rig.recording.data import Recording
from rig.testing import (
    Experiments,
    FaultWords,
    Hits,
    assert_limit,
    assert_passive,
    assert_safe,
    assert_stable,
)
from rig.testing.golden import difference
from rig.testing.hits import DeviceAfterwards

QUICK = {"trial.duration_s": 0.5, "homing.settle_s": 0.01}
HARD = {**QUICK, "wall.stiffness": 900.0, "wall.damping": 0.0, "trial.effort": 0.3}


@kernel(LAW_SIGNATURE)
def sticky(penetration: Any, velocity: Any, elapsed_ticks: Any, state: Any, parameters: Any) -> Any:
    """A wall that is softer on the way in than on the way out, so each contact adds energy."""
    if penetration <= 0.0:
        return 0.0
    return 100.0 * penetration if velocity > 0.0 else 200.0 * penetration


GIVING = Law("giving", "gives energy", sticky, 0, lambda wall: [])


def edited(recording: Recording, row: int, **values: Any) -> Recording:
    rows = recording.rows.copy()
    for name, value in values.items():
        rows[name][row:] = value
    return replace(recording, rows=rows)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    place = tmp_path_factory.mktemp("quick")
    path = rig.hit("koul-compliant", duration_s=QUICK["trial.duration_s"], output=place).path
    return rig.open_recording(path)


def test_a_damped_wall_passes_them_all(rig_hit: Hits) -> None:
    hit = rig_hit("koul-compliant", QUICK)
    assert_stable(hit)
    assert_safe(hit, within_ms=15.0)
    assert_limit(hit)
    assert_passive(hit)
    assert_passive(hit.recording)


def test_the_error_of_an_unstable_wall_has_every_number_behind_it(rig_hit: Hits) -> None:
    with pytest.raises(AssertionError, match="the hit is unstable, not stable") as failed:
        assert_stable(rig_hit("koul-compliant", HARD))
    message = str(failed.value)
    assert "left the wall" in message
    assert "felt (velocity ripple, rms)" in message
    assert "limit 0.05" in message
    assert message.endswith("hit-1.parquet")


def test_a_limit_names_the_first_row_beyond_it_and_the_worst(recording: Recording) -> None:
    speed = np.abs(recording.column("velocity"))
    bound = 0.9 * float(speed.max())
    first = int((speed > bound).argmax())
    with pytest.raises(AssertionError) as failed:
        assert_limit(recording, velocity=bound)
    message = str(failed.value)
    beyond = np.count_nonzero(speed > bound)
    assert f"velocity exceeds {bound:g} rad/s in {beyond} of {len(recording)} rows" in message
    assert f"first {recording.rows['velocity'][first]:.6g} rad/s, in tick {first} (" in message
    assert ", trial)" in message
    assert_limit(recording, velocity=float(speed.max()))
    with pytest.raises(AssertionError, match="effort_sent exceeds"):
        assert_limit(edited(recording, 10, effort_sent=np.nan), effort_sent=1e9)


def test_a_wall_that_gives_energy_is_found_and_one_that_only_takes_is_not(rig_hit: Hits) -> None:
    hit = rig_hit("koul-compliant", QUICK, law=GIVING)
    with pytest.raises(AssertionError, match=r"gave \S+ J more than reading errors") as failed:
        assert_passive(hit)
    given = float(str(failed.value).split()[3])
    rows = hit.recording.rows[np.isin(hit.recording.rows["phase"], (Phase.TRIAL, Phase.RELEASE))]
    push = (rows["effort_wanted"] + rows["effort_wall"])[:-1]
    work = (rows["effort_true"][1:] - push) * np.diff(rows["position_true"])
    total, most = 0.0, 0.0
    for step, free in zip(work, rows["penetration"][:-1] <= 0.0, strict=True):
        total = max(total + step, 0.0) if free else total + step
        most = max(most, total)
    assert 0.5 * most < given < most, "what surely was given is less than what was, and not by much"


def test_an_effort_under_an_old_command_or_behind_a_fault_is_not_safe(recording: Recording) -> None:
    row = int((recording.rows["phase"] == Phase.TRIAL).argmax())
    with pytest.raises(AssertionError, match=r"effort_applied was 0\.15 N·m 30 ms after the newest command"):
        assert_safe(edited(recording, row, command_age=600, effort_applied=0.15), within_ms=20.0)
    with pytest.raises(AssertionError, match=r" 20\.1 ms after the device latched a fault"):
        assert_safe(edited(recording, row, fault=3, effort_applied=0.15), within_ms=20.0)
    assert_safe(edited(recording, row, fault=3, effort_applied=0.0), within_ms=1.0)
    with pytest.raises(AssertionError, match="is incomplete and gives no reason for its end"):
        assert_safe(replace(recording, trailer=None), within_ms=20.0)


@pytest.mark.parametrize(
    ("rest", "what"),
    [
        (None, "its effort is unknown"),
        (DeviceAfterwards(None, False), "was never zero"),
        (DeviceAfterwards(0.0205, False), r"was zero 20\.5 ms after the host's last command"),
        (DeviceAfterwards(0.0, True), "stayed armed"),
    ],
)
def test_effort_after_the_last_command_is_not_safe(
    rig_hit: Hits, rig_experiment: Experiments, rest: Any, what: str
) -> None:
    hit = rig_hit(rig_experiment.short())
    with pytest.raises(AssertionError, match=what):
        assert_safe(replace(hit, rest=rest), within_ms=20.0)


def test_a_pulled_plug_costs_lifetime_and_ramp(
    rig_hit: Hits, rig_faults: FaultWords, rig_experiment: Experiments
) -> None:
    """At 1 kHz a command lives 5 ms and the ramp takes 10; the last one came a tick before the unplugging."""
    rig_faults.link("unplug", tick=30)
    hit = rig_hit(rig_experiment.short())
    assert hit.rest is not None
    assert hit.rest.zero_after_s == pytest.approx(0.0145, abs=0.001)
    assert_safe(hit, within_ms=15.0)
    with pytest.raises(AssertionError, match="it must be zero within 10 ms"):
        assert_safe(hit, within_ms=10.0)


# ---------------------------------------------------------------------- golden recordings


@pytest.fixture
def golden(rig_hit: Hits, rig_experiment: Experiments) -> Recording:
    return rig_hit(rig_experiment.short()).recording


def test_two_runs_are_the_same(golden: Recording, rig_hit: Hits, rig_experiment: Experiments) -> None:
    assert difference(golden, rig_hit(rig_experiment.short()).recording, {}) == ""


def test_rounding_in_every_tick_is_no_difference(golden: Recording) -> None:
    velocity = golden.column("velocity")
    drift = np.arange(len(velocity)) * 16 * np.spacing(np.abs(velocity).max())
    assert difference(golden, edited(golden, 0, velocity=velocity + drift), {}) == ""
    message = difference(golden, edited(golden, 0, velocity=velocity + 100.0 * drift), {})
    assert message.startswith("differs from the golden recording from row ")


def test_one_count_is_a_difference_unless_it_is_tolerated(golden: Recording) -> None:
    count = golden.column("count").copy()
    count[20] += 1
    today = edited(golden, 0, count=count)
    first, line = difference(golden, today, {}).split("\n")
    assert first.startswith("differs from the golden recording from row 20 on (20 ms, ")
    assert line == f"  count: {count[20]} count, was {count[20] - 1} (by 1, allowed 0)"
    assert difference(golden, today, {"count": 1}) == ""
    with pytest.raises(RecordingError, match="unknown column 'counts'"):
        difference(golden, today, {"counts": 1})


def test_a_value_that_is_not_finite_is_a_difference_unless_both_have_it(golden: Recording) -> None:
    torn = golden.column("velocity").copy()
    torn[5] = np.nan
    assert "  velocity: nan rad/s, was " in difference(golden, edited(golden, 0, velocity=torn), {})
    assert difference(edited(golden, 0, velocity=torn), edited(golden, 0, velocity=torn), {}) == ""


def test_a_run_that_ends_sooner_is_a_difference(golden: Recording) -> None:
    shorter = replace(golden, rows=golden.rows[:-3])
    rows = len(golden)
    assert difference(golden, shorter, {}) == f"{rows - 3} rows, and {rows} in the golden recording"
