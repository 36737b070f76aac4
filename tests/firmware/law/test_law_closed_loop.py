"""The fixed-point law in C, in lock-step with the simulated rig: the trajectory of the host's fixed wall, exactly."""

from __future__ import annotations

from typing import Any

import pytest

from rig.control.fixed_wall import current_quanta
from rig.control.verdict import Kind
from rig.core.sample import Phase
from sim_backend.plant import advance
from tests.firmware.law.law_design import FIXED, fixed_wall_of, parameters_of, velocity_format
from tests.firmware.law.law_rigs import (
    DUAL,
    SHORT,
    START,
    UNIFORM,
    controller_of,
    experiment_of,
    in_lock_step,
    on_the_host,
    plant_of,
)

ESTIMATOR = ("fdm-butterworth-fixed", {})
ONE_SECOND = 20_000


@pytest.mark.parametrize(("scheme", "damping"), [(DUAL, 0.5), (UNIFORM, 0.2)], ids=["dual", "uniform"])
def test_a_hit_of_a_second_is_the_hosts_fixed_wall_exactly(law: Any, scheme: Any, damping: float) -> None:
    experiment = experiment_of(*ESTIMATOR, scheme, {"wall.damping": damping, "trial.duration_s": 1.0})
    host, quantum = controller_of(experiment), experiment.rig.amplifier.current_quantum_a
    c = {name: host.control[name][0].item() for name in host.control.dtype.names}
    e, divider = host.estimator, c["velocity_divider"]
    wall = fixed_wall_of(c, host.law.parameters, velocity_format(e))
    plant, quantum_effort = plant_of(experiment), quantum * experiment.rig.amplifier.effort_per_ampere
    moving, update = plant.arguments(plant.at_rest(START)), e.estimator.update
    counts, currents, velocity = [], [], 0
    lsb = e.parameters[-1] * e.parameters[0]  # SI velocity of the last bit
    count = advance(moving, 0.0, 0.0)
    for k in range(ONE_SECOND):
        if k % divider == 0:
            velocity = round(update(count, 0.0, 1, e.state_f, e.state_i, e.parameters) / lsb)
        current = current_quanta(count, velocity, wall)
        counts.append(count)
        currents.append(current)
        count = advance(moving, current * quantum_effort, 0.0)

    p = parameters_of(controller_of(experiment), FIXED)
    memory = law.reset(p)
    memory.phase = Phase.TRIAL
    ours = in_lock_step(law, experiment, p, memory, ONE_SECOND)
    assert ours.counts.tolist() == counts
    assert ours.currents.tolist() == currents
    assert min(currents) < -2000, "it must hit"


def test_the_fixed_law_renders_the_wall_of_the_float64_one(law: Any) -> None:
    experiment = experiment_of(*ESTIMATOR, DUAL, SHORT, {"trial.duration_s": 0.6, "verdict.tail_s": 0.2})
    p = parameters_of(controller_of(experiment), FIXED)
    ours = in_lock_step(law, experiment, p, law.reset(p), 20_000).verdict(experiment)
    host = on_the_host(experiment).verdict(experiment)
    assert ours.kind == host.kind != Kind.INVALID
    assert ours.peak_penetration == pytest.approx(host.peak_penetration, rel=0.01)
    assert ours.impact_velocity == pytest.approx(host.impact_velocity, rel=0.01)
    assert ours.contact_s == pytest.approx(host.contact_s, rel=0.001)
