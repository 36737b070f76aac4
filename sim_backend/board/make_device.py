"""Choose the device of a simulated rig: the compiled firmware or, without a C compiler, the device in Python.

Both devices send the same bytes (tests/firmware/test_core_equals_the_simulated_device.py). Links in virtual and in real
time call it. It must not run the device.
"""

from typing import Any

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from sim_backend.board.device import SimulatedDevice
from sim_backend.board.firmware import LAWS, FirmwareDevice
from sim_backend.board.firmware_library import library


def make_device(
    model: RigModel, firmware: bool | None, **options: Any
) -> tuple[SimulatedDevice | FirmwareDevice, tuple[str, ...]]:
    """Return the device that simulates a rig, and messages about its restrictions, each with a remedy.

    Raise `ConfigError` if an argument is out of range, or `firmware` is True and the firmware cannot be compiled.

    Parameters
    ----------
    model
        Rig to simulate.
    firmware
        True: compiled firmware that can run the law. False: device in Python. None: compiled firmware that runs no law,
        or the device in Python if this computer cannot compile the firmware.
    options
        Further arguments of `SimulatedDevice`.
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
