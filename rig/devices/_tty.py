"""Read and change settings of a serial line by its descriptor; None means that the line does not have the setting.

The serial links and `rig.devices.port_facts` use it. It must not open or close a line.
"""

from __future__ import annotations

import fcntl
import os
import struct
import sys
import termios
from array import array
from contextlib import suppress

assert sys.platform == "linux"

# linux/tty_flags.h and linux/serial.h; `flags` is the fifth int of struct serial_struct, which is 72 bytes long
ASYNC_LOW_LATENCY = 1 << 13
_SERIAL_INTS, _FLAGS = 32, 4
# asm-generic/ioctls.h. Architectures with other numbers refuse the call: not known.
_TIOCGEXCL = 0x80045440
_CFLAG, _CC = 2, 6  # places in the list that termios.tcgetattr returns
_DTR_RTS = termios.TIOCM_DTR | termios.TIOCM_RTS


def _serial_struct(descriptor: int) -> array[int] | None:
    settings = array("i", [0] * _SERIAL_INTS)
    try:
        fcntl.ioctl(descriptor, termios.TIOCGSERIAL, settings)
    except OSError:
        return None
    return settings


def low_latency(descriptor: int) -> bool | None:
    """Return True if the serial driver passes received bytes on at once; None if it has no such setting."""
    settings = _serial_struct(descriptor)
    return None if settings is None else bool(settings[_FLAGS] & ASYNC_LOW_LATENCY)


def set_low_latency(descriptor: int) -> bool | None:
    """Set the serial driver to pass received bytes on at once; return the setting that it reports afterwards."""
    settings = _serial_struct(descriptor)
    if settings is None:
        return None
    # An FTDI adapter waits up to 16 ms for more bytes otherwise. Read back: a driver may accept this and do nothing.
    settings[_FLAGS] |= ASYNC_LOW_LATENCY
    with suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCSSERIAL, settings)
    return low_latency(descriptor)


def is_exclusive(descriptor: int) -> bool | None:
    """Return True if the kernel refuses the line to other programs (except root's); None if it does not report this."""
    answer = bytearray(struct.calcsize("i"))
    try:
        fcntl.ioctl(descriptor, _TIOCGEXCL, answer)
    except OSError:
        return None
    return int.from_bytes(answer, sys.byteorder) != 0


def set_exclusive(descriptor: int, wanted: bool) -> bool | None:
    """Refuse the line to other programs if `wanted`, else allow them; return the setting as reported afterwards."""
    with suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCEXCL if wanted else termios.TIOCNXCL)
    return is_exclusive(descriptor)


def dtr(descriptor: int) -> bool | None:
    """Return True if the modem line DTR is asserted; None if the line has no DTR."""
    lines = bytearray(struct.calcsize("i"))
    try:
        fcntl.ioctl(descriptor, termios.TIOCMGET, lines)
    except OSError:
        return None
    return bool(int.from_bytes(lines, sys.byteorder) & termios.TIOCM_DTR)


def set_dtr_rts(descriptor: int, asserted: bool) -> bool | None:
    """Set DTR and RTS in one call, so that they change at the same time; return the state of DTR afterwards."""
    request = termios.TIOCMBIS if asserted else termios.TIOCMBIC
    with suppress(OSError):
        fcntl.ioctl(descriptor, request, struct.pack("i", _DTR_RTS))
    return dtr(descriptor)


def hangs_up(descriptor: int) -> bool:
    """Return True if closing the serial line drops DTR."""
    return bool(termios.tcgetattr(descriptor)[_CFLAG] & termios.HUPCL)


def blocks_for_a_byte(descriptor: int) -> bool:
    """Return True if the serial line has VMIN = 1, VTIME = 0, so that reading 0 bytes can only mean a hang-up."""
    characters = termios.tcgetattr(descriptor)[_CC]
    return _number(characters[termios.VMIN]) == 1 and _number(characters[termios.VTIME]) == 0


def _number(character: int | bytes) -> int:
    """Return a control character of termios as a number; termios gives a byte, or a number when the line is raw."""
    return character if isinstance(character, int) else character[0]


def configure(descriptor: int) -> None:
    """Set a serial line to VMIN = 1, VTIME = 0, HUPCL off, non-blocking; raise `termios.error` if it is gone."""
    attributes = termios.tcgetattr(descriptor)
    # pyserial leaves VMIN at 0, where "nothing available" and "unplugged" both read 0 bytes.
    attributes[_CC][termios.VMIN] = 1
    attributes[_CC][termios.VTIME] = 0
    # A closing port drops DTR with HUPCL, which resets many boards.
    attributes[_CFLAG] &= ~termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    os.set_blocking(descriptor, False)
