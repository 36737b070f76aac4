r"""How a terminal is taken, and given back as it was whatever happens: also by another process than took it.

Keys come one by one and without echo (cbreak), but ^C stays the kernel's: it signals the session's program also when
the console hangs. ^Z and ^\ are off, since a session that is suspended would leave its loop to the heartbeat, and ^S,
which stops the output and so would hang the console.
"""

from __future__ import annotations

import os
import select
import sys
import termios
from contextlib import suppress
from typing import Any

assert sys.platform != "win32"

_OFF = b"\0"  # _POSIX_VDISABLE of Linux
_INPUT, _LOCAL, _CHARACTERS = 0, 3, 6  # places in what tcgetattr gives


def as_plain(before: list[Any]) -> list[Any]:
    """Convert the result of `termios.tcgetattr` to plain values for JSON."""
    return [
        *before[:_CHARACTERS],
        [value if isinstance(value, int) else value[0] for value in before[_CHARACTERS]],
    ]


def from_plain(value: list[Any]) -> list[Any]:
    """Invert `as_plain`."""
    timed = (termios.VMIN, termios.VTIME)  # numbers where lines are not wanted: the module takes both
    characters = [n if i in timed else bytes([n]) for i, n in enumerate(value[_CHARACTERS])]
    return [*value[:_CHARACTERS], characters]


def take(descriptor: int, before: list[Any]) -> bytes:
    """Keys one by one, without echo; returns what was typed earlier."""
    changed = [*before]
    changed[_INPUT] &= ~(termios.IXON | termios.ICRNL)
    changed[_LOCAL] &= ~(termios.ICANON | termios.ECHO | termios.IEXTEN)
    changed[_LOCAL] |= termios.ISIG
    characters = [*before[_CHARACTERS]]
    for name in (termios.VSUSP, termios.VQUIT):
        characters[name] = _OFF
    characters[termios.VMIN], characters[termios.VTIME] = 1, 0
    changed[_CHARACTERS] = characters
    termios.tcsetattr(descriptor, termios.TCSANOW, changed)
    ready, _, _ = select.select([descriptor], [], [], 0.0)
    return os.read(descriptor, 4096) if ready else b""


def give_back(descriptor: int, before: list[Any]) -> None:
    """Set it as it was; discard what was typed and not read. Cannot raise, nor wait for output that hangs."""
    with suppress(OSError, termios.error):
        termios.tcflush(descriptor, termios.TCIFLUSH)
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
