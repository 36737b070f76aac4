"""Prepare a run on an open device, and find the encoder count at its position zero.

Hits, motions, searches for a reference and sessions call this module with a device that they have opened. It only reads
from the device: it must not move the handle or change a setting.
"""

from rig.config import Experiment, controller
from rig.config.prepared_run import PreparedRun
from rig.control.laws import Law
from rig.core.errors import DeviceRefusedError
from rig.core.this_system import refuse_real_time
from rig.devices.framed import FramedDevice

BY_INDEX = 2  # of `firmware_protocol.messages.Reference.zero`


def prepared_on(
    device: FramedDevice,
    experiment: Experiment,
    *,
    verified: bool = False,
    reference_count: int = 0,
    law: Law | None = None,
) -> PreparedRun:
    """Return the run of an experiment, prepared for an open device.

    `verified` is True if the operator has checked the signs of motor and encoder. `reference_count` is the encoder
    count at position zero; the run is marked if the device found this count by the encoder's index. `law` replaces the
    experiment's law. Raise `PlanError` if this computer would have to run the law in real time, but its system cannot.
    """
    if experiment.controller.loop == "host" and not device.link.clock.virtual:
        if law is None:
            refuse_real_time('controller.loop = "host"')
        else:
            refuse_real_time("a motion or law that boards do not have", "do this on a Linux computer")
    return controller.prepare_controller(
        experiment,
        current_quantum_a=device.dictionary.current_quantum_a,
        verified=verified,
        reference_count=reference_count,
        referenced=device.reference_count == reference_count,
        law=law,
    )


def position_zero(device: FramedDevice, experiment: Experiment) -> int:
    """Return the encoder count at position zero of an open device.

    Without an index the result is the present count, because the handle must be at position zero now; 0 for a simulated
    rig. With an index it is the reference count that `rig.experiments.motion.reference` found; the device stores this
    count until it restarts or loses counts.

    Raises
    ------
    DeviceRefusedError
        The experiment uses an index, and the device has not found the index since the device started.
    """
    simulated = device.dictionary.simulated
    if not experiment.rig.reference.index:
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
