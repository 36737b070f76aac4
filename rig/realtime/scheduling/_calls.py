"""Call C library functions that Python does not offer: memory locks, timer slack, time slice, stack address.

The other files of this package use it. It must not decide what to request.
"""

import ctypes
import errno
import mmap
import platform
from functools import cache

MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4  # linux/mman.h
MLOCK_ONFAULT = 1
MADV_POPULATE_WRITE = 23  # Linux 5.14
PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 29, 30  # linux/prctl.h
_ATTRIBUTE_BYTES = 512  # pthread_attr_t has 56 to 64 bytes on the platforms of Linux

_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274, "armv7l": 380}


class _Attributes(ctypes.Structure):
    """The C struct sched_attr of linux/sched/types.h, in its first version."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        *((name, ctypes.c_uint64) for name in ("runtime", "deadline", "period")),
    ]


@cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _call(name: str, *arguments: object) -> int:
    function = getattr(_libc(), name, None)
    if function is None:
        return errno.ENOSYS
    return ctypes.get_errno() or errno.EINVAL if function(*arguments) < 0 else 0


def lock_all() -> int:
    """Lock each page of this process, also a future one, in memory when it is first used; return 0 or an errno."""
    # Without "on fault" the kernel would fill every mapping at once: this doubles the size of a process that has
    # loaded numba, and makes each new thread wait for its whole stack.
    return _call("mlockall", MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT)


def unlock_all() -> int:
    """Remove all locks of this process's memory pages, also locks by `lock_range`; return 0 or an errno."""
    return _call("munlockall")


def lock_range(address: int, size: int, *, on_fault: bool) -> int:
    """Lock `size` bytes at `address` in memory, now or (`on_fault`) each page at first use; return 0 or an errno."""
    flags = MLOCK_ONFAULT if on_fault else 0
    return _call("mlock2", ctypes.c_void_p(address), ctypes.c_size_t(size), ctypes.c_uint(flags))


def set_timer_slack(slack_ns: int) -> int:
    """Set by how much (ns) the kernel may delay the end of the calling thread's sleeps; return 0 or an errno."""
    return _call("prctl", PR_SET_TIMERSLACK, ctypes.c_ulong(slack_ns), *(ctypes.c_ulong(0),) * 3)


def set_slice(slice_ns: int) -> int:
    """Request a time slice (ns) for the calling ordinary thread; a short one starts it sooner. Return 0 or an errno."""
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return errno.ENOSYS
    attributes = _Attributes(size=ctypes.sizeof(_Attributes), runtime=slice_ns)
    return _call(
        "syscall", ctypes.c_long(number), ctypes.c_int(0), ctypes.byref(attributes), ctypes.c_uint(0)
    )


def timer_slack() -> int:
    """Return by how much (ns) the kernel may delay this thread's wake-ups; 0 for a real-time thread."""
    function = getattr(_libc(), "prctl", None)
    return 0 if function is None else max(int(function(PR_GET_TIMERSLACK, *(ctypes.c_ulong(0),) * 4)), 0)


def stack_top() -> int:
    """Return the address above the stack of the calling thread; 0 if the C library does not provide it."""
    library = _libc()
    if not hasattr(library, "pthread_getattr_np"):
        return 0
    attributes = ctypes.create_string_buffer(_ATTRIBUTE_BYTES)
    address, size = ctypes.c_void_p(), ctypes.c_size_t()
    library.pthread_self.restype = ctypes.c_void_p
    if library.pthread_getattr_np(ctypes.c_void_p(library.pthread_self()), attributes):
        return 0
    found = library.pthread_attr_getstack(attributes, ctypes.byref(address), ctypes.byref(size))
    library.pthread_attr_destroy(attributes)
    return 0 if found or address.value is None else address.value + size.value


def touch(address: int, size: int) -> None:
    """Load the memory pages from `address` on, `size` bytes, and make them writable, without changing their content.

    No other thread may write there at the same time: kernels before 5.14 need a write to each page.
    """
    first = address // mmap.PAGESIZE * mmap.PAGESIZE
    length = ctypes.c_size_t(address + size - first)
    if _call("madvise", ctypes.c_void_p(first), length, MADV_POPULATE_WRITE) == errno.EINVAL:
        # Before Linux 5.14: one byte of each page is written over itself.
        for page in (address, *range(first + mmap.PAGESIZE, address + size, mmap.PAGESIZE)):
            ctypes.memmove(page, page, 1)
