"""What an error number of a link means: the error that a user reads, with its cause and its remedy.

One table for serial ports and USB, for Python's calls and for the compiled loop, which can only leave a number
behind.
"""

from __future__ import annotations

import errno
import os
import sys
from dataclasses import dataclass

from rig.core.errors import (
    BlockedError,
    BrokenLineError,
    CutShortError,
    LinkLostError,
    OverflowedError,
    StalledError,
    UnpluggedError,
)

if sys.platform == "linux":
    EREMOTEIO = errno.EREMOTEIO
else:
    EREMOTEIO = 121  # which has no name elsewhere


@dataclass(frozen=True, slots=True)
class Failure:
    """Kind of error, what happened, to follow "the link …", and what to do."""

    kind: type[LinkLostError]
    cause: str
    remedy: str


_UNPLUGGED = Failure(
    UnpluggedError,
    "is gone: unplugged, or without power",
    "check cable and power, then start again; the device cuts the effort by itself",
)
_BROKEN = Failure(
    BrokenLineError,
    "damages bits on the way",
    "take another cable and port, without a hub, and keep the cable away from the motor's",
)
FAILURES: dict[int, Failure] = {
    errno.ENODEV: _UNPLUGGED,
    errno.ENXIO: _UNPLUGGED,
    errno.ESHUTDOWN: _UNPLUGGED,
    errno.EPIPE: Failure(
        StalledError,
        "is stalled by the device",
        "start again, which clears the halt; if it comes back, update the firmware",
    ),
    errno.ETIMEDOUT: Failure(
        BlockedError,
        "takes no more bytes",
        "the firmware does not read: restart the device",
    ),
    errno.EOVERFLOW: Failure(
        OverflowedError,
        "sent more than was asked for",
        "update the firmware: it sends packets above the size in its descriptor",
    ),
    EREMOTEIO: Failure(
        CutShortError,
        "took only a part of what was sent",
        "start again; if it comes back, update the firmware",
    ),
    errno.EPROTO: _BROKEN,
    errno.EILSEQ: _BROKEN,
    errno.EIO: _BROKEN,
}
# Descriptors have no error for "unplugged": a terminal whose device is gone gives EIO, and so does ppoll here.
_DESCRIPTORS = ("serial:", "unix:")
_OF_DESCRIPTORS = FAILURES | dict.fromkeys((errno.EIO, errno.EPIPE, errno.ECONNRESET), _UNPLUGGED)


def failure(number: int, url: str) -> Failure:
    """Return what an error number (positive errno) means on the link behind a URL.

    Numbers that are not in the table keep the kernel's text.
    """
    table = _OF_DESCRIPTORS if url.startswith(_DESCRIPTORS) else FAILURES
    found = table.get(number)
    if found is not None:
        return found
    why = os.strerror(number) if number else "no error number"
    return Failure(LinkLostError, f"failed ({why})", "check cable and power, then start again")


def link_error(number: int, url: str, place: str = "") -> LinkLostError:
    """Make the error for a call on a link that failed with `number`; `place` is the name to show, else the URL."""
    found = failure(number, url)
    why = f" ({os.strerror(number)})" if number else ""
    return found.kind(f"{place or url} {found.cause}{why}", remedy=found.remedy)


def error_number(error: BaseException) -> int:
    """Return the errno of an exception of a link; a time-out without one is ETIMEDOUT, anything else EIO."""
    number = getattr(error, "errno", None)
    if isinstance(number, int) and number:
        return number
    return errno.ETIMEDOUT if isinstance(error, TimeoutError) else errno.EIO
