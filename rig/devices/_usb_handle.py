"""Find the addresses of libusb's functions, context and device handle in the private attributes of pyusb.

This is the only file that uses pyusb's private names. `unsuitable` compares them with the tested versions, and returns
the reason if the addresses cannot be used; then the device is used through pyusb's own calls
(`rig.devices._usb_plain`). `rig.devices.usb` and `_usb_queue` use it. It must not be used with a version that was not
tested.
"""

import ctypes
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import usb
import usb.core
import usb.util
from numpy.typing import NDArray
from usb.backend import libusb1

from rig.core.errors import DeviceNotFoundError

TESTED = ((1, 2), (1, 3))  # versions of pyusb
_FUNCTIONS = (
    "libusb_submit_transfer",
    "libusb_cancel_transfer",
    "libusb_handle_events_timeout_completed",
    "libusb_alloc_transfer",
    "libusb_free_transfer",
    "libusb_get_pollfds",
    "libusb_free_pollfds",
)


class Transfer(ctypes.Structure):
    """The C struct libusb_transfer, as libusb.h declares it."""

    _fields_ = (
        ("dev_handle", ctypes.c_void_p),
        ("flags", ctypes.c_uint8),
        ("endpoint", ctypes.c_uint8),
        ("type", ctypes.c_uint8),
        ("timeout", ctypes.c_uint),
        ("status", ctypes.c_int),
        ("length", ctypes.c_int),
        ("actual_length", ctypes.c_int),
        ("callback", ctypes.c_void_p),
        ("user_data", ctypes.c_void_p),
        ("buffer", ctypes.c_void_p),
        ("num_iso_packets", ctypes.c_int),
    )


class _PollFd(ctypes.Structure):
    _fields_ = (("fd", ctypes.c_int), ("events", ctypes.c_short))


@dataclass(frozen=True, slots=True)
class Handle:
    """Addresses of libusb's functions, of its context and of the handle of an open device, for compiled code."""

    submit: int
    cancel: int
    handle_events: int
    context: int
    device: int
    polled: NDArray[np.int64]  # struct pollfd, one a word
    _library: Any

    def make_transfer(self) -> int:
        """Allocate a libusb transfer and return its address; raise `MemoryError` on failure."""
        allocate = _function(self._library, "libusb_alloc_transfer", ctypes.c_void_p, ctypes.c_int)
        address = allocate(0)
        if not address:
            raise MemoryError("libusb has no memory for another USB transfer")
        return int(address)

    def free_transfer(self, address: int) -> None:
        """Free the libusb transfer at this address, which must no longer be in use."""
        _function(self._library, "libusb_free_transfer", None, ctypes.c_void_p)(address)


class UsbBus:
    """All USB devices that are connected now, in their own libusb context. Close the bus after its devices.

    Raise `DeviceNotFoundError` if libusb is not installed.
    """

    def __init__(self) -> None:
        self._backend = _own_backend()
        try:
            self.devices: list[usb.core.Device] = list(
                usb.core.find(find_all=True, backend=self._backend)
                if self._backend is not None
                else usb.core.find(find_all=True)
            )
        except usb.core.NoBackendError:
            raise DeviceNotFoundError(
                "libusb is not installed", remedy="install it: sudo apt install libusb-1.0-0"
            ) from None

    def close(self) -> None:
        """Close all devices of the bus, then the libusb context; a second call does nothing."""
        devices, self.devices = self.devices, []
        for device in devices:
            with suppress(usb.core.USBError):
                usb.util.dispose_resources(device)
        if self._backend is None:
            return
        for device in devices:  # libusb must not outlive its devices, nor they it
            with suppress(AttributeError):
                device._ctx.dev.finalize()  # noqa: SLF001
        backend, self._backend = self._backend, None
        backend.finalize()


