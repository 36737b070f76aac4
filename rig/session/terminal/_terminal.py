"""Set a terminal to single keys without echo, and restore its settings, also from another process.

The console changes the settings; the session's process restores them if the console died. Only these functions change
the settings of the operator's terminal.
"""

import os
import select
import sys
import termios
from contextlib import suppress
from typing import Any

assert sys.platform != "win32"

_OFF = b"\0"  # _POSIX_VDISABLE of Linux
# Indices in the list that `termios.tcgetattr` returns.
_INPUT, _LOCAL, _CHARACTERS = 0, 3, 6


def as_plain(before: list[Any]) -> list[Any]:
    """Convert terminal settings from `termios.tcgetattr` to numbers and lists for JSON."""
    return [
        *before[:_CHARACTERS],
        [value if isinstance(value, int) else value[0] for value in before[_CHARACTERS]],
    ]


def from_plain(value: list[Any]) -> list[Any]:
    """Convert terminal settings from numbers and lists back to the form that `termios.tcsetattr` accepts."""
    # The termios module reads and writes these two entries as numbers outside of line mode.
    timed = (termios.VMIN, termios.VTIME)
    characters = [n if i in timed else bytes([n]) for i, n in enumerate(value[_CHARACTERS])]
    return [*value[:_CHARACTERS], characters]


def take(descriptor: int, before: list[Any]) -> bytes:
    """Switch a terminal, whose settings are `before`, to single keys without echo; return bytes typed earlier."""
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
    """Restore the terminal's settings and discard unread input; never raise an exception or wait for blocked output."""
    with suppress(OSError, termios.error):
        termios.tcflush(descriptor, termios.TCIFLUSH)
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
