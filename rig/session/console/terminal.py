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

# Alternate screen, cursor; mouse reports (any motion, SGR, pixels).
SCREEN_ON = "\x1b[?1049h\x1b[?25l"
SCREEN_OFF = "\x1b[?1049l\x1b[?25h"
MOUSE_ON = "\x1b[?1003h\x1b[?1006h"
PIXELS_ON, ASK_PIXELS = "\x1b[?1016h", "\x1b[?1016$p"
MOUSE_OFF = "\x1b[?1016l\x1b[?1006l\x1b[?1003l"
STYLE_OFF = "\x1b[0m"
PIXELS = 1016

_OFF = b"\0"  # _POSIX_VDISABLE of Linux
_INPUT, _LOCAL, _CHARACTERS = 0, 3, 6  # places in what tcgetattr gives


def is_terminal(descriptor: int) -> bool:
    """Whether there is a terminal behind a descriptor."""
    try:
        return os.isatty(descriptor)
    except OSError:
        return False


def attributes(descriptor: int) -> list[Any] | None:
    """How a terminal is set; None when it is gone, or none."""
    try:
        return termios.tcgetattr(descriptor)
    except (termios.error, OSError):
        return None


def as_plain(before: list[Any]) -> list[Any]:
    """What `attributes` gave, as plain values for JSON."""
    return [
        *before[:_CHARACTERS],
        [value if isinstance(value, int) else value[0] for value in before[_CHARACTERS]],
    ]


def from_plain(value: list[Any]) -> list[Any]:
    """What `as_plain` was given."""
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


def give_back(descriptor: int, before: list[Any], *, screen: bool) -> None:
    """Set it as it was; what was typed and not read goes to nobody. Cannot raise, nor wait for output that hangs."""
    with suppress(OSError, termios.error):
        termios.tcflush(descriptor, termios.TCIFLUSH)
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
    with suppress(OSError):
        os.write(descriptor, (MOUSE_OFF + (SCREEN_OFF if screen else "") + STYLE_OFF).encode())
