"""Link to a serial port on systems other than Linux: through pyserial, read by a Python thread.

It is for a board that runs the law itself and needs a message from the host every few milliseconds
(`controller.supervise_lifetime_s`). A loop on the host is not fast enough on such a system and is refused
(`rig.experiments.trials.preparation.prepared_on`). `rig.devices` loads it for ``serial://``; Linux must use
`rig.devices.serial`.
"""

from __future__ import annotations

import errno
import os

import serial

from rig.core.errors import DeviceNotFoundError, LinkLostError, UnpluggedError
from rig.core.model import RigModel
from rig.devices._failures import error_number, link_error
from rig.devices._serial_options import SerialOptions, capacity
from rig.devices._threaded import WAIT_S, ThreadedLine
from rig.devices.device import DeviceUrl, RealLink
from rig.devices.port import LoopPort
from rig.devices.port_facts import PortFacts, port_facts, ports_in_words
from rig.realtime.clock import Clock, MonotonicClock

BUFFER_S = 0.1  # time for which the port may accept no bytes
FRAME_BYTES = 64


def open_link(url: DeviceUrl, model: RigModel | None = None) -> ThreadedSerialLink:
    """Open a serial port, like ``serial://COM3?baud=921600``; `ConfigError` or `DeviceNotFoundError` if it fails."""
    options = SerialOptions.of(url)
    port = serial.Serial(
        baudrate=options.baud,
        exclusive=True,
        timeout=WAIT_S,
        write_timeout=BUFFER_S + 20.0 * FRAME_BYTES / options.baud,  # Windows waits until the bytes have left
    )
    # Before the port opens. Windows drops both when it closes, which resets many boards.
    port.dtr = port.rts = options.dtr
    port.port = url.place
    try:
        port.open()
    except (OSError, ValueError) as error:  # a SerialException is an OSError
        raise _opening_error(url.place, error) from None
    return ThreadedSerialLink(url, port)


def _opening_error(place: str, error: Exception) -> DeviceNotFoundError:
    number, text = getattr(error, "errno", None), str(error)
    if number == errno.ENOENT or "FileNotFoundError" in text:
        return DeviceNotFoundError(
            f"there is no port {place}", remedy=f"plug the device in; {ports_in_words()}"
        )
    if number in (errno.EACCES, errno.EAGAIN, errno.EBUSY) or "PermissionError" in text or "lock" in text:
        return DeviceNotFoundError(f"{place} is in use by another program", remedy="close that program")
    return DeviceNotFoundError(
        f"cannot open {place}: {error}", remedy=f"plug the device in again; {ports_in_words()}"
    )


class ThreadedSerialLink(RealLink):
    """Link (`rig.devices.device.Link`) over an open port of pyserial, on systems other than Linux.

    Attributes
    ----------
    facts
        Driver, USB adapter and settings of the port.
    messages
        Always empty: warnings about settings that were not accepted, on other links.
    """

    messages: tuple[str, ...] = ()

    def __init__(self, url: DeviceUrl, port: serial.Serial) -> None:
        self.url = url
        self.clock: Clock = MonotonicClock()
        self.bytes_per_second = capacity(url.place, int(port.baudrate))
        self.facts: PortFacts = port_facts(url.place)
        port.reset_input_buffer()
        self._line: _Line | None = _Line(port)

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that the device has sent; wait at most `timeout_s` (s) for the first byte."""
        line = self._open()
        try:
            return line.read(timeout_s)
        except OSError as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Send all of `data`; raise `LinkLostError` if the port accepts no more bytes or is gone."""
        line = self._open()
        try:
            line.write(data)
        except OSError as error:
            raise self._lost(error) from error

    def port(self) -> LoopPort:
        """Return the Python callbacks with which the loop reads, writes and waits."""
        read, write, wait, handle = self._open().plugs()
        return LoopPort.on(self.clock, read=read, write=write, wait=wait, handle=handle)

    def close(self) -> None:
        """Release the serial port; a second call does nothing."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _open(self) -> _Line:
        if self._line is None:
            raise UnpluggedError(f"the link to {self.url.text} is closed", remedy="open the device again")
        return self._line

    def _lost(self, error: OSError) -> LinkLostError:
        return link_error(error_number(error), self.url.text, self.url.place)


class _Line(ThreadedLine):
    """Open serial port of pyserial, read by a thread. An error without errno means that the port is gone (ENODEV)."""

    def __init__(self, port: serial.Serial) -> None:
        super().__init__()
        self._port = port
        self.start()

    def receive(self) -> bytes:
        try:
            data: bytes = self._port.read(1)  # wait for the first byte, or for the timeout
            return data + self._port.read(self._port.in_waiting) if data else b""
        except (OSError, TypeError) as error:  # pyserial sets its port to None when it is closed
            raise OSError(getattr(error, "errno", None) or errno.ENODEV, os.strerror(errno.ENODEV)) from None

    def send(self, data: bytes) -> int:
        try:
            return int(self._port.write(data) or 0)
        except serial.SerialTimeoutException:
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except (OSError, TypeError) as error:
            raise OSError(getattr(error, "errno", None) or errno.ENODEV, os.strerror(errno.ENODEV)) from None

    def close(self) -> None:
        super().close()
        try:
            self._port.close()
        except OSError:
            return  # the adapter was unplugged