def _own_backend() -> Any:
    """Return a pyusb backend with a new libusb context; None for a version of pyusb that is not tested."""
    if _version() not in TESTED:
        return None
    try:
        if libusb1._lib is None:  # noqa: SLF001
            libusb1._lib = libusb1._load_library()  # noqa: SLF001
            libusb1._setup_prototypes(libusb1._lib)  # noqa: SLF001
        # One context for each link, with the thread that watches for devices: a new context lists the devices that are
        # present now, not those that pyusb has cached, and closing it frees everything.
        return libusb1._LibUSB(libusb1._lib)  # noqa: SLF001
    except Exception:  # whatever is missing, pyusb's own search gives a better error
        return None


def _version() -> tuple[int, int]:
    return tuple(usb.version_info[:2])


def unsuitable(device: usb.core.Device) -> str:
    """Return the reason why compiled code cannot use libusb's addresses of an open device; "" if it can."""
    if not _is_known():
        return "the memory layout of a USB transfer is known only for 64-bit Linux"
    if _version() not in TESTED:
        tested = ", ".join(f"{major}.{minor}" for major, minor in TESTED)
        return f"pyusb {usb.__version__} is not among the tested ones ({tested})"
    if numba.config.DISABLE_JIT:
        return "numba's compiler is switched off (NUMBA_DISABLE_JIT)"
    return _find_difference(device)


def _is_known() -> bool:
    if sys.platform == "linux":
        return sys.maxsize > 2**32 and sys.byteorder == "little"
    else:
        return False


def _find_difference(device: usb.core.Device) -> str:
    """Return the first difference between pyusb's private names and those of tested versions; "" without one."""
    try:
        backend = device.backend
        if not isinstance(backend, libusb1._LibUSB):  # noqa: SLF001
            return f"the backend is not libusb 1.0 but {type(backend).__module__}"
        missing = [name for name in _FUNCTIONS if not hasattr(backend.lib, name)]
        if missing:
            return f"libusb has no {missing[0]}"
        if not (backend.ctx.value and device._ctx.handle.handle.value):  # noqa: SLF001
            return "pyusb has no open handle"
        theirs = libusb1._libusb_transfer  # noqa: SLF001
    except AttributeError as error:
        return f"pyusb {usb.__version__} is built differently: {error}"
    for name in ("status", "length", "actual_length", "user_data", "buffer"):
        if getattr(theirs, name).offset != getattr(Transfer, name).offset:
            return f"pyusb has the field {name} of a USB transfer at another offset"
    return ""


def handle_of(device: usb.core.Device) -> Handle:
    """Return libusb's addresses for an open device, for which `unsuitable` must return ""."""
    library, context = device.backend.lib, device.backend.ctx.value
    return Handle(
        submit=_address(library, "libusb_submit_transfer"),
        cancel=_address(library, "libusb_cancel_transfer"),
        handle_events=_address(library, "libusb_handle_events_timeout_completed"),
        context=context,
        device=device._ctx.handle.handle.value,  # noqa: SLF001
        polled=np.array(list(_polled(library, context)), np.int64),
        _library=library,
    )


def _polled(library: Any, context: int) -> Iterable[int]:
    """Yield each file descriptor that libusb must poll, as the 64-bit word of its ``struct pollfd``."""
    entries = ctypes.POINTER(ctypes.POINTER(_PollFd))
    listed = _function(library, "libusb_get_pollfds", entries, ctypes.c_void_p)(context)
    index = 0
    while listed and listed[index]:
        found = listed[index].contents
        yield found.fd | (found.events & 0xFFFF) << 32
        index += 1
    _function(library, "libusb_free_pollfds", None, entries)(listed)


def _address(library: Any, name: str) -> int:
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert address is not None
    return address


def _function(library: Any, name: str, answer: Any, *arguments: Any) -> Any:
    """Return a function of libusb with the given prototype; pyusb's own prototypes are not changed."""
    return ctypes.CFUNCTYPE(answer, *arguments)(_address(library, name))
