"""Public names of this package for `rig firmware`: boards, and how to build, inspect, flash and test images.

This file defines nothing, and no file of this package imports it. Plans and exports import `tick_budget` and `cycles`
instead, so that they load no toolchain.
"""

from rig.firmware import _boards as boards
from rig.firmware._build import DEVICE, PORT_CHECK, BuildRequest, build
from rig.firmware._flash import flash
from rig.firmware._info import info
from rig.firmware._port_check import PortCheckRequest, check_port
from rig.firmware._port_check import failure as broken_duties
from rig.firmware._selftest import SelfTestRequest, failure, selftest
from rig.firmware._wiring import draw, wiring

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
