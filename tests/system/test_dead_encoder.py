"""An encoder that dies while the homing servo seeks the start of an automated trial: nobody holds the handle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.faults import Fault
from rig import config
from rig.config import presets
from rig.core.errors import DeviceFaultError
from rig.devices.fault_script import Faults, Happening
from rig.devices.framed import FramedDevice
from rig.experiments.hit import HitRequest, hit
from sim_backend.device import SimulatedDevice
from sim_backend.link import MemoryLink
from tests.benchmarks.pulses import Counting

DEAD: dict[str, Callable[[int], Callable[[int], int]]] = {
    "unplugged": lambda last: lambda true: last,
    "one channel": lambda last: lambda true: last + (true - last) // 2 % 2,
}


@pytest.mark.parametrize("dead", DEAD)
@pytest.mark.parametrize("name", presets.names())
def test_a_homing_servo_without_an_encoder_is_a_runaway_before_the_handle_is_fast(
    name: str, dead: str, tmp_path: Path
) -> None:
    """Its effort is far below what the rig may give: what it overcomes is friction, and that is what counts."""
    x = config.override(presets.load(name), {"rig.amplifier.current_monitor": False})
    device = SimulatedDevice(config.rig_model(x), initial_position=0.0)
    device.hardware.__class__ = Counting

    def die(device: SimulatedDevice) -> None:
        device.hardware.counts = DEAD[dead](device.hardware.count)  # type: ignore[attr-defined]

    link = MemoryLink(device, Faults(device=(Happening(5, die),)))
    with FramedDevice(link) as framed, pytest.raises(DeviceFaultError, match=Fault.RUNAWAY.text) as caught:
        tuple(hit(HitRequest(experiment=x, device=framed, output=tmp_path)))
    truth = device.truth()
    assert np.abs(truth["velocity_true"]).max() < x.rig.limits.speed
    assert np.abs(truth["position_true"]).max() < x.rig.limits.position_maximum
    assert device.current == 0
    assert caught.value.exit_code == 7
