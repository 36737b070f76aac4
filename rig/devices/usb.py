"""Link to a USB device with two bulk endpoints: ``usb://1209:0001``, ``usb://1209:0001/SERIAL``.

pyusb finds, opens and claims the device. The compiled loop and Python then transfer bytes by libusb's transfers
(`rig.devices._usb_queue`), or by pyusb's own calls if libusb's handles cannot be used (`rig.devices._usb_plain`). A rig
is a device with an interface of vendor class (0xFF) with one bulk endpoint in each direction.

``?transfers=plain`` forces pyusb's own calls, ``?transfers=queued`` refuses them.

`rig.devices` loads it for ``usb://``, and `rig.doctor` lists devices by it. Listing must not claim a device, which
another program may use.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import usb.core
import usb.util

from rig.core.errors import (
    ConfigError,
    DeviceNotFoundError,
    IncompatibleDeviceError,
    LinkLostError,
    RigError,
    UnpluggedError,
)
from rig.core.model import RigModel
from rig.devices._failures import error_number, link_error
from rig.devices._usb_handle import UsbBus, handle_of, unsuitable
from rig.devices._usb_plain import PlainTransfers
from rig.devices._usb_queue import QueuedTransfers
from rig.devices.device import DeviceUrl, RealLink
from rig.devices.port import LoopPort
from rig.realtime.clock import Clock, MonotonicClock
from rig.realtime.scheduling.refusals import RULES_COMMAND

OPTIONS = ("transfers",)
TRANSFERS = ("queued", "plain")
VENDOR_CLASS = 0xFF
SYSFS = Path("/sys/bus/usb/devices")
_BULK = 2
_HUB_CLASS = 9


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """A connected USB device: vendor and product id, serial number, product name, name in sysfs.

    `is_rig` is True if the device has the USB interface of a rig.
    """

    vid: int
    pid: int
    serial: str
    product: str
    path: str
    is_rig: bool

    @property
    def url(self) -> str:
        """Return the URL that opens this USB device."""
        number = f"/{self.serial}" if self.serial else ""
        return DeviceUrl.of("usb", f"{self.vid:04x}:{self.pid:04x}{number}").text


@dataclass(frozen=True, slots=True)
class _Pipes:
    """USB interface of a rig: its number, its two endpoints, and the size of a received packet (bytes)."""

    interface: int
    endpoint_in: int
    endpoint_out: int
    packet: int


def available_devices() -> list[UsbDevice]:
    """Return the connected USB devices except hubs; an empty list if libusb is not installed.

    Descriptors are read from sysfs if possible, so as not to disturb a device that another program uses.
    """
    try:
        bus = UsbBus()
    except DeviceNotFoundError:
        return []
    try:
        return [_describe(device) for device in bus.devices if device.bDeviceClass != _HUB_CLASS]
    finally:
        bus.close()


def open_link(url: DeviceUrl, model: RigModel | None = None) -> UsbLink:
    """Open a USB device, ``usb://vid:pid[/serial][?transfers=…]``; `DeviceNotFoundError` if it is missing or in use.

    Also raise `IncompatibleDeviceError` for a device without the interface of a rig, or if transfers cannot be queued
    although the URL has ``transfers=queued``.
    """
    url.allow(OPTIONS)
    wanted = url.choice("transfers", TRANSFERS, "")
    vendor, product, serial = _parse_place(url)
    bus = UsbBus()
    try:
        device = _choose_device(bus, url, vendor, product, serial)
        pipes = _find_interface(device)
        if pipes is None:
            raise IncompatibleDeviceError(
                f"{url.text} is not a haptic rig: it has no interface of vendor class with one bulk endpoint each way",
                remedy=f"give the URL of a rig. {_list_rigs(bus)}",
            )
        detached = _claim(device, pipes, url)
        try:
            transfers = _open(url, device, pipes, wanted)
        except BaseException:
            _release(device, pipes, detached)
            raise
        number = _read_descriptor_text(device, "serial") or None
        return UsbLink(url, bus, transfers, lambda: _release(device, pipes, detached), number)
    except BaseException:
        bus.close()
        raise


def _parse_place(url: DeviceUrl) -> tuple[int, int, str]:
    pair, _, serial = url.place.partition("/")
    vendor, _, product = pair.partition(":")
    try:
        numbers = [int(text, 16) for text in (vendor, product) if text.isalnum() and len(text) <= 4]
    except ValueError:
        numbers = []
    if len(numbers) != 2:
        raise ConfigError(
            f"{url.text} is not the URL of a USB device",
            remedy="write vendor and product in hexadecimal, like usb://1209:0001 or usb://1209:0001/SERIAL",
        )
    return numbers[0], numbers[1], serial


def _choose_device(bus: UsbBus, url: DeviceUrl, vendor: int, product: int, serial: str) -> Any:
    found = [device for device in bus.devices if (device.idVendor, device.idProduct) == (vendor, product)]
    if not found:
        raise DeviceNotFoundError(
            f"there is no USB device {vendor:04x}:{product:04x}",
            remedy=f"plug the device in. {_list_rigs(bus)}",
        )
    if serial:
        numbers = [_read_descriptor_text(device, "serial") for device in found]
        matching = [device for device, number in zip(found, numbers, strict=True) if number == serial]
        if not matching:
            there = ", ".join(number or "a device without a number" for number in numbers)
            raise DeviceNotFoundError(
                f"no USB device {vendor:04x}:{product:04x} has the serial number {serial}",
                remedy=f"choose the serial number of a connected device: {there}",
            )
        found = matching
    if len(found) > 1:
        urls = ", ".join(_describe(device).url for device in found)
        raise DeviceNotFoundError(
            f"{len(found)} USB devices match {url.text}",
            remedy=f"add the serial number of one device: {urls}",
        )
    return found[0]


def _list_rigs(bus: UsbBus) -> str:
    described = [_describe(device) for device in bus.devices if device.bDeviceClass != _HUB_CLASS]
    found = [f"{device.url} ({device.product or 'no name'})" for device in described if device.is_rig]
    return f"Rigs here: {', '.join(found)}" if found else "No USB device here looks like a rig"


def _describe(device: Any) -> UsbDevice:
    is_rig = _find_interface(device) is not None
    return UsbDevice(
        vid=device.idVendor,
        pid=device.idProduct,
        serial=_read_descriptor_text(device, "serial", ask=is_rig),
        product=_read_descriptor_text(device, "product", ask=is_rig),
        path=_sysfs_name(device),
        is_rig=is_rig,
    )


def _sysfs_name(device: Any) -> str:
    """Return the name of a USB device's directory in sysfs, such as "1-2.3", from its bus and ports."""
    ports = device.port_numbers or (device.address,)
    return f"{device.bus}-{'.'.join(map(str, ports))}"


