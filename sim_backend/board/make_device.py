"""Choose the device that stands for a simulated rig: the firmware's C code, or the readable one without a compiler.

Links and servers call it. Both devices send the same bytes (tests/firmware/test_core_equals_the_simulated_device.py).
"""

from __future__ import annotations

from typing import Any

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import LAWS, FirmwareDevice
from sim_backend.board.firmware_library import library


def make_device(
    model: RigModel, firmware: bool | None, **options: Any
) -> tuple[SimulatedDevice | FirmwareDevice, tuple[str, ...]]:
    """Make the device that stands for a rig, and say what could not be had, with its remedy.

    Parameters
    ----------
    model
        The rig.
    firmware
        True: the firmware with its laws. False: the readable device. None: the firmware without its laws, or the
        readable device where this machine cannot compile it.
    options
        Those of `SimulatedDevice`.

    Raises
    ------
    ConfigError
        As the devices do; with `firmware` = True also where it cannot be compiled.
    """
    if firmware is False:
        return SimulatedDevice(model, **options), ()
    try:
        compiled = library()
    except ConfigError as error:
        if firmware:
            raise ConfigError(
                error.message, remedy=f'{error.remedy}; or set controller.loop = "host"'
            ) from None
        # Measured: a tick of the firmware takes 1 µs, of the readable device 51 µs
        # (tests/benchmarks/test_byte_link.py).
        slow = f"{error.message}; the simulated device runs in Python instead, 50 times slower"
        return SimulatedDevice(model, **options), (f"{slow}: {error.remedy}",)
    return FirmwareDevice(model, law_maximum=LAWS if firmware else 0, library=compiled, **options), ()
