"""The self test on this computer's build of the firmware: its law runs, no sample is missing, nothing moves."""

from contextlib import closing
from pathlib import Path

import numpy as np

from rig import config
from rig.config import presets
from rig.devices.framed import FramedDevice
from rig.firmware._selftest import SelfTestRequest, selftest
from tests.firmware.mps2.lockstep import Rig, on_this_computer

EXPERIMENT = presets.load("koul-rigid")


def test_the_firmware_passes_its_own_self_test_and_nothing_moves(tmp_path: Path) -> None:
    model = config.rig_model(EXPERIMENT)
    with closing(on_this_computer(model, "mps2-an386", tmp_path)) as partner:
        check_self_test(Rig(partner, model))


def check_self_test(rig: Rig) -> None:
    device = FramedDevice(rig)
    before = device.active_parameters()
    request = SelfTestRequest(experiment=EXPERIMENT, rate=20_000, seconds=0.25, stream=True)
    found = {check.name: check for check in selftest(device, request).checks}
    assert [check for check in found.values() if check.outcome == "refused"] == []
    assert found["stream"].outcome == "ok", found["stream"].text
    assert "0 gaps; no current" in found["stream"].text
    assert found["rig"].outcome == "ok"
    assert np.ptp(rig.trace["count"]) == 0
    assert not rig.trace["current"].any()
    assert rig.trace["enabled"].any(), "it was never armed"
    assert device.active_parameters() == before
