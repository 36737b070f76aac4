"""An encoder that dies while the homing servo of an automated trial runs: the free handle must not become fast."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.board import moved_mechanics
from rig.core.errors import DeviceFaultError, GuardError
from rig.core.model import RigModel
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.hits.admission import admit
from rig.experiments.hits.hit import HitRequest, hit
from rig.experiments.motion.pulse import pulse
from rig.experiments.trials._identify_motions import still
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.hardware import Hardware
from sim_backend.ends.link import MemoryLink
from tests.benchmarks.pulses import Counting, TickByTick
from tests.conformance.tiers import first_by_default

DEAD: dict[str, Callable[[int], Callable[[int], int]]] = {
    "unplugged": lambda last: lambda true: last,
    "one channel": lambda last: lambda true: last + (true - last) // 2 % 2,
}


@pytest.mark.parametrize("dead", DEAD)
@pytest.mark.parametrize("name", first_by_default(presets.names()))
def test_a_homing_servo_without_an_encoder_is_a_runaway_before_the_handle_is_fast(
    name: str, dead: str, tmp_path: Path
) -> None:
    """The servo's effort is far below the rig's limit but above friction, so the handle would accelerate unseen."""
    x = config.override(presets.load(name), {"rig.amplifier.current_monitor": False})
    device = SimulatedDevice(config.rig_model(x), initial_position=0.0)
    device.hardware.__class__ = Counting

    def die(device: SimulatedDevice) -> None:
        device.hardware.counts = DEAD[dead](device.hardware.count)  # type: ignore[attr-defined]

    link = MemoryLink(device, Faults(device=(Happening(5, die),)))
    with FramedDevice(link) as framed, pytest.raises(DeviceFaultError, match=Fault.RUNAWAY.text) as caught:
        tuple(hit(HitRequest(experiment=x, device=framed, output=tmp_path), admit))
    truth = device.truth()
    assert np.abs(truth["velocity_true"]).max() < x.rig.limits.speed
    assert np.abs(truth["position_true"]).max() < x.rig.limits.position_maximum
    assert device.current == 0
    assert caught.value.exit_code == 7


class SpeedLog(Counting):
    """A simulated hardware layer that records the largest speed of its handle (rad/s or m/s)."""

    fastest = 0.0

    def advance(self, current: int) -> None:
        super().advance(current)
        self.fastest = max(self.fastest, abs(self._state[self._plant.handle_position + 1]))


def device_with_speed_log(model: RigModel, loop: str) -> Any:
    """Return a device at rest, with its own law if `loop` is "device", that records the speed of its handle."""
    device: Any = SimulatedDevice(model) if loop == "host" else TickByTick(model)
    if loop == "device":
        device.stand_before(Hardware(model, 1000, seed=0, initial_position=0.0))
    device.hardware.__class__ = SpeedLog
    return device


@pytest.mark.parametrize("loop", ["host", "device"])
def test_a_servo_below_the_check_of_the_device_is_stopped_by_the_host(loop: str, tmp_path: Path) -> None:
    """The device's stall check tolerates this low effort; without the host only the timeout would end homing."""
    x = presets.load("hapkit")
    friction = moved_mechanics(config.rig_model(x)).friction
    x = config.override(x, {"homing.effort": friction + 0.04 * x.rig.limits.effort, "controller.loop": loop})
    model = config.rig_model(x)
    device = device_with_speed_log(model, loop)

    def die(device: Any) -> None:
        device.hardware.counts = DEAD["unplugged"](device.hardware.count)

    link = MemoryLink(device, Faults(device=(Happening(5, die),)))
    with (
        FramedDevice(link) as framed,
        pytest.raises(GuardError, match="encoder is dead or the handle is blocked"),
    ):
        tuple(hit(HitRequest(experiment=x, device=framed, output=tmp_path), admit))
    assert 0.0 < device.hardware.fastest < x.rig.limits.speed
    assert device.current == 0


@pytest.mark.parametrize(
    ("name", "loop", "dead"),
    first_by_default(
        [
            ("moteus-knob", "host", "one channel"),
            ("koul-rigid", "device", "one channel"),
            ("woodenhaptics", "device", "unplugged"),
            ("koul-rigid", "host", "unplugged"),
        ],
        2,
    ),
)
def test_a_torque_pulse_without_an_encoder_ends_before_the_handle_is_fast(
    name: str, loop: str, dead: str, tmp_path: Path
) -> None:
    """The device's own check is for large efforts only; the pulse must end without it, and no second push follows."""
    changes = {"rig.amplifier.current_monitor": False, "controller.loop": loop}
    x = config.override(presets.load(name), changes)
    model = config.rig_model(still(x))
    device = device_with_speed_log(model, loop)
    device.hardware.counts = DEAD[dead](device.hardware.count)
    with FramedDevice(MemoryLink(device, Faults())) as framed:
        found = pulse(framed, x, recording=tmp_path / "pulse.rigcap", verified=True, reference_count=0)
    assert not found.ok
    assert 0.0 < device.hardware.fastest < x.rig.limits.speed
    assert device.current == 0
