"""Serve a simulated rig on a serial port to test programs in any language, and read how they left the device.

The fixture ``rig_serial`` returns it. It must not open the port while the program under test uses it.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from firmware_protocol.connection import State
from firmware_protocol.messages import Statistics
from rig import config, devices
from rig.config import Experiment
from rig.core.errors import LinkLostError
from rig.devices.framed import FaultReport
from rig.devices.local import serve_locally

LOOK_S = 0.1
PATIENCE_S = 5.0


@dataclass(frozen=True, slots=True)
class Did:
    """State of a simulated device after the program under test has closed its port.

    Attributes
    ----------
    state
        State in which the program left the device: ``CONFIGURED`` after a DISARM, ``FAULT`` after silence.
    current
        Active current (quanta).
    fault
        Latched fault, or the last logged fault after a DISARM; its code is 0 if there was no fault.
    statistics
        Numbers of frames that the device accepted, lost and discarded since it started.
    """

    state: State
    current: int
    fault: FaultReport
    statistics: Statistics


@dataclass(frozen=True, slots=True)
class SerialRig:
    """A simulated rig in real time, in a separate process that ends with the test.

    Attributes
    ----------
    path
        Path of the serial port, for the program under test.
    url
        URL of the port for ``rig`` commands: ``serial://`` and the path.
    experiment
        Experiment whose rig is simulated.
    """

    path: str
    url: str
    experiment: Experiment

    def did(self) -> Did:
        """Return the state of the device after the program has closed the port.

        On a busy computer a device that has just lost its host may reply late to the next host, so the function retries
        for `PATIENCE_S` (5 s). Raise `rig.RigError` if another program still uses the port, or if there is no reply.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self._read_state()
            except LinkLostError:
                if time.monotonic() > deadline:
                    raise

    def _read_state(self) -> Did:
        with devices.open_device(self.url) as device:
            states = device.states(LOOK_S)
            if not states:
                raise LinkLostError(
                    f"no data from the rig at {self.path}", remedy="check that its process still runs"
                )
            newest = states[-1]
            return Did(
                State(newest.state), newest.current_commanded, device.fault_report(), device.statistics()
            )


@contextmanager
def serve_rig(experiment: Experiment, *, firmware: bool = False) -> Iterator[SerialRig]:
    """Serve the rig of an experiment behind a pseudo-terminal until the `with` block ends.

    With `firmware`, the simulated device can run the law itself. Raise `DeviceNotFoundError` if it does not start, or
    `PlanError` if the system is not Linux.
    """
    url = f"sim://{'?firmware=1' if firmware else ''}"
    with serve_locally(url, config.rig_model(experiment), terminal=True) as served:
        yield SerialRig(served.removeprefix("serial://"), served, experiment)
