"""Make functions for the compiled loop that call Python, for simulations and for links without compiled functions.

Threaded devices and simulations in memory use them. A device in real time must not: each call takes the GIL.
"""

import ctypes
import errno
from collections.abc import Callable
from typing import Any, NamedTuple

from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction

_TRANSFER = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_WAIT = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)


class CallbackPlugs(NamedTuple):
    """Functions by which the compiled loop reads, writes and waits on a link; `handle` is their unused argument."""

    read: NativeFunction
    write: NativeFunction
    wait: NativeFunction
    handle: int = 0


def callback_plugs(
    *,
    read: Callable[[int], bytes],
    write: Callable[[bytes], int | None],
    wait: Callable[[int], bool],
    failed: Callable[[BaseException], object] = lambda failure: None,
) -> CallbackPlugs:
    """Return read, write and wait functions of a link for the compiled loop that call the given Python functions.

    Parameters
    ----------
    read
        Function ``read(limit)`` that returns the available bytes, at most `limit`.
    write
        Function ``write(data)`` that sends bytes and returns the number of accepted bytes; None means all.
    wait
        Function ``wait(deadline_ns)`` that waits for input until a time of the link's clock (ns) and returns True if
        input is available.
    failed
        Function that receives an exception of `read`, `write` or `wait`. The loop gets only the exception's negative
        errno, or -EIO if the exception has no errno.
    """

    def native(kind: Any, function: Callable[..., int], signature: Any) -> NativeFunction:
        def guarded(*arguments: int) -> int:
            try:
                return function(*arguments)
            # Also KeyboardInterrupt: an exception must not pass through compiled frames, which would print and drop it.
            except BaseException as failure:
                failed(failure)
                return -((failure.errno if isinstance(failure, OSError) else None) or errno.EIO)

        callback = kind(guarded)
        address = ctypes.cast(callback, ctypes.c_void_p).value
        assert address is not None
        return NativeFunction(address, signature, keep=callback)

    def into(_handle: int, address: int, size: int) -> int:
        data = read(size)
        ctypes.memmove(address, data, len(data))
        return len(data)

    def out_of(_handle: int, address: int, size: int) -> int:
        taken = write(ctypes.string_at(address, size)) if size > 0 else 0
        return size if taken is None else taken

    return CallbackPlugs(
        native(_TRANSFER, into, TRANSFER_SIGNATURE),
        native(_TRANSFER, out_of, TRANSFER_SIGNATURE),
        native(_WAIT, lambda _handle, deadline_ns: int(wait(deadline_ns)), WAIT_SIGNATURE),
    )
