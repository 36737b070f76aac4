"""Error class, cause and remedy of a failed link, by error number (errno).

The table serves serial ports and USB, calls from Python and the compiled loop, which can report only a number. All
links use it. It must not raise the error itself: the caller does.
"""

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
    EREMOTEIO = 121  # the errno of Linux; other systems do not define it


@dataclass(frozen=True, slots=True)
class Failure:
    """Error class of a failed link, its cause (text that follows the name of the link), and its remedy."""

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
    "corrupts bits in transit",
    "use another cable and port, without a hub, and keep the cable away from the motor cable",
)
FAILURES: dict[int, Failure] = {
    errno.ENODEV: _UNPLUGGED,
    errno.ENXIO: _UNPLUGGED,
    errno.ESHUTDOWN: _UNPLUGGED,
    errno.EPIPE: Failure(
        StalledError,
        "is stalled by the device",
        "start again, which clears the stall; if this happens again, update the firmware",
    ),
    errno.ETIMEDOUT: Failure(
        BlockedError,
        "accepts no more bytes",
        "restart the device, whose firmware does not read its input",
    ),
    errno.EOVERFLOW: Failure(
        OverflowedError,
        "sent more bytes than were requested",
        "update the firmware: it sends packets above the size in its descriptor",
    ),
    EREMOTEIO: Failure(
        CutShortError,
        "accepted only a part of the bytes that were sent",
        "start again; if this happens again, update the firmware",
    ),
    errno.EPROTO: _BROKEN,
    errno.EILSEQ: _BROKEN,
    errno.EIO: _BROKEN,
}
# Descriptors have no error for "unplugged": a terminal whose device is gone gives EIO, and so does ppoll here.
_DESCRIPTORS = ("serial:", "unix:")
_OF_DESCRIPTORS = FAILURES | dict.fromkeys((errno.EIO, errno.EPIPE, errno.ECONNRESET), _UNPLUGGED)


def failure(number: int, url: str) -> Failure:
    """Return error class, cause and remedy for a failed call on the link at a URL, by its errno (0: unknown)."""
    table = _OF_DESCRIPTORS if url.startswith(_DESCRIPTORS) else FAILURES
    found = table.get(number)
    if found is not None:
        return found
    why = os.strerror(number) if number else "no error number"
    return Failure(LinkLostError, f"failed ({why})", "check cable and power, then start again")


def link_error(number: int, url: str, place: str = "") -> LinkLostError:
    """Return the exception for a failed call on a link, from its errno; the text begins with `place`, else the URL."""
    found = failure(number, url)
    why = f" ({os.strerror(number)})" if number else ""
    return found.kind(f"{place or url} {found.cause}{why}", remedy=found.remedy)


def error_number(error: BaseException) -> int:
    """Return the errno of a link's exception; without one, ETIMEDOUT for a timeout and EIO for any other."""
    number = getattr(error, "errno", None)
    if isinstance(number, int) and number:
        return number
    return errno.ETIMEDOUT if isinstance(error, TimeoutError) else errno.EIO
