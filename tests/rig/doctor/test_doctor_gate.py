"""The check before arming and the table of walls, on links with given times, against theory's limits."""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import rig.cli
from rig import config
from rig.analysis import theory
from rig.config import controller, presets
from rig.core.check import Outcome
from rig.core.errors import PlanError
from rig.core.present import plain
from rig.doctor import gate as gates
from rig.doctor._walls import candidate_rates, dampings_of, supported_walls
from rig.doctor.gate import LIFETIME_SHARE, check_armable, gate
from rig.doctor.late_loops import LARGEST_DELAY, LateLoops, hands_of, late_by
from rig.experiments.hits.hit import in_effect
from rig.realtime.clock import MonotonicClock, VirtualClock
from tests.conformance.commands import resolve
from tests.conformance.guides import ROOT, blocks
from tests.conformance.made_links import link

KOUL = presets.load("koul-compliant")
WALL = {"wall.damping": 0.0, "wall.stiffness": 100.0}
BY_HAND = config.override(KOUL, {"controller.velocity_rate": 20_000, **WALL})
CALM = config.override(config.with_realtime(KOUL), {"controller.position_rate": 1000})


def outcomes(found: Any) -> Any:
    return {one.name: one.outcome for one in found.checks}


def texts(found: Any) -> Any:
    return {one.name: one.text for one in found.checks}


def refused(found: Any) -> Any:
    return {one.name: one.text for one in found.checks if one.outcome is Outcome.REFUSED}


def test_delay_is_the_ticks_that_the_way_takes_and_one_at_least() -> None:
    assert [link(30e-6).delay_ticks(rate) for rate in (1000, 20_000, 33_000, 34_000)] == [1, 1, 1, 2]
    assert link(0.0, virtual=True).delay_ticks(20_000) == 0
    assert link(30e-6).delay_ticks(20_000, "host") == 2  # a sample waits for the host's own tick
    assert link(1e-3).loop_rate_hz == pytest.approx(1000.0)


def test_koul_by_hand_at_20_khz_is_refused_from_359_on_with_one_tick_of_delay() -> None:
    """The limit of test_theory_limits, 359 N·m/rad in a normal hand, decides: test both sides of it."""
    with_limits = gate(BY_HAND, link(30e-6))
    assert with_limits.delay_ticks == 1
    limit = with_limits.k_max["normal"]
    assert limit == pytest.approx(359, rel=0.01)
    late = late_by(BY_HAND, 1)
    assert limit == pytest.approx(theory.k_max(late, None, 0.0, operator="normal").stiffness, rel=1e-6)
    for factor, stable in ((0.99, True), (1.01, False)):
        found = gate(config.override(BY_HAND, {"wall.stiffness": factor * limit}), link(30e-6))
        assert (found.spectral_radius["normal"] < 1.0) is stable
    assert not found.armable
    assert "unstable at 20000 Hz with 1 tick of delay" in found.text


@pytest.fixture
def first_power_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Write the file of the check-list for first power-on; return the list's commands."""
    page = blocks(ROOT / "firmware_protocol" / "firmware" / "BENCH.md")
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(next(block.text for block in page if block.language == "toml"))
    return [line for block in page for line in block.commands()]


def test_the_file_of_the_first_power_on_is_armed_as_it_stands(first_power_on: list[str]) -> None:
    """The check-list forbids --arm-anyway, and no command in it changes the wall."""
    found = gate(config.load_experiment("mine.toml"), link(0.5e-3))
    assert found.armable, found.text
    assert max(found.spectral_radius.values()) < 1.0
    hits = [line for line in first_power_on if line.startswith("rig hit")]
    assert hits
    assert not [line for line in hits if " -K " in line or " -B " in line or "--arm-anyway" in line]


