"""Functions of a link for the compiled loop that call Python: for simulations, and links without compiled code.

Threaded devices and simulations in memory use them. They must not serve a device in real time: each call takes the GIL.
"""

from __future__ import annotations

import ctypes
import errno
from collections.abc import Callable
from typing import Any, NamedTuple

from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE, NativeFunction

_TRANSFER = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)
_WAIT = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)


class CallbackPlugs(NamedTuple):
    """Functions that transfer the bytes of a link, for plug points of the loop; the handle is not used."""

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
    """Return the functions of a link for the loop, made from Python functions.

    Parameters
    ----------
    read
        Function that returns the available bytes, at most as many as its argument.
    write
        Function that sends bytes and returns the number of accepted bytes; None means all.
    wait
        Function that waits for input until a deadline (ns, the link's clock) and returns True if input is available.
    failed
        Function that receives an exception of `read`, `write` or `wait`; the loop gets only its negative errno or -EIO.
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
