"""System calls for compiled code, without Python and without the GIL: clocks, sleeping, reading, writing and polling.

clock_nanosleep, ppoll and __errno_location exist only on Linux. On other systems Python functions replace all calls
(`rig.realtime._stand_ins`).

Clocks, descriptors and USB transfers of `rig.devices`, the loop, the recorder and `rig.doctor` use it. A kernel may
call only functions whose existence was checked before.
"""

import ctypes
import sys

from numba import carray, types

from rig.core.errors import RigError
from rig.realtime import _stand_ins as stand_ins
from rig.realtime.atomics import load_word, stack_words, store_word
from rig.realtime.kernel import kernel
from rig.realtime.plugs import NOW_SIGNATURE, TRANSFER_SIGNATURE, WAIT_SIGNATURE

_NAMES = ("read", "write", "fdatasync", "ppoll", "clock_gettime", "clock_nanosleep", "__errno_location")
# Looked up before anything is compiled: compiling against a missing symbol ends the interpreter.
if sys.platform == "linux":
    _MISSING = [name for name in _NAMES if not hasattr(ctypes.CDLL(None), name)]
    if _MISSING:
        raise RigError(
            f"the C library of this Linux has no {', '.join(_MISSING)}",
            remedy="use a Linux with glibc or musl",
        )
else:
    stand_ins.stand_in()

_i32, _i64, _u64, _ptr = types.int32, types.int64, types.uint64, types.uintp
# By name: a pointer from ctypes would silently switch the disk cache off.
_read = types.ExternalFunction("read", _i64(_i32, _ptr, _u64))
_write = types.ExternalFunction("write", _i64(_i32, _ptr, _u64))
_fdatasync = types.ExternalFunction("fdatasync", _i32(_i32))
_ppoll = types.ExternalFunction("ppoll", _i32(_ptr, _u64, _ptr, _ptr))
_clock_gettime = types.ExternalFunction("clock_gettime", _i32(_i32, _ptr))
_clock_nanosleep = types.ExternalFunction("clock_nanosleep", _i32(_i32, _i32, _ptr, _ptr))
_errno_location = types.ExternalFunction("__errno_location", types.CPointer(types.int32)())
_one_word = stack_words(1)
_two_words = stack_words(2)

CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1
POLLIN = 0x001
EINTR, EIO, EAGAIN, ENODEV, EINVAL, EROFS = 4, 5, 11, 19, 22, 30
BILLION = 1_000_000_000


@kernel(_i64())
def last_error() -> int:
    """Return the errno of the last failed system call in this thread."""
    return int(carray(_errno_location(), 1)[0])


@kernel(NOW_SIGNATURE)
def monotonic_now(handle: int) -> int:
    """Return the present time of CLOCK_MONOTONIC (ns); `handle` is not used."""
    timespec = _two_words()
    _clock_gettime(CLOCK_MONOTONIC, timespec)
    return int(load_word(timespec) * BILLION + load_word(timespec + 8))


@kernel(NOW_SIGNATURE)
def virtual_now(handle: int) -> int:
    """Return the time of a virtual clock (ns); `handle` is the address of the int64 with this time."""
    return int(load_word(handle))


@kernel(types.void(_i64))
def sleep_until(deadline_ns: int) -> None:
    """Sleep until CLOCK_MONOTONIC reaches `deadline_ns` (ns); a signal does not end the sleep early."""
    timespec = _two_words()
    store_word(timespec, deadline_ns // BILLION)
    store_word(timespec + 8, deadline_ns % BILLION)
    while _clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec, 0) == EINTR:
        pass


@kernel(WAIT_SIGNATURE)
def monotonic_sleep(handle: int, deadline_ns: int) -> int:
    """Sleep until CLOCK_MONOTONIC reaches `deadline_ns` (ns) and return 0; `handle` is not used."""
    sleep_until(deadline_ns)
    return 0


@kernel(WAIT_SIGNATURE)
def virtual_sleep(handle: int, deadline_ns: int) -> int:
    """Set a virtual clock (int64 at address `handle`) to `deadline_ns` (ns) unless its time is later; return 0."""
    store_word(handle, max(load_word(handle), deadline_ns))
    return 0


@kernel(TRANSFER_SIGNATURE)
def descriptor_read(descriptor: int, address: int, size: int) -> int:
    """Read at most `size` available bytes from a descriptor to memory at `address`, without waiting.

    Returns the number of bytes, 0 if no input is available, or a negative errno (-ENODEV: the other side has closed).
    """
    # Polled first, so that a zero from read(2) can only mean that the other side has closed.
    pollfd = _one_word()
    timespec = _two_words()
    store_word(pollfd, descriptor | (POLLIN << 32))
    store_word(timespec, 0)
    store_word(timespec + 8, 0)
    if _ppoll(pollfd, 1, timespec, 0) < 1:
        return 0
    got = _read(descriptor, address, size)
    if got > 0:
        return int(got)
    if got == 0:
        return -ENODEV
    error = last_error()
    return 0 if error in (EAGAIN, EINTR) else -error


@kernel(TRANSFER_SIGNATURE)
def descriptor_write(descriptor: int, address: int, size: int) -> int:
    """Write up to `size` bytes from `address` without blocking; return the bytes written, 0 if full, or -errno."""
    done = _write(descriptor, address, size)
    if done >= 0:
        return int(done)
    error = last_error()
    return 0 if error in (EAGAIN, EINTR) else -error


@kernel(_i64(_i64))
def descriptor_sync(descriptor: int) -> int:
    """Write a file to the disk by fdatasync(2); return 0, also for a file that cannot be synced, or an errno."""
    if _fdatasync(descriptor) == 0:
        return 0
    error = last_error()
    return 0 if error in (EINVAL, EROFS) else error


@kernel(WAIT_SIGNATURE)
def descriptor_wait(descriptor: int, deadline_ns: int) -> int:
    """Wait for input until CLOCK_MONOTONIC reaches `deadline_ns`; return 1 (input), 0 (deadline), or -errno."""
    pollfd = _one_word()
    timespec = _two_words()
    while True:
        remaining = deadline_ns - monotonic_now(0)
        remaining = max(remaining, 0)
        store_word(pollfd, descriptor | (POLLIN << 32))
        store_word(timespec, remaining // BILLION)
        store_word(timespec + 8, remaining % BILLION)
        ready = _ppoll(pollfd, 1, timespec, 0)
        if ready > 0:
            events = load_word(pollfd) >> 48
            if events & POLLIN:
                return 1
            return -EIO
        if ready == 0:
            return 0
        error = last_error()
        if error != EINTR:
            return -error
