"""Options in the URL of a serial port, and the capacity of the line.

Both links to serial ports use it. It must not open a port.
"""

import os
from dataclasses import dataclass
from typing import Self

from rig.core.errors import ConfigError
from rig.devices.device import DeviceUrl
from rig.devices.port_facts import ports_in_words

DEFAULT_BAUD = 921_600
OPTIONS = ("baud", "dtr")


@dataclass(frozen=True, slots=True)
class SerialOptions:
    """Baud rate of a serial port (bits per second); `dtr` is True if DTR and RTS must be asserted when it is opened."""

    baud: int
    dtr: bool

    @classmethod
    def of(cls, url: DeviceUrl) -> Self:
        """Return the options in a URL like ``serial://PORT?baud=921600&dtr=on``; raise `ConfigError` if invalid."""
        url.allow(OPTIONS)
        text = url.options.get("baud", str(DEFAULT_BAUD))
        if not text.isdecimal() or not 300 <= int(text) <= 20_000_000:
            raise ConfigError(
                f"{url.text}: baud = {text!r} is not a baud rate",
                remedy="give bits per second, 300 to 20000000",
            )
        dtr = url.choice("dtr", ("on", "off"), "on")
        if not url.place:
            raise ConfigError(
                f"the URL {url.text} contains no serial port",
                remedy=f"write it like serial:///dev/ttyACM0; {ports_in_words()}",
            )
        return cls(int(text), dtr == "on")


def capacity(port: str, baud: int) -> float | None:
    """Return the bytes/s that a serial port carries in each direction; None if it ignores the baud rate (USB, pty)."""
    real = os.path.realpath(port)
    if real.startswith("/dev/pts/") or os.path.basename(real).startswith(
        ("ttyACM", "cu.usbmodem", "tty.usbmodem")
    ):
        return None
    return baud / 10.0
