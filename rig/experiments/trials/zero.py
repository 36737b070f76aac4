"""Count of position zero: the device's own reference, or the place where the operator has put the handle."""

from __future__ import annotations

from rig.config import Experiment
from rig.core.errors import DeviceRefusedError
from rig.devices.framed import FramedDevice

BY_INDEX = 2  # of `firmware_protocol.messages.Reference.zero`


def position_zero(device: FramedDevice, x: Experiment) -> int:
    """Count at position zero of an open device.

    A rig without an index has its handle at zero now, or is simulated, where count zero is it. One with an index has
    found its reference (`rig.experiments.motion.reference`) and keeps it until it restarts or loses counts.

    Raises
    ------
    DeviceRefusedError
        The experiment counts on an index that the device has not looked for since it started.
    """
    simulated = device.dictionary.simulated
    if not x.rig.reference.index:
        return 0 if simulated else device.count()
    if device.reference_count is None:
        held = device.reference()
        if held.zero == BY_INDEX:
            device.reference_count = held.reference_count
        elif simulated:
            return 0
        else:
            raise DeviceRefusedError(
                f"the position zero of {device.dictionary.device} is unknown: rig.reference.index is "
                "set, and the index has not been found since the device started or lost counts",
                remedy="`rig device reference` finds it; without an index (rig.reference.index = false, "
                'limit_switch = "none") position zero is the present position of the handle',
            )
    return device.reference_count
