"""Runaway detection, simulated without a link: the largest speed of a free handle whose count stands still."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from firmware_protocol.messages import OLDEST_EDGE
from rig import config
from rig.config import Experiment, controller, presets
from rig.control.step import step
from rig.core.board import moved_mechanics
from rig.core.model import RigModel
from rig.core.sample import Phase, RowFlag
from sim_backend.bare.trial import Trace, run_arguments, run_ticks
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import DiscretePlant, advance
from tests.system.test_dead_encoder import DEAD

Count = Callable[[int], int]
# Share of the speed limit at which a dead encoder is detected, as in firmware_protocol/firmware/fmea.toml.
SHARE = 0.5


@dataclass(frozen=True)
class TrialEnd:
    """Result of a trial: true speeds at the samples, flags of the last tick, phases, and the final current.

    `inside` is True if the encoder died in the wall, where a count may rest lawfully: there the device must judge, not
    the law.
    """

    speeds: np.ndarray
    flags: RowFlag
    phases: frozenset[Phase]
    current: int
    inside: bool


def run(
    x: Experiment,
    *,
    at: float,
    dies: int,
    dead: Callable[[int], Count] = DEAD["unplugged"],
    model: RigModel | None = None,
) -> TrialEnd:
    """Run a trial from rest at a position until a phase begins; the encoder dies in tick `dies`."""
    law = controller.for_experiment(x, current_quantum_a=x.rig.amplifier.current_quantum_a)
    plant = DiscretePlant.build(model or config.rig_model(x), 1.0 / x.controller.position_rate)
    state, arguments, memory = plant.at_rest(at), law.arguments(), law.memory[0]
    moved, quantum = plant.arguments(state), float(law.control[0]["effort_quantum"])
    speeds, phases, current, read, inside = [], set(), 0, lambda true: true, False
    wall = x.wall.side * x.wall.position - 2.0 * abs(x.rig.encoder.resolution)  # where a count may be in it
    while Phase(memory["phase"]) is not Phase.DONE:
        count = advance(moved, current * quantum, 0.0)
        if len(speeds) == dies:
            read = dead(count)
            inside = x.wall.side * state[plant.handle_position] >= wall
        speeds.append(abs(state[plant.handle_position + 1]))
        current = step(arguments, read(count), 0.0, 1, 0)
        phases.add(Phase(memory["phase"]))
    return TrialEnd(np.array(speeds), RowFlag(int(memory["flags"])), frozenset(phases), current, inside)


def away(x: Experiment, share: float) -> float:
    """Return a position to home from, at a share of half the distance from the start to the end of the window."""
    return x.trial.start + 0.5 * share * (x.rig.limits.position_minimum - x.trial.start)


def assert_bounded(x: Experiment, ran: TrialEnd, dies: int) -> None:
    """Check that the speed stays below its bound plus one tick and the amplifier's lag, and the current ends at 0."""
    m, limits = moved_mechanics(config.rig_model(x)), x.rig.limits
    effort = max(x.homing.effort, abs(x.trial.effort))
    late_s = 3.0 / x.controller.position_rate + m.lag_s
    share = SHARE * limits.speed
    bound = share + max(share, ran.speeds[min(dies, len(ran.speeds) - 1)]) + effort * late_s / m.inertia
    assert ran.speeds[dies:].max(initial=0.0) <= bound
    assert ran.current == 0
    ended = RowFlag.UNMOVED | RowFlag.OUT_OF_WINDOW | RowFlag.HOMING_FAILED
    assert ran.flags & ended or Phase.RELEASE in ran.phases


RIGS = {
    "inertia": st.floats(0.2, 5.0),
    "coulomb": st.just(0.0) | st.floats(1e-6, 4.0),
    "stiffness": st.floats(0.05, 3.0),
    "damping": st.just(0.0) | st.floats(1e-6, 2.0),
    "effort": st.floats(0.05, 3.0),
    "push": st.floats(0.05, 2.0),
    "speed": st.floats(0.1, 2.0),
    "limit": st.floats(0.1, 2.0),
}


