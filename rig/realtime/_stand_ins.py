"""Python functions that replace calls of the C library in compiled code, on systems other than Linux.

Compiled code calls C functions by name (`rig.realtime.system`). Only Linux has all these names, with the same
constants. On other systems each name leads to a function of this file, so that the compiled code is the same. Each call
takes the GIL and some microseconds, so a law in real time on this computer needs Linux. `rig.realtime.system` installs
them. On Linux this file must not be used.
"""

import ctypes
import errno
import os
import threading
import time
from collections.abc import Callable
from typing import Any

from llvmlite import binding

_EAGAIN = 11  # Linux's numbers, as compiled code has them
_BILLION = 1_000_000_000
_int32, _int64, _uint64, _address = ctypes.c_int32, ctypes.c_int64, ctypes.c_uint64, ctypes.c_size_t
_kept: list[Any] = []  # callbacks, for as long as compiled code may call them


class _Errno(threading.local):
    """The errno of each thread, as the replaced C functions report it."""

    def __init__(self) -> None:
        self.number = ctypes.c_int32(0)


_errno = _Errno()


def _fail(error: OSError) -> int:
    number = error.errno or errno.EIO
    _errno.number.value = _EAGAIN if number == errno.EAGAIN else number
    return -1


def _refuse(*arguments: int) -> int:
    """Fail with ENOSYS (not implemented): on these systems a port does not use read and ppoll."""
    return _fail(OSError(errno.ENOSYS, "not on this system"))


def _write(descriptor: int, address: int, size: int) -> int:
    try:
        return os.write(descriptor, ctypes.string_at(address, size))
    except OSError as error:
        return _fail(error)


def _sync(descriptor: int) -> int:
    try:
        os.fsync(descriptor)
    except OSError as error:
        return _fail(error)
    return 0


def _now(clock: int, timespec: int) -> int:
    # perf_counter: `time.monotonic` of Windows moves in steps of 16 ms before Python 3.13.
    words = (_int64 * 2).from_address(timespec)
    words[0], words[1] = divmod(time.perf_counter_ns(), _BILLION)
    return 0


def _sleep(clock: int, flags: int, deadline: int, remaining: int) -> int:
    seconds, ns = (_int64 * 2).from_address(deadline)
    left_ns = seconds * _BILLION + ns - time.perf_counter_ns()
    if left_ns > 0:
        time.sleep(left_ns * 1e-9)
    return 0


def _errno_location() -> int:
    return ctypes.addressof(_errno.number)


_CALLS: dict[str, tuple[Callable[..., int], list[Any]]] = {  # result first
    "read": (_refuse, [_int64, _int32, _address, _uint64]),
    "write": (_write, [_int64, _int32, _address, _uint64]),
    "fdatasync": (_sync, [_int32, _int32]),
    "ppoll": (_refuse, [_int32, _address, _uint64, _address, _address]),
    "clock_gettime": (_now, [_int32, _int32, _address]),
    "clock_nanosleep": (_sleep, [_int32, _int32, _int32, _address, _address]),
    "__errno_location": (_errno_location, [_address]),
}


def stand_in() -> None:
    """Register Python functions under the names of C functions; call it before any compiled code is loaded."""
    if not _kept:
        for name, (function, types) in _CALLS.items():
            callback = ctypes.CFUNCTYPE(*types)(function)
            _kept.append(callback)
            binding.add_symbol(name, ctypes.cast(callback, ctypes.c_void_p).value)
