"""Interface of this room for `rig firmware`: boards, and images that are built, inspected, flashed and tested.

It defines nothing, and no file of the room imports it. What a law costs on a board is in `tick_budget` and `cycles`:
plans and exports load no toolchain.
"""

from rig.firmware import boards
from rig.firmware.build import DEVICE, PORT_CHECK, BuildRequest, build
from rig.firmware.flash import flash
from rig.firmware.info import info
from rig.firmware.port_check import PortCheckRequest, check_port
from rig.firmware.port_check import failure as broken_duties
from rig.firmware.selftest import SelfTestRequest, failure, selftest
from rig.firmware.wiring import draw, wiring

__all__ = [
    "DEVICE",
    "PORT_CHECK",
    "BuildRequest",
    "PortCheckRequest",
    "SelfTestRequest",
    "boards",
    "broken_duties",
    "build",
    "check_port",
    "draw",
    "failure",
    "flash",
    "info",
    "selftest",
    "wiring",
]
