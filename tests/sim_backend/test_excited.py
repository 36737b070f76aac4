"""An excitation simulated in one compiled call: second actuator, timing of the law, reasons for an early end."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rig import config
from rig.config import controller, presets
from rig.control import laws
from rig.control.law import Law
from rig.control.step import step
from rig.core.errors import LawError
from rig.core.sample import Phase
from rig.realtime.kernel import kernel
from rig.realtime.plugs import LAW_SIGNATURE
from sim_backend.bare.excited import ExcitedPlant
from sim_backend.mechanics.plant import DiscretePlant, advance

COGS = {
    "rig.cogging.period": 0.02, "rig.cogging.orders": [3], "rig.cogging.cosine": [0.01],
    "rig.cogging.sine": [0.02], "rig.cogging.ripple_cosine": [0.05], "rig.cogging.ripple_sine": [0.02],
}  # fmt: skip


def new_rig(name: str = "chawda-linear", law: str = "bilateral", **changes: Any) -> Any:
    """Return an experiment with excitation, its rig model, and a new controller."""
    x = config.excited(config.override(presets.load(name), changes))
    quantum = x.rig.amplifier.current_quantum_a
    chosen = laws.get(law) if isinstance(law, str) else law
    return x, config.rig_model(x), controller.for_experiment(x, current_quantum_a=quantum, law=chosen)


def excited_plant(x: Any, model: Any, acquisition_hz: float = 4000.0, ticks: int = 2000) -> Any:
    return ExcitedPlant(model, 1.0 / x.controller.position_rate, acquisition_hz, ticks)


@pytest.mark.parametrize(
    ("name", "delay", "cogging"),
    [("chawda-linear", 2, {}), ("koul-rigid", 0, {}), ("koul-compliant", 2, {}), ("koul-compliant", 0, COGS)],
)
def test_it_is_the_plant_and_the_law_stepped_by_hand(name: str, delay: int, cogging: Any) -> None:
    """The compiled call equals single steps in every bit, also with cogging and with a delay in ticks of the law."""
    changes = {"rig.simulation.computation_delay_ticks": delay, **cogging}
    x, model, law = new_rig(name, **changes)
    _, _, other = new_rig(name, **changes)
    push = 0.4 * x.rig.limits.effort * np.sin(np.arange(400) * 2.0 * np.pi / 400)
    bench = excited_plant(x, model, acquisition_hz=1.0, ticks=400)
    ratio = round(bench.inner_rate_hz / x.controller.position_rate)
    run = bench.excite(law, 0.0, push, 0.0, 400)

    finer = replace(model, simulation=replace(model.simulation, computation_delay_ticks=delay * ratio))
    plant = DiscretePlant.build(finer, 1.0 / bench.inner_rate_hz)
    state, count, j = plant.at_rest(0.0), 0, 0
    other.memory["phase"], other.memory["phase_ticks"] = int(Phase.TRIAL), -1
    for k in range(400):
        assert (run.counts[k], run.position[k]) == (count, state[plant.handle_position])
        step(other.arguments(), count, 1e-3, 1, 0)
        memory = other.memory[0]
        assert run.withheld[k] == memory["effort_sent"] - memory["effort_wanted"]
        for _ in range(ratio):
            count = advance(plant.arguments(state), memory["effort_sent"], push[j % 400])
            j += 1
    assert np.abs(run.position).max() > 3 * x.rig.encoder.resolution


def test_the_inner_step_divides_the_tick_and_samples_an_excitation_well() -> None:
    for name, rate, inner in (
        ("chawda-linear", 1000, 20_000),
        ("koul-rigid", 20_000, 20_000),
        ("koul-rigid", 7000, 21_000),
    ):
        x, model, _ = new_rig(name, **{"controller.position_rate": rate, "controller.velocity_rate": rate})
        assert excited_plant(x, model).inner_rate_hz == pytest.approx(inner)


@pytest.mark.parametrize(
    ("asked", "got"), [(1.0, 1000), (1000.0, 1000), (4000.0, 4000), (5500.0, 10_000), (1e9, 20_000)]
)
def test_positions_are_kept_at_least_as_often_as_asked_and_whole_times_a_tick(asked: float, got: int) -> None:
    x, model, law = new_rig()
    run = excited_plant(x, model, acquisition_hz=asked).excite(law, 0.0, np.array([1.0]), 0.0, 50)
    assert run.acquisition_s == pytest.approx(1.0 / got)
    assert len(run.position) == 50 * got // 1000


def test_the_guard_ends_a_run_that_leaves_its_window_and_the_run_says_so() -> None:
    x, model, law = new_rig(**{"wall.stiffness": 0.0, "wall.damping": 0.0})
    run = excited_plant(x, model).excite(law, 0.0, np.array([5.0]), 0.0, 2000)
    assert 0 < run.ticks < 2000
    assert len(run.position) == 4 * run.ticks
    assert law.memory[0]["position"] > x.rig.limits.position_maximum
    assert run.position[-1] <= x.rig.limits.position_maximum + 1e-3


def test_an_effort_beyond_the_limit_is_clipped_and_counted() -> None:
    x, model, law = new_rig(
        **{"rig.limits.effort": 1.0, "rig.limits.nominal_effort": 1.0, "homing.effort": 1.0, "trial.effort": 1.0,
           "wall.stiffness": 20e3, "trial.minimum_rest_counts": 0.0}
    )  # fmt: skip
    run = excited_plant(x, model).excite(law, 0.0, np.array([3.0]), 0.0, 200)
    assert run.saturated > 100
    assert run.withheld.max() > 0.5


@kernel(LAW_SIGNATURE)
def _broken(penetration: Any, velocity: Any, elapsed: Any, state: Any, parameters: Any) -> Any:
    return penetration / (penetration - penetration)


def test_law_that_returns_nan_is_named_in_the_error() -> None:
    law = Law("broken", "", _broken, 1, lambda wall: [])
    x, model, fresh = new_rig(law=law)
    with pytest.raises(LawError, match="law broken"):
        excited_plant(x, model).excite(fresh, 0.0, np.array([1.0]), 0.0, 100)


def test_two_runs_are_equal_and_the_first_is_not_overwritten_by_the_second() -> None:
    x, model, law = new_rig()
    _, _, other = new_rig()
    _, _, third = new_rig()
    bench = excited_plant(x, model)
    one = bench.excite(law, 0.0, np.array([1.0, -1.0]), 0.0, 100)
    before = one.position.tobytes()
    bench.excite(other, 0.001, np.array([2.0]), 0.0, 100)
    again = bench.excite(third, 0.0, np.array([1.0, -1.0]), 0.0, 100)
    assert one.position.tobytes() == before == again.position.tobytes()