@settings(deadline=None, max_examples=6)
@given(st.fixed_dictionaries(RIGS), st.integers(0, 600), st.sampled_from(sorted(DEAD)))
def test_with_an_encoder_that_dies_the_handle_of_any_rig_stays_slow(
    times: dict[str, float], dies: int, dead: str
) -> None:
    x = presets.load("hapkit")
    m, h = x.rig.mechanics, x.homing
    x = config.override(x, {
        "rig.mechanics.motor_inertia": times["inertia"] * m.motor_inertia,
        "rig.mechanics.link_inertia": times["inertia"] * m.link_inertia,
        "rig.mechanics.motor_coulomb": times["coulomb"] * m.motor_coulomb,
        "rig.mechanics.link_coulomb": times["coulomb"] * m.link_coulomb,
        "rig.limits.speed": times["limit"] * x.rig.limits.speed,
        "homing.stiffness": times["stiffness"] * h.stiffness,
        "homing.damping": times["damping"] * h.damping,
        "homing.effort": times["effort"] * h.effort,
        "homing.speed": min(times["speed"] * h.speed, 0.5 * times["limit"] * x.rig.limits.speed),
        "homing.timeout_s": 2.0,
        "trial.effort": times["push"] * x.trial.effort,
        "trial.minimum_rest_counts": 0.0,
    })  # fmt: skip
    ran = run(x, at=away(x, 0.5), dies=dies, dead=DEAD[dead])
    assume(not ran.inside)
    assert_bounded(x, ran, dies)


@pytest.mark.parametrize("name", ["chawda-linear", "koul-compliant", "koul-rigid"])
def test_a_dead_encoder_is_detected_as_a_handle_without_friction_reaches_half_of_its_speed_limit(
    name: str,
) -> None:
    losses = ("motor_damping", "link_damping", "motor_coulomb", "link_coulomb")
    without = {f"rig.mechanics.{loss}": 0.0 for loss in losses}
    x = config.override(presets.load(name), without | {"trial.minimum_rest_counts": 0.0})
    ran = run(x, at=away(x, 1.0), dies=0)
    assert RowFlag.UNMOVED in ran.flags
    assert ran.speeds.max() == pytest.approx(SHARE * x.rig.limits.speed, rel=0.02)


@pytest.mark.parametrize("name", presets.names())
def test_a_working_encoder_is_never_reported_as_dead(name: str) -> None:
    """Friction may hold the handle near its start, let it creep, or be larger than the rig's description."""
    x = presets.load(name)
    model, tick_s = config.rig_model(x), 1.0 / x.controller.position_rate
    m, near = model.mechanics, x.trial.start - 0.9 * x.homing.tolerance_counts * x.rig.encoder.resolution
    rough = replace(m, motor_coulomb=1.2 * m.motor_coulomb, link_coulomb=1.2 * m.link_coulomb)
    slow = config.override(x, {"homing.speed": 0.05 * x.homing.speed, "homing.timeout_s": 60.0})
    for mechanics, at, described in ((rough, near, x), (rough, away(x, 1.0), x), (m, away(x, 0.05), slow)):
        plant = DiscretePlant.build(replace(model, mechanics=mechanics), tick_s)
        law = controller.for_experiment(described, current_quantum_a=x.rig.amplifier.current_quantum_a)
        trace = Trace.empty(round(20.0 / tick_s), plant)
        ticks = run_ticks(
            *run_arguments(law, plant, plant.at_rest(at), 0.0, OLDEST_EDGE, OperatorScript.silent()), trace
        )
        assert Phase.RELEASE in trace.phases[:ticks]


def test_a_person_may_hold_the_handle_still() -> None:
    x = presets.load("hapkit")
    held = config.override(x, {"trial.kind": "human", "homing.timeout_s": 1.0})
    ran = run(held, at=away(x, 1.0), dies=0, model=config.rig_model(x))
    assert ran.flags & (RowFlag.UNMOVED | RowFlag.HOMING_FAILED) == RowFlag.HOMING_FAILED


def test_ticks_whose_sample_was_lost_are_not_counted() -> None:
    """On a busy computer the commands of lost samples never arrive, so the handle rightly stands still."""
    x = presets.load("koul-compliant")
    law = controller.for_experiment(x, current_quantum_a=x.rig.amplifier.current_quantum_a)
    for _ in range(4):
        step(law.arguments(), 0, 0.0, 1600, 0)  # 80 ms
    assert Phase(law.memory[0]["phase"]) is Phase.HOMING
    assert abs(law.memory[0]["effort_sent"]) > law.control[0]["held_effort"]
    assert not law.memory[0]["flags"] & RowFlag.UNMOVED
