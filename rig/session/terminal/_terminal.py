"""Take a terminal, and give it back as it was whatever happens: also by another process than took it.

The console takes it, the session's program gives it back if the console died.
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
    """Convert values of `as_plain` back for `termios.tcsetattr`."""
    timed = (termios.VMIN, termios.VTIME)  # numbers where lines are not wanted: the module takes both
    characters = [n if i in timed else bytes([n]) for i, n in enumerate(value[_CHARACTERS])]
    return [*value[:_CHARACTERS], characters]


def take(descriptor: int, before: list[Any]) -> bytes:
    """Switch to keys one by one, without echo; return what was typed earlier."""
    changed = [*before]
    # No ^S, which stops the output and so would hang the console.
    changed[_INPUT] &= ~(termios.IXON | termios.ICRNL)
    changed[_LOCAL] &= ~(termios.ICANON | termios.ECHO | termios.IEXTEN)
    # Keys one by one without echo (cbreak), but ^C stays the kernel's: it signals the session's program also when the
    # console hangs.
    changed[_LOCAL] |= termios.ISIG
    characters = [*before[_CHARACTERS]]
    # No ^Z and ^\: a suspended session would leave its loop to the heartbeat.
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
