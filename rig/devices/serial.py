"""Link to a serial port on Linux: opened by pyserial, read and written through its descriptor.

pyserial finds, opens, configures and locks the port; the bytes then move by read(2), write(2) and poll(2), which the
compiled loop and Python share. Settings that could not be set are in `SerialLink.messages`, with their remedy.

`rig.devices` loads it for ``serial://`` on Linux, and the bus of the drives opens its adapters by it. It must not
change DTR or RTS to find something out: a board would reset.
"""

from __future__ import annotations

import errno
import os
import sys
import termios
from contextlib import suppress
from pathlib import Path
from shlex import quote

import serial

from rig.core.errors import DeviceNotFoundError
from rig.core.model import RigModel
from rig.devices import _tty as tty
from rig.devices._serial_options import SerialOptions, capacity
from rig.devices.device import DeviceUrl
from rig.devices.port_facts import PortFacts, is_pseudo, port_facts, ports_in_words

if sys.platform == "linux":
    from rig.devices.descriptor import CLOSED, WRITE_TIMEOUT_S, DescriptorLink

assert sys.platform == "linux"


def open_link(url: DeviceUrl, model: RigModel | None = None) -> SerialLink:
    """Open the serial port of a URL and return the link; raise `ConfigError` or `DeviceNotFoundError` if it fails."""
    options = SerialOptions.of(url)
    port = _open(url.place, options.baud)
    try:
        return SerialLink(url, port, dtr=options.dtr)
    except (termios.error, OSError) as error:
        port.close()
        raise DeviceNotFoundError(
            f"{url.place} was unplugged while it was opened: {error}",
            remedy=f"plug the device in again; {ports_in_words()}",
        ) from None
    except DeviceNotFoundError:
        port.close()
        raise


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
                f"{port} is in use by another program",
                remedy=f"close that program (fuser {quote(port)} shows it)",
            ) from None
        if number == errno.ENOENT or not Path(port).exists():
            raise DeviceNotFoundError(
                f"there is no port {port}", remedy=f"plug the device in; {ports_in_words()}"
            ) from None
        raise DeviceNotFoundError(
            f"cannot open {port}: {error}", remedy=f"plug the device in again; {ports_in_words()}"
        ) from None
    except (OSError, ValueError, termios.error) as error:
        raise DeviceNotFoundError(
            f"{port} is not a serial port: {error}", remedy=f"name a serial port; {ports_in_words()}"
        ) from None


class SerialLink(DescriptorLink):
    """Link (`rig.devices.device.Link`) over an open serial port.

    Attributes
    ----------
    facts
        Facts about the port after it was opened and set up.
    messages
        Settings that could not be set, one sentence each with its remedy.
    """

    def __init__(self, url: DeviceUrl, port: serial.Serial, *, dtr: bool = True) -> None:
        super().__init__(url, port.fileno())
        self.bytes_per_second = capacity(url.place, int(port.baudrate))
        self._port: serial.Serial | None = port
        self.facts, self.messages = _set_up(url.place, self._descriptor, dtr=dtr)
        with suppress(termios.error):
            port.reset_input_buffer()

    def close(self) -> None:
        """Release the serial port for other programs; a second call does nothing."""
        if self._port is not None:
            # Other settings stay as they are: restoring HUPCL would drop DTR and reset the board.
            tty.set_exclusive(self._descriptor, False)
            with suppress(OSError, termios.error):
                self._port.close()
            self._port = None
            self._descriptor = CLOSED


def _set_up(place: str, descriptor: int, *, dtr: bool) -> tuple[PortFacts, list[str]]:
    """Set up an open serial port and read its settings back; return facts, and a message for each failed setting.

    Raise `DeviceNotFoundError` if reads cannot distinguish silence from hang-up, `termios.error` if the port is gone.
    """
    tty.configure(descriptor)
    if not tty.blocks_for_a_byte(descriptor):
        raise DeviceNotFoundError(
            f"{place} does not accept the terminal setting VMIN = 1, by which a hang-up is detected",
            remedy="give a serial port or a pseudo-terminal",
        )
    device = os.path.realpath(place)
    # Another program would take bytes away: flock by pyserial, TIOCEXCL here. A pseudo-terminal's TIOCEXCL would
    # outlive a host that is killed.
    if not is_pseudo(device):
        tty.set_exclusive(descriptor, True)
    tty.set_low_latency(descriptor)
    # DTR and RTS are as the kernel asserts them at opening, and never move afterwards: a board would reset. A board
    # that they hold in reset is opened with ``?dtr=off``.
    asserted = tty.set_dtr_rts(descriptor, dtr)
    facts = port_facts(place, descriptor)
    messages = [problem.sentence for problem in facts.problems()]
    if asserted is not None and asserted != dtr:
        messages.append(f"{place}: DTR is {'on' if asserted else 'off'}, although it was set to the opposite")
    return facts, messages
