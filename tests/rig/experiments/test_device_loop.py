"""An experiment whose law runs on the device: its plan, checks before arming, changes and excitation; no device."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from firmware_protocol import dictionary
from rig import config, devices
from rig.config import device_law, presets
from rig.config.controller import prepare_controller
from rig.control import bilateral
from rig.control.excitation_table import PHASES, ExcitationTable
from rig.core.check import Outcome
from rig.core.errors import ConfigError, PlanError
from rig.doctor._walls import candidate_rates
from rig.doctor.gate import gate
from rig.experiments.hits.hit import in_effect
from rig.experiments.trials import excitation_run, live
from rig.experiments.trials.plan import device_checks, link_checks, make_plan
from tests.conformance.made_links import link

RIGID = presets.load("koul-rigid")
ON_DEVICE = config.override(RIGID, {"controller.loop": "device"})
HOLDS = config.override(ON_DEVICE, {"wall.stiffness": 150.0, "wall.damping": 0.1})  # in every hand
EXAMPLE = Path(__file__).parents[3] / "firmware_protocol/firmware/boards/rp2040/example.toml"
SHORT = {"excitation.channel": "motor", "excitation.period_s": 0.1, "excitation.low_hz": 10.0}
EXCITED = config.excited(config.override(ON_DEVICE, {**SHORT, "wall.stiffness": 50.0}))


def device(**ranges: Any) -> Any:
    given = {"device": "board", "firmware": "1", "simulated": False, "current_quantum_a": 0.001}
    return dictionary.build(**given, ranges=ranges)


def test_the_example_for_a_board_is_fixed_point_at_20_khz() -> None:
    x = config.load_experiment(EXAMPLE)
    assert (x.controller.loop, device_law.arithmetic_of(x.controller)) == ("device", "fixed")
    plan = make_plan(x)
    assert plan.ok
    assert gate(x, link(5e-3)).armable
    assert "on the device in integers" in plan.steps[0].text


def test_arithmetic_follows_the_estimator_unless_it_is_given() -> None:
    for estimator, given, expected in (
        ("fdm-butterworth-fixed", "auto", "fixed"),
        ("fdm-butterworth-fixed", "float32", "float32"),
        ("levant", "auto", "float32"),
    ):
        x = config.override(RIGID, {"controller.estimator": estimator, "controller.arithmetic": given})
        assert device_law.arithmetic_of(x.controller) == expected


@pytest.mark.parametrize(
    ("key", "value", "instead"), [("pacing", "host", "device"), ("overrun", "stop", "skip")]
)
def test_pacing_or_stopping_by_the_host_is_refused(key: str, value: str, instead: str) -> None:
    with pytest.raises(ConfigError, match=rf'host.{key} = "{value}": must be "{instead}"'):
        config.override(ON_DEVICE, {f"host.{key}": value})


def test_the_filter_steps_of_one_tick_are_bounded() -> None:
    """At 20k/2k, velocity sampled ten times more rarely would need ten filter steps in one tick; five is the limit."""

    def parameters_for(slow_velocity_rate: Any) -> Any:
        slow = {"controller.slow_velocity_rate": slow_velocity_rate, "controller.slow_below": 0.1}
        x = config.override(ON_DEVICE, slow)
        return prepare_controller(x, current_quantum_a=0.001, reference_count=0, verified=True).parameters

    assert parameters_for(400)["slow_multiple"] == 5
    with pytest.raises(PlanError, match=r"slow_velocity_rate = 200 .* 10 velocity periods") as refused:
        parameters_for(200)
    assert "loop" in refused.value.remedy


# ---------------------------------------------------------------------- real time


def test_real_time_makes_nothing_gentler_where_the_device_runs_the_law() -> None:
    with_host = replace(RIGID, realtime={**RIGID.realtime, "host.heartbeat_s": 1.0})
    x = config.with_realtime(with_host, {"controller.loop": "device"})
    assert x.controller.position_rate == 20_000
    assert x.wall == RIGID.wall
    assert x.host.heartbeat_s == 1.0
    assert config.with_realtime(RIGID).controller.position_rate == 1000


def test_a_rate_of_the_device_is_the_hosts_only() -> None:
    board = SimpleNamespace(
        link=SimpleNamespace(clock=SimpleNamespace(virtual=False)),
        dictionary=SimpleNamespace(position_rate_default=1500),
    )
    for loop, rate in (("host", 1500), ("device", 20_000)):
        x = in_effect(RIGID, board, {"controller.loop": loop})
        assert (x.controller.loop, x.controller.position_rate) == (loop, rate)


# ---------------------------------------------------------------------- what a device can do


def test_a_device_without_a_law_is_refused_with_what_to_do() -> None:
    _, check = device_checks(prepare_controller(ON_DEVICE), device(law=(0, 0)))
    assert check.outcome is Outcome.REFUSED
    assert "board (1) cannot run the law itself" in check.text
    assert "rig firmware" in check.remedy
    _, simulated = device_checks(prepare_controller(ON_DEVICE), replace(device(law=(0, 0)), simulated=True))
    assert "firmware=1" in simulated.remedy
    (limits,) = device_checks(prepare_controller(RIGID), device(law=(0, 0)))
    assert limits.outcome is Outcome.OK


def test_a_device_that_has_less_of_the_law_is_refused_by_the_name_of_what_it_lacks() -> None:
    _, good = device_checks(prepare_controller(ON_DEVICE), device())
    assert (good.outcome, good.text) == (Outcome.OK, "board runs it in float32")
    _, integers = device_checks(prepare_controller(ON_DEVICE), device(law=(0, 1)))
    assert integers.outcome is Outcome.REFUSED
    assert "law = 2 (allowed: 0 to 1)" in integers.text
    excited = prepare_controller(EXCITED, law=excitation_run.excited_law(EXCITED))
    _, short = device_checks(excited, device(excitation_period=(2, 1000)))
    assert "excitation_period = 2000 (allowed: 2 to 1000)" in short.text


def test_the_link_must_carry_every_tick() -> None:
    fast = config.override(ON_DEVICE, {"controller.position_rate": 50_000, "controller.velocity_rate": 5000})
    for x, baud, outcome in ((ON_DEVICE, 3e6, "ok"), (fast, 3e6, "refused"), (ON_DEVICE, 921_600, "refused")):
        rate, capacity = link_checks(x, 50_000, baud / 10)
        assert (rate.outcome, capacity.outcome) == ("ok", outcome)
        assert f"every tick at {x.controller.position_rate} Hz" in capacity.text
    tight = link_checks(fast, 50_000, 3e5)[1]
    assert "controller.measured_current = false" in tight.remedy
    short = config.override(fast, {"controller.measured_current": False})
    assert link_checks(short, 50_000, 3e5)[1].outcome == "ok"
    assert link_checks(fast, 20_000, None)[0].outcome == "refused"


def test_a_simulated_rig_that_runs_the_law_is_the_firmware() -> None:
    assert devices.url_for("sim://", "device") == "sim://?firmware=1"
    assert devices.url_for("sim://koul-rigid?seed=3", "device") == "sim://koul-rigid?seed=3&firmware=1"
    unchanged = [("sim://", "host"), ("serial:///dev/ttyACM0", "device"), ("sim://?firmware=0", "device")]
    for url, loop in unchanged:
        assert devices.url_for(url, loop) == url


# ---------------------------------------------------------------------- the gate


def test_the_gate_judges_a_law_on_the_device_without_the_links_delay() -> None:
    """A round trip of 3 ms is 60 ticks of delay for a law on the host, with which no wall is stable."""
    slow = link(3e-3)
    there, here = gate(HOLDS, slow), gate(config.override(HOLDS, {"controller.loop": "host"}), slow)
    assert there.armable
    assert not here.armable
    assert (there.delay_ticks, there.lifetime_s) == (0, 0.02)
    assert here.delay_ticks == 60
    assert "execution" in [one.name for one in there.checks]


def test_the_gate_needs_commands_in_time_and_a_stable_wall() -> None:
    late = gate(HOLDS, link(0.011))
    assert not late.armable
    assert "supervise_lifetime_s" in late.remedy
    longer = config.override(HOLDS, {"controller.supervise_lifetime_s": 0.1})
    assert gate(longer, link(0.011)).armable
    hard = config.override(ON_DEVICE, {"wall.stiffness": 400.0, "wall.damping": 0.0})
    found = gate(hard, link())
    assert "with 0 ticks of delay" in found.text


def test_rates_of_a_law_on_the_device_are_not_the_links() -> None:
    slow = link(3e-3, capacity=92_160.0)
    assert [rate.hertz for rate in candidate_rates(ON_DEVICE, slow, 50_000)] == [20_000, 50_000]
    assert max(rate.hertz for rate in candidate_rates(RIGID, slow, 50_000)) < 2000


# ---------------------------------------------------------------------- changes and motions


def test_a_change_that_the_device_does_not_take_is_refused_before_it_is_posted() -> None:
    info = {"experiment": config.as_mapping(ON_DEVICE), "current_quantum_a": 0.001}
    ring = SimpleNamespace(info_and_word=lambda: (info, 0), get=lambda word: 0, replace=lambda *_: 7)
    assert live._post(ring, {"wall.stiffness": 250.0})[0] == 7
    with pytest.raises(PlanError, match="cannot change while the law runs on the device"):
        live._post(ring, {"wall.pull": "allow"})
    info["experiment"] = config.as_mapping(RIGID)
    assert live._post(ring, {"wall.pull": "allow"})[0] == 7


# ---------------------------------------------------------------------- excitation


@pytest.mark.parametrize("kind", ["random", "schroeder"])
def test_the_host_plays_the_table_that_the_device_makes(kind: str) -> None:
    x = config.override(EXCITED, {"excitation.kind": kind, "excitation.realisations": 1})
    law = excitation_run.excited_law(x, current_quantum_a=0.002)
    quantum = 0.002 * x.rig.amplifier.effort_per_ampere
    given = {name.removeprefix("excitation_"): value for name, value in law.device.items()}
    table = ExcitationTable(**{**given, "phases": PHASES[given["phases"]]})
    rendered = law.prepare({"stiffness": 1.0, "damping": 0.0, "side": x.wall.side})
    played = bilateral.played(rendered.parameters, x.wall.side, 1.0, 3 * table.period)[2 * table.period :]
    np.testing.assert_array_equal(played, table.table * 2.0**-table.bits * quantum)
    assert table.ramp == round(excitation_run.ramp_s(x) * 20_000)
    prepared = prepare_controller(x, current_quantum_a=0.002, reference_count=0, verified=True, law=law)
    assert {**law.device, "bilateral": 1}.items() <= prepared.parameters.items()


def test_the_excitation_has_the_size_and_lines_of_the_experiment() -> None:
    wanted = config.excitation_size(EXCITED)["rms"]
    multisine = excitation_run.multisine_of(EXCITED)
    assert multisine.rms == pytest.approx(wanted, rel=1e-4)
    assert multisine.lines_hz.tolist() == excitation_run._own_multisine(EXCITED, 0).lines_hz.tolist()
    by_peak = config.override(EXCITED, {"excitation.peak": 0.3})
    assert excitation_run.multisine_of(by_peak, 1).peak == pytest.approx(0.3, rel=1e-3)
    other = excitation_run.multisine_of(EXCITED, 1)
    assert not np.allclose(multisine.phases, other.phases)
    table = excitation_run.device_table(EXCITED, 1)
    sampled = other.period(20_000)
    quantum = EXCITED.rig.amplifier.effort_quantum
    assert np.abs(table.efforts(quantum) - sampled).max() <= table.error * quantum
    on_host = config.override(EXCITED, {"controller.loop": "host"})
    assert excitation_run.excited_law(on_host).device == {}


def test_an_excitation_that_no_table_holds_is_refused() -> None:
    long = config.override(EXCITED, {"excitation.period_s": 10.0})
    with pytest.raises(ConfigError, match="period"):
        excitation_run.multisine_of(long)
