"""Current and motion on the Pico (whole binary), with the simulation's plant on its pins."""

from collections.abc import Callable

import numpy as np
import pytest

from rig.config import override
from rig.config._derive import rig_model
from rig.config.presets import load
from sim_backend.mechanics.plant import DiscretePlant, advance
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.session import Session

Powered = Callable[..., Session]
PWM_PERIOD_US = 20.0
DUTY_STEP_A = emulator.FULL_SCALE_A / 2_500  # 125 MHz / 50 kHz
QUANTUM_A = 0.001


def test_the_pins_show_the_current_with_its_direction_and_the_monitor_what_flows(powered: Powered) -> None:
    session = powered()
    session.configure(position_rate=5_000)
    session.arm()
    for quanta in (500, -500, 37, -1, 0):
        session.host.command(quanta)
        session.listen(0.001)
        session.host.command(quanta)
        pwm = session.pico.ask("high", pin=emulator.PINS["pwm"], us=25 * PWM_PERIOD_US)
        width = emulator.FULL_SCALE_A * pwm["high"] / pwm["time"]
        assert width == pytest.approx(abs(quanta) * QUANTUM_A, abs=DUTY_STEP_A)
        session.host.command(quanta)
        direction = session.pico.ask("high", pin=emulator.PINS["pwm"] + 1, us=5 * PWM_PERIOD_US)
        assert direction["high"] == (pytest.approx(direction["time"]) if quanta < 0 else 0.0)
        session.listen(0.001)
        adc_step = 3.3 / 4096 / emulator.MONITOR_V_PER_A / QUANTUM_A
        measured = session.host.states[-1].current_measured
        assert measured == pytest.approx(quanta, abs=2.0 * adc_step + DUTY_STEP_A / QUANTUM_A)


@pytest.mark.parametrize("drive", ["current", "voltage"])
@pytest.mark.parametrize("lag_s", [1.09e-4, 0.0])
def test_the_plant_at_the_pins_is_the_simulation_s_own_to_the_bit(drive: str, lag_s: float) -> None:
    model = rig_model(
        override(load("koul-rigid"), {"rig.amplifier.drive": drive, "rig.amplifier.lag_s": lag_s})
    )
    plant = DiscretePlant.build(model, emulator.PLANT_STEP_S)
    random = np.random.default_rng(7)
    efforts = np.repeat(random.uniform(-2.0, 2.0, 40), 50)
    state = plant.at_rest(0.01)
    wanted = []
    for effort in efforts:
        advance(plant.arguments(state), effort, 0.0)
        wanted.append(state[:3].copy())
    states = emulator.plant_states(model, 0.01, efforts.tolist())
    assert np.array_equal(np.array(wanted), np.array(states))