def _read_descriptor_text(device: Any, which: str, *, ask: bool = True) -> str:
    """Return a USB device's serial number or product name (`which`) from sysfs or (`ask`) the device; may be empty."""
    # From sysfs first: a request to the device would disturb another program that has it open.
    with suppress(OSError):
        return (SYSFS / _sysfs_name(device) / which).read_text("utf-8", "replace").strip()
    if ask:
        with suppress(usb.core.USBError, ValueError, NotImplementedError):  # ValueError: no permission to ask
            text = device.serial_number if which == "serial" else device.product
            return (text or "").strip("\0 ")
    return ""


def _find_interface(device: Any) -> _Pipes | None:
    """Return the device's first interface of vendor class with one bulk endpoint in each direction, else None."""
    try:
        interfaces = list(device[0]) if device.bNumConfigurations else []
    except usb.core.USBError:
        return None
    for interface in interfaces:
        if interface.bInterfaceClass != VENDOR_CLASS or interface.bAlternateSetting != 0:
            continue
        bulk = [end for end in interface if end.bmAttributes & 3 == _BULK]
        incoming = [end for end in bulk if end.bEndpointAddress & usb.util.ENDPOINT_IN]
        outgoing = [end for end in bulk if not end.bEndpointAddress & usb.util.ENDPOINT_IN]
        if len(incoming) == len(outgoing) == 1:
            return _Pipes(
                interface.bInterfaceNumber,
                incoming[0].bEndpointAddress,
                outgoing[0].bEndpointAddress,
                incoming[0].wMaxPacketSize & 0x7FF,
            )
    return None


def _claim(device: Any, pipes: _Pipes, url: DeviceUrl) -> bool:
    """Open the USB device, claim its interface, reset its endpoints; return True if a kernel driver was detached."""
    detached = False
    try:
        try:
            device.get_active_configuration()
        except usb.core.USBError as error:
            if error.errno is not None:
                raise
            device.set_configuration()  # it is not configured yet
        with suppress(NotImplementedError):
            if device.is_kernel_driver_active(pipes.interface):
                device.detach_kernel_driver(pipes.interface)
                detached = True
        usb.util.claim_interface(device, pipes.interface)
    except (usb.core.USBError, NotImplementedError) as error:
        raise _opening_error(error, device, url) from None
    for endpoint in (pipes.endpoint_in, pipes.endpoint_out):
        # Resets the data toggle of both sides: after a killed host they may differ, and the first packet would be lost.
        with suppress(usb.core.USBError, NotImplementedError):
            device.clear_halt(endpoint)
    return detached


