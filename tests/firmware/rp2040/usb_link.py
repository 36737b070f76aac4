"""The emulated board's USB as a link of `rig`, in the board's time."""

import numpy as np

from rig.devices.device import DeviceUrl
from rig.realtime.clock import VirtualClock
from sim_backend.ends.far_end import ARRIVED, PROGRESS
from sim_backend.ends.link import BUFFER_BYTES, MemoryLink
from tests.firmware.rp2040.usb_line import UsbLine

URL = DeviceUrl("usb", "1209:0001", {}, "usb://1209:0001")


class EmulatedUsb(MemoryLink):
    """Link in virtual time to the emulated RP2040.

    The emulator advances only while the host writes or waits; bytes arrive when the emulated bus delivers them.
    """

    # Not super().__init__, which requires a simulated device in this process: it sets the fields that the inherited
    # methods read. Keep in step with MemoryLink.
    def __init__(self, line: UsbLine) -> None:
        self.url = URL
        self.clock = VirtualClock()
        self.line = None  # no script of faults
        self._usb = line
        self._began_ns = line.now_ns
        self._progress = np.zeros(PROGRESS, np.int64)
        self._arrived = np.zeros(BUFFER_BYTES, np.uint8)
        self._compiled = None
        self._failure: BaseException | None = None
        self._closed = False
        self._port = None

    def write(self, data: bytes) -> None:
        self._check_open()
        self._catch_up()
        self._usb.send(data)

    def truth(self) -> None:  # type: ignore[override]  # the emulated board has no plant
        return None

    def _catch_up(self) -> None:
        self._run(self.clock.now_ns(), first=False)

    def _wait(self, deadline_ns: int) -> bool:
        self._check_open()
        self._catch_up()
        if not self._progress[ARRIVED]:
            self._run(deadline_ns, first=True)
            self.clock.sleep_until(max(self.clock.now_ns(), min(deadline_ns, self._now_ns)))
        return bool(self._progress[ARRIVED])

    @property
    def _now_ns(self) -> int:
        return self._usb.now_ns - self._began_ns

    def _run(self, until_ns: int, *, first: bool) -> None:
        if until_ns > self._now_ns:
            microseconds = (until_ns - self._now_ns) * 1e-3
            self._buffer_for_host(self._usb.run(microseconds, first=first))
