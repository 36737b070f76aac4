"""The firmware's core does what every device must do."""

from __future__ import annotations

import ctypes

import pytest

from rig.core.model import RigModel
from sim_backend.firmware import FirmwareDevice
from sim_backend.link import MemoryLink
from tests.conformance.device import check_device
from tests.conformance.rigs import linear_rig, rotary_rig


@pytest.mark.parametrize("model", [rotary_rig(), linear_rig()], ids=["rotary", "linear"])
def test_the_core_conforms(library: ctypes.CDLL, model: RigModel) -> None:
    check_device(lambda: MemoryLink(FirmwareDevice(model, library=library)))