def test_each_setting_of_the_first_power_on_can_be_planned_with_its_file(
    first_power_on: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    for line in first_power_on:
        if line.startswith("rig ") and re.search(r"--set|--operator|-K", line):
            words = [
                one for one in resolve(shlex.split(line)[1:])[1] if one not in ("URL", "--url", "--verified")
            ]
            assert rig.cli.run(["experiment", "plan", *words]) == 0, capfd.readouterr().err


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_the_radius_is_the_theorys_own_in_every_hand(delay: int) -> None:
    found = gate(CALM, link((delay - 0.5) * 1e-3))
    assert found.delay_ticks == delay
    assert set(found.spectral_radius) == {"none", "relaxed", "normal", "firm"}
    for hand, value in found.spectral_radius.items():
        wall = CALM.wall
        radius = theory.spectral_radius(
            late_by(CALM, delay), None, wall.stiffness, wall.damping, operator=hand
        )
        assert value == pytest.approx(float(radius))
    unstable = max(found.spectral_radius.values()) >= 1.0
    assert unstable is (delay >= 3)  # as the preset's text says: a softer wall, one or two ticks late
    assert ("stability" in refused(found)) is unstable


def test_a_loop_that_the_host_paces_is_judged_one_tick_later() -> None:
    paced = config.override(CALM, {"host.pacing": "host"})
    one, two = gate(paced, link(0.5e-3)), gate(CALM, link(1.5e-3))
    assert one.delay_ticks == two.delay_ticks == 2
    assert one.spectral_radius == pytest.approx(two.spectral_radius)


def test_a_calm_wall_on_a_quick_link_is_armed() -> None:
    found = gate(CALM, link(0.5e-3))
    assert found.armable
    assert refused(found) == {}
    assert found.remedy == ""
    assert {"delay", "losses", "stability", "passivity", "homing stability"} <= outcomes(found).keys()
    assert set(outcomes(found).values()) == {Outcome.OK}
    assert json.loads(json.dumps(plain(found)))["spectral_radius"]["none"] < 1.0


def test_a_way_of_more_than_half_a_lifetime_is_refused() -> None:
    half = LIFETIME_SHARE * controller.command_lifetime_s(CALM)
    assert half == pytest.approx(2.5e-3)
    for travel_s, too_slow in ((0.99 * half, False), (1.01 * half, True)):
        found = gate(CALM, link(travel_s))
        assert ("delay" in refused(found)) is too_slow


@pytest.mark.parametrize(("lost", "too_many"), [(0, False), (4, False), (5, True)])
def test_losing_more_than_one_in_a_thousand_is_refused(lost: int, too_many: bool) -> None:
    found = gate(CALM, link(lost=lost))
    assert ("losses" in refused(found)) is too_many


def test_too_few_exchanges_are_reported_and_the_longest_counts() -> None:
    found = gate(CALM, link(number=100))
    assert "bound only p97.049" in texts(found)["measurement"]
    assert found.travel_s == pytest.approx(30e-6)


def test_the_usual_filter_stands_in_for_an_estimator_that_is_not_linear() -> None:
    adaptive = config.override(CALM, {"controller.estimator": "foaw-end"})
    found = gate(adaptive, link())
    assert "foaw-end is not linear" in texts(found)["estimator"]
    assert "theory uses fdm-butterworth" in texts(found)["estimator"]
    same = config.override(CALM, {"controller.parameters": {"cutoff_hz": 100.0}})
    assert found.spectral_radius == pytest.approx(gate(same, link()).spectral_radius)


def test_a_wall_with_an_observer_of_the_effort_is_judged_by_its_stability_alone() -> None:
    found = gate(config.override(CALM, {"controller.estimator": "disturbance"}), link())
    assert "is stable" in texts(found)["stability"]
    assert "estimator that uses the effort" in texts(found)["passivity"]
    assert "estimator" not in texts(found)  # no filter stands in
    assert found.passive_stiffness is None


def test_two_velocity_rates_are_both_checked() -> None:
    rates = {"controller.position_rate": 20_000, "controller.velocity_rate": 2_000, "wall.stiffness": 100.0}
    fixed = config.override(KOUL, rates)
    filtered = {"controller.velocity_rate": 500, "controller.parameters": {"cutoff_hz": 50.0}}
    slow = config.override(KOUL, rates | filtered)
    both = config.override(fixed, {"controller.slow_velocity_rate": 500, "controller.slow_below": 0.1})
    found = gate(both, link())
    a, b = gate(fixed, link()), gate(slow, link())
    for hand, value in found.spectral_radius.items():
        assert value == pytest.approx(max(a.spectral_radius[hand], b.spectral_radius[hand]))


def test_a_law_without_linear_theory_is_reported_and_the_round_trip_gates_alone() -> None:
    law = replace(CALM, wall=replace(CALM.wall, law="my-own", stiffness=1e6))
    found = gate(law, link())
    assert found.armable
    assert found.spectral_radius == {}
    assert outcomes(found)["stability"] is Outcome.SKIPPED
    assert "my-own is not a spring and damper" in texts(found)["stability"]
    slow = gate(CALM, link((LARGEST_DELAY + 2) * 1e-3))
    assert slow.spectral_radius == {}
    assert not slow.armable


def test_the_hand_of_the_experiment_is_checked_too() -> None:
    changes = {"trial.kind": "human", "operator.hand_stiffness": 111.0, "operator.press": 1.0}
    own = config.override(CALM, changes)
    assert list(hands_of(own)) == ["none", "relaxed", "normal", "firm", "the experiment's own"]
    assert len(LateLoops.of(own, 1).radius(60.0, 0.2)) == 5


@pytest.mark.parametrize("kind", ["constant-effort", "human"])
def test_each_hand_meets_the_one_observer_that_the_experiment_runs(kind: str) -> None:
    x = config.override(CALM, {"trial.kind": kind, "controller.estimator": "disturbance"})
    by_hand, own = LateLoops.of(x, 1).by_hand, theory.linear_loop(x).estimator
    assert all(loop.loop.estimator is own for loops in by_hand.values() for loop in loops)


# ---------------------------------------------------------------------- before arming


def device(*, simulated: bool = False, virtual: bool = False) -> Any:
    class Device:
        dictionary = SimpleNamespace(simulated=simulated)
        link = SimpleNamespace(clock=VirtualClock() if virtual else MonotonicClock())

    return Device()


@pytest.fixture
def measures(monkeypatch: pytest.MonkeyPatch) -> Any:
    asked = []

    def measure(device: Any, seconds: Any, **_: Any) -> Any:
        asked.append(seconds)
        return link(2.6e-3, lost=1000, simulated=device.dictionary.simulated)

    monkeypatch.setattr(gates, "measure_link", measure)
    return asked


def test_a_real_device_is_refused_with_every_reason_and_every_remedy(measures: Any) -> None:
    with pytest.raises(PlanError) as caught:
        check_armable(device(), CALM)
    for text in ("lifetime", "were lost", "unstable", "must not be armed"):
        assert text in caught.value.message
    for text in ("rig doctor", "cable", "`stiffness` below", "`arm_anyway`"):
        assert text in caught.value.remedy
    assert caught.value.exit_code == 2


def test_anyway_and_a_simulated_device_are_recorded_and_not_refused(measures: Any) -> None:
    forced = check_armable(device(), CALM, anyway=True)
    assert forced.forced
    assert not forced.armable
    simulated = check_armable(device(simulated=True), CALM)
    assert simulated.simulated
    assert not simulated.armable


def test_a_device_is_measured_once_and_in_virtual_time_never(measures: Any) -> None:
    one, other = device(simulated=True), device(simulated=True)
    check_armable(one, CALM)
    gates.measured_once(one, CALM.host, 1000, None)
    assert len(measures) == 1
    gates.measured_once(other, CALM.host, 1000, None)
    assert len(measures) == 2
    assert check_armable(device(virtual=True), CALM) is None
    assert len(measures) == 2


def test_a_real_device_is_measured_as_long_as_p999_takes(measures: Any) -> None:
    for rate, seconds in ((1000, 3.1), (5000, 1.0), (100, 4.0)):
        gates.measured_once(device(), CALM.host, rate, None)
        assert measures[-1] == pytest.approx(seconds, abs=0.1)
    slow = {"controller.position_rate": 500, "controller.velocity_rate": 500, "verdict.lowpass_hz": 45.0}
    check_armable(device(), config.override(CALM, slow), anyway=True)
    assert measures[-1] == 4.0, "the experiment's rate"


def test_in_real_time_the_device_names_the_rate_and_the_file_the_wall_unless_the_user_does() -> None:
    real = device()
    real.dictionary.position_rate_default = 800

    def chosen(**changes: float) -> tuple[int, int, float]:
        x = in_effect(KOUL, real, {key.replace("__", "."): value for key, value in changes.items()})
        return x.controller.position_rate, x.controller.velocity_rate, x.wall.stiffness

    assert chosen() == (800, 800, KOUL.realtime["wall.stiffness"])
    rates = {"controller__position_rate": 1000, "controller__velocity_rate": 500}
    assert chosen(**rates, wall__stiffness=77.0, verdict__lowpass_hz=200.0) == (1000, 500, 77.0)


# ---------------------------------------------------------------------- the table of walls


def test_the_table_has_the_limits_of_theory_for_each_scheme_with_its_delay() -> None:
    shares = []
    rows = supported_walls(CALM, link(0.4e-3), 4000, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [(row.position_rate, row.velocity_rate, row.delay_ticks) for row in rows] == [
        (1000, 1000, 1), (1000, 100, 1), (2500, 2500, 1), (2500, 250, 1), (4000, 4000, 2), (4000, 400, 2),
    ]  # fmt: skip
    dampings = dampings_of(CALM)
    assert dampings == (0.0, 0.2, 0.4)
    for row in rows:
        late = late_by(CALM, row.delay_ticks)
        assert tuple(largest.damping for largest in row.k_max) == dampings
        assert all(largest.least[1] == min(largest.by_hand.values()) for largest in row.k_max)
        hand = "none" if row.velocity_rate == row.position_rate else "firm"
        for largest in row.k_max[:: len(dampings) - 1]:
            limit = theory.k_max(late, row.scheme, largest.damping, operator=hand)
            assert largest.by_hand[hand] == pytest.approx(limit.stiffness)
        assert json.loads(json.dumps(plain(row)))["k_max"][0]["by_hand"].keys() == row.k_max[0].by_hand.keys()


def test_no_rate_is_proposed_that_the_link_cannot_carry() -> None:
    rates = candidate_rates(CALM, link(30e-6, capacity=92_160.0), 4000)
    assert [(rate.hertz, rate.because) for rate in rates] == [
        (1000, "the experiment's"),
        (1200, "the link's capacity"),
    ]


def test_a_dual_rate_experiment_keeps_its_ratio() -> None:
    quarter = config.override(CALM, {"controller.velocity_rate": 250, "verdict.lowpass_hz": 100.0})
    rows = supported_walls(quarter, link(30e-6), 1000)
    assert [(row.position_rate, row.velocity_rate) for row in rows] == [(1000, 1000), (1000, 250)]


def test_limits_of_another_estimator_that_stands_in_say_so() -> None:
    levant = config.override(CALM, {"controller.estimator": "levant"})
    assert all("levant" in row.reason for row in supported_walls(levant, link(30e-6), 1000))


def test_the_way_to_a_drive_behind_a_bridge_is_delay_too() -> None:
    """Drive reply, link and law share a period: 0.4 ms plus 0.5 ms fit in one tick at 1 kHz."""
    replies = {"replies": 999.0, "lost": 1.0, "median_us": 300.0, "longest_us": 900.0, "temperature": 31.0}
    near = link(0.5e-3, drive={**replies, "p999_us": 400.0})
    far = link(0.5e-3, drive={**replies, "p999_us": 600.0})
    assert [one.delay_ticks(1000) for one in (link(0.5e-3), near, far)] == [1, 1, 2]
    assert near.loop_rate_hz == pytest.approx(1 / 0.9e-3)
    by_itself = link(0.5e-3, drive={**replies, "p999_us": 600.0, "cycle_us": 1000.0})
    assert (by_itself.loop_rate_hz, by_itself.delay_ticks(500)) == (pytest.approx(500.0), 1)
    (row,) = (row for row in near.rows() if row.label == "drive")
    assert "p99.9 0.4 ms" in row.value
    assert "1 of 1000 replies lost; 31 °C" in row.value
