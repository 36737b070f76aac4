"""Link that reads and writes an open file descriptor by read(2), write(2) and poll(2), on Linux.

Serial ports, the local socket of a simulated device and the bridge of drives (firmware on this computer in front of a
drive) inherit from it. It must not open a descriptor: a subclass does.
"""

import errno
import math
import os
import select
import sys
import time

from rig.core.errors import LinkLostError
from rig.devices._failures import error_number, link_error
from rig.devices.device import DeviceUrl, RealLink
from rig.devices.port import LoopPort
from rig.realtime import system
from rig.realtime.clock import Clock, MonotonicClock

assert sys.platform == "linux"

WRITE_TIMEOUT_S = 0.5
CHUNK = 4096
FULL_PAUSE_MS = 10  # between two looks at a line that takes nothing
CLOSED = -1


class DescriptorLink(RealLink):
    """Base of links over a non-blocking file descriptor, which a subclass opens, closes and then sets to `CLOSED`."""

    def __init__(self, url: DeviceUrl, descriptor: int) -> None:
        self.url = url
        self.clock: Clock = MonotonicClock()
        self._descriptor = descriptor
        self._readable, self._writable = select.poll(), select.poll()  # select(2) ends at descriptor 1023
        self._readable.register(descriptor, select.POLLIN)
        self._writable.register(descriptor, select.POLLOUT)

    def read(self, timeout_s: float) -> bytes:
        """Return the device's bytes; wait at most `timeout_s` (s) for the first; `LinkLostError` if it is gone."""
        if self._descriptor == CLOSED:
            raise self._lost(None)
        try:
            if not self._readable.poll(max(0, math.ceil(timeout_s * 1e3))):
                return b""
            data = os.read(self._descriptor, CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(None)
        return data

    def write(self, data: bytes) -> None:
        """Send all of `data`; raise `LinkLostError` if the device is gone, or has not accepted all within 0.5 s."""
        deadline = time.monotonic() + WRITE_TIMEOUT_S
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._descriptor, view) :]
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise self._lost(TimeoutError("the line accepts no more bytes")) from None
                self._writable.poll(FULL_PAUSE_MS)
            except (OSError, ValueError) as error:
                raise self._lost(error) from error

    def port(self) -> LoopPort:
        """Return the compiled functions with which the loop reads and writes this descriptor."""
        return LoopPort.on(
            self.clock,
            read=system.descriptor_read,
            write=system.descriptor_write,
            wait=system.descriptor_wait,
            handle=self._descriptor,
        )

    def _lost(self, error: BaseException | None) -> LinkLostError:
        number = errno.ENODEV if error is None or isinstance(error, ValueError) else error_number(error)
        return link_error(number, self.url.text, self.url.place)
