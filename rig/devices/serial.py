"""A serial port as a link: opened by pyserial, read and written through its descriptor.

pyserial finds, opens, configures and locks the port; the bytes then move by read(2), write(2) and ppoll(2),
which the compiled loop and Python share. Three traps are answered here: pyserial leaves VMIN at 0, so that
"nothing there" and "unplugged" look alike; an FTDI adapter waits 16 ms unless asked for low latency; and a
closing port drops DTR, which resets many boards.
"""

from __future__ import annotations

import errno
import os
import select
import termios
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import serial
from numpy.typing import NDArray

from rig.clock import Clock, MonotonicClock
from rig.devices.device import DeviceUrl, LoopPort
from rig.devices.failures import error_number, link_error
from rig.errors import ConfigError, DeviceNotFoundError, LinkLostError
from rig.model import RigModel

DEFAULT_BAUD = 921_600
OPTIONS = ("baud",)
WRITE_TIMEOUT_S = 0.5
CHUNK = 4096
_CFLAG, _CC = 2, 6  # places in the list that termios.tcgetattr returns


def open_link(url: DeviceUrl, model: RigModel | None = None) -> SerialLink:
    """Open ``serial:///dev/ttyACM0?baud=921600``; see `rig.devices.open_link` for what it raises."""
    unknown = set(url.options) - set(OPTIONS)
    if unknown:
        raise ConfigError(
            f"{url.text}: unknown option {sorted(unknown)[0]!r}",
            remedy=f"known options: {', '.join(OPTIONS)}",
        )
    text = url.options.get("baud", str(DEFAULT_BAUD))
    if not text.isdecimal() or not 300 <= int(text) <= 20_000_000:
        raise ConfigError(
            f"{url.text}: baud = {text!r} is not a rate", remedy="give bits per second, 300 to 20000000"
        )
    if not url.place:
        raise ConfigError(f"{url.text}: no port", remedy=f"name one, like serial:///dev/ttyACM0. {_ports()}")
    port = _open(url.place, int(text))
    try:
        return SerialLink(url, port)
    except termios.error as error:
        port.close()
        raise DeviceNotFoundError(f"{url.place} vanished: {error}", remedy=_ports()) from None


def _open(port: str, baud: int) -> serial.Serial:
    try:
        return serial.Serial(port, baudrate=baud, exclusive=True, timeout=0, write_timeout=WRITE_TIMEOUT_S)
    except serial.SerialException as error:
        number = error.errno
        if number == errno.EACCES:
            remedy = "join the group that owns it (usually: sudo usermod -aG dialout $USER) and log in again"
            raise DeviceNotFoundError(f"no permission to open {port}", remedy=remedy) from None
        if number in (errno.EAGAIN, errno.EBUSY) or "lock" in str(error):
            raise DeviceNotFoundError(
                f"{port} is in use by another program", remedy=f"close it (fuser {port} names it)"
            ) from None
        if number == errno.ENOENT or not Path(port).exists():
            raise DeviceNotFoundError(
                f"there is no port {port}", remedy=f"plug the device in. {_ports()}"
            ) from None
        raise DeviceNotFoundError(f"{port} does not open: {error}", remedy=_ports()) from None
    except (OSError, ValueError, termios.error) as error:
        raise DeviceNotFoundError(f"{port} is not a serial port: {error}", remedy=_ports()) from None


def _ports() -> str:
    found = [name for name, _ in available_ports()]
    return f"Ports here: {', '.join(found)}" if found else "No serial ports are here"


def available_ports() -> list[tuple[str, str]]:
    """Name and description of every serial port that pyserial finds and that has hardware behind it."""
    from serial.tools import list_ports  # noqa: PLC0415

    return [(p.device, p.description) for p in sorted(list_ports.comports()) if p.hwid != "n/a"]


class SerialLink:
    """`rig.devices.device.Link` over an open port."""

    def __init__(self, url: DeviceUrl, port: serial.Serial) -> None:
        self.url = url
        self.clock: Clock = MonotonicClock()
        self.bytes_per_second = _capacity(url.place, int(port.baudrate))
        self._port: serial.Serial | None = port
        self._descriptor: int = port.fileno()
        _configure(self._descriptor)
        with suppress(OSError, ValueError, NotImplementedError, AttributeError):
            port.set_low_latency_mode(True)  # FTDI: 1 ms instead of 16; others do not know the call
        with suppress(termios.error):
            port.reset_input_buffer()

    def read(self, timeout_s: float) -> bytes:
        """Return what has arrived, waiting at most `timeout_s` for the first byte."""
        try:
            ready, _, _ = select.select([self._descriptor], [], [], max(0.0, timeout_s))
            if not ready:
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
        """Send all of `data`, or raise `LinkLostError` when the line stays full or is gone."""
        deadline = time.monotonic() + WRITE_TIMEOUT_S
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._descriptor, view) :]
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise self._lost(TimeoutError("it takes no more bytes")) from None
                select.select([], [self._descriptor], [], 0.01)
            except (OSError, ValueError) as error:
                raise self._lost(error) from error

    def port(self) -> LoopPort:
        """Return the system calls of the loop on this descriptor."""
        from rig import system  # noqa: PLC0415  (numba only when a loop is built)

        return LoopPort.on(
            self.clock,
            read=system.descriptor_read,
            write=system.descriptor_write,
            wait=system.descriptor_wait,
            handle=self._descriptor,
        )

    def failure(self) -> BaseException | None:
        """Return None: a real far end keeps its failures to itself."""
        return None

    def truth(self) -> NDArray[np.void] | None:
        """Return None: nobody knows the truth of a real rig."""
        return None

    def close(self) -> None:
        """Release the port."""
        if self._port is not None:
            with suppress(OSError, termios.error):
                self._port.close()
            self._port = None
            self._descriptor = -1

    def _lost(self, error: BaseException | None) -> LinkLostError:
        number = errno.ENODEV if error is None or isinstance(error, ValueError) else error_number(error)
        return link_error(number, self.url.text, self.url.place)


def _capacity(port: str, baud: int) -> float | None:
    """Bytes per second each way; a pseudo-terminal and a USB CDC port do not care for the baud rate."""
    real = os.path.realpath(port)
    if real.startswith("/dev/pts/") or os.path.basename(real).startswith("ttyACM"):
        return None
    return baud / 10.0


def _configure(descriptor: int) -> None:
    """VMIN = 1, so that reading 0 bytes can only mean hang-up; HUPCL off, so that closing resets no board."""
    attributes = termios.tcgetattr(descriptor)
    attributes[_CC][termios.VMIN] = 1
    attributes[_CC][termios.VTIME] = 0
    attributes[_CFLAG] &= ~termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