def _release(device: Any, pipes: _Pipes, detached: bool) -> None:
    with suppress(usb.core.USBError, NotImplementedError):
        usb.util.release_interface(device, pipes.interface)
        if detached:
            device.attach_kernel_driver(pipes.interface)


def _opening_error(error: Exception, device: Any, url: DeviceUrl) -> RigError:
    number = error_number(error)
    if number in (errno.EACCES, errno.EPERM):
        remedy = f"run, then plug the device in again: {RULES_COMMAND}"
        return DeviceNotFoundError(f"no permission to open {url.text}", remedy=remedy)
    if number == errno.EBUSY:
        node = f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"
        return DeviceNotFoundError(
            f"{url.text} is in use by another program",
            remedy=f"close that program (sudo fuser {node} shows it)",
        )
    if number == errno.ENODEV:
        return DeviceNotFoundError(
            f"{url.text} was unplugged while it was opened",
            remedy="check cable and power, and plug it in again",
        )
    return DeviceNotFoundError(f"cannot open {url.text}: {error}", remedy="plug the device into another port")


class Transfers(Protocol):
    """Interface to the two bulk endpoints of a claimed USB interface; `note` is a warning about delays, or ""."""

    note: str

    def read(self, timeout_s: float) -> bytes:
        """Return received bytes; wait at most `timeout_s` (s) for the first byte. Raise `OSError` on failure."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data` to the device; raise `OSError` on failure."""
        ...

    def plugs(self) -> tuple[Any, Any, Any, int]:
        """Return the read, write and wait functions for the compiled loop, and the handle to pass as first argument."""
        ...

    def close(self) -> None:
        """Cancel the transfers that are not complete; a second call does nothing."""
        ...


class UsbLink(RealLink):
    """Link (`rig.devices.device.Link`) over the bulk endpoints of a claimed USB interface."""

    def __init__(
        self,
        url: DeviceUrl,
        bus: UsbBus,
        transfers: Transfers,
        release: Callable[[], None],
        serial_number: str | None = None,
    ) -> None:
        self.url = url
        self.serial_number = serial_number
        self.clock: Clock = MonotonicClock()
        self.bytes_per_second: float | None = None  # packets are the limit, not bytes
        self._bus: UsbBus | None = bus
        self._transfers = transfers
        self._release = release

    @property
    def note(self) -> str:
        """Return a warning for the user if USB transfers need the Python interpreter, else ""."""
        return self._transfers.note

    @property
    def messages(self) -> list[str]:
        """Return the warnings about this link, for the user to read."""
        return [self.note] if self.note else []

    def read(self, timeout_s: float) -> bytes:
        """Return received bytes; wait at most `timeout_s` (s) for the first. Raise `LinkLostError` on failure."""
        self._check_open()
        try:
            return self._transfers.read(timeout_s)
        except OSError as error:
            raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        """Send all of `data` to the USB device; raise `LinkLostError` on failure."""
        self._check_open()
        try:
            self._transfers.write(data)
        except OSError as error:
            raise self._lost(error) from error

    def port(self) -> LoopPort:
        """Return the functions with which the compiled loop reads, writes and waits on this USB link."""
        read, write, wait, handle = self._transfers.plugs()
        return LoopPort.on(self.clock, read=read, write=write, wait=wait, handle=handle)

    def close(self) -> None:
        """Cancel the transfers and release the USB device; a second call does nothing."""
        bus, self._bus = self._bus, None
        if bus is not None:
            self._transfers.close()
            self._release()
            bus.close()

    def _check_open(self) -> None:
        if self._bus is None:
            raise UnpluggedError(f"the link to {self.url.text} is closed", remedy="open the device again")

    def _lost(self, error: OSError) -> LinkLostError:
        return link_error(error_number(error), self.url.text)


def _open(url: DeviceUrl, device: Any, pipes: _Pipes, wanted: str) -> Transfers:
    """Return queued transfers if possible and `wanted` is not "plain", else transfers by pyusb's own calls.

    Raise `IncompatibleDeviceError` if `wanted` is "queued" but transfers cannot be queued.
    """
    why = "the URL has transfers=plain" if wanted == "plain" else unsuitable(device)
    if why and wanted == "queued":
        raise IncompatibleDeviceError(
            f"{url.text}: compiled code cannot queue USB transfers: {why}",
            remedy="remove transfers=queued from the URL, or install pyusb 1.3",
        )
    try:
        if why:
            return PlainTransfers(device, pipes.endpoint_in, pipes.endpoint_out, pipes.packet, why)
        return QueuedTransfers(handle_of(device), pipes.endpoint_in, pipes.endpoint_out, pipes.packet)
    except OSError as error:
        raise _opening_error(error, device, url) from None
