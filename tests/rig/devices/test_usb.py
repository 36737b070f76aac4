"""USB links: opening and its errors, on a fake bus. tests/system/usb tests the transfers themselves."""

import errno
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from usb.backend.libusb1 import _libusb_errno

from rig.core.errors import ConfigError, DeviceNotFoundError, IncompatibleDeviceError
from rig.devices import _usb_handle as usb_handle
from rig.devices import _usb_transfers as compiled
from rig.devices import open_link
from rig.devices import usb as links
from rig.realtime.scheduling.refusals import RULES_COMMAND

IN, OUT, BULK, INTERRUPT = 0x81, 0x01, 2, 3


def endpoint(address: int, kind: int = BULK, size: int = 64) -> SimpleNamespace:
    return SimpleNamespace(bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=size)


class Interface(list):
    def __init__(self, *ends: SimpleNamespace, kind: int = 0xFF, number: int = 0, alternate: int = 0) -> None:
        super().__init__(ends)
        self.bInterfaceClass, self.bInterfaceNumber, self.bAlternateSetting = kind, number, alternate


PIPES = Interface(endpoint(IN), endpoint(OUT))


class Device:
    """The part of `usb.core.Device` that opening uses; `fails` maps a call to the error that it raises."""

    backend, bus, address, port_numbers, serial_number, product = None, 1, 7, (1,), "A", "stand-in"

    def __init__(self, *interfaces: Any, fails: Any = None, driver: bool = False, **attributes: Any) -> None:
        usual = {"idVendor": 0x1209, "idProduct": 1, "bDeviceClass": 0, "bNumConfigurations": 1}
        vars(self).update(usual | attributes)
        self._configuration = list(interfaces or [PIPES])
        self._fails, self._driver = fails or {}, driver
        self.calls: list[str] = []

    def __getitem__(self, index: int) -> list[Interface]:
        return self._configuration

    def _do(self, name: str, *arguments: Any) -> bool:
        self.calls.append(" ".join([name, *(f"{end:#x}" for end in arguments if end)]))
        if self.calls[-1] in self._fails:
            raise self._fails[self.calls[-1]]
        return self._driver

    def __getattr__(self, name: str) -> Any:
        return partial(self._do, name)


HUB = Device(idVendor=0x1D6B, bDeviceClass=9)


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return a fake bus whose devices a test sets; `closed` counts how often it was closed."""

    class Bus:
        devices: tuple[Device, ...] = ()
        closed = 0

        def close(self) -> None:
            Bus.closed += 1

    monkeypatch.setattr(links, "UsbBus", Bus)
    monkeypatch.setattr(links, "SYSFS", tmp_path)
    monkeypatch.setattr(links.usb.util, "claim_interface", lambda device, interface: device._do("claim"))
    monkeypatch.setattr(links.usb.util, "release_interface", lambda device, interface: device._do("release"))
    monkeypatch.setattr(links, "_open", lambda *_: SimpleNamespace(note="", close=list))
    return Bus


def error(number: int) -> usb.core.USBError:
    return usb.core.USBError("as libusb says it", errno=number)


def refused(bus: Any, kind: Any, *devices: Any, url: str = "usb://1209:0001") -> Any:
    bus.devices = list(devices)
    with pytest.raises(kind) as caught:
        open_link(url)
    assert caught.value.remedy
    return caught.value


@pytest.mark.parametrize(
    "place", ["", "1209", "1209:", ":1", "12345:1", "xyz:1", "1209-0001", "1209:-1", "1209:0001:2", "+1:1"]
)
def test_a_place_that_names_no_device_is_refused(bus: Any, place: str) -> None:
    assert "usb://1209:0001/SERIAL" in refused(bus, ConfigError, url=f"usb://{place}").remedy


def test_options_are_known_ones(bus: Any) -> None:
    assert "transfers" in refused(bus, ConfigError, url="usb://1209:0001?speed=high").remedy
    assert "queued, plain" in refused(bus, ConfigError, url="usb://1209:0001?transfers=fast").remedy


def test_no_such_device_lists_what_is_there(bus: Any) -> None:
    other = Device(idVendor=0x2E8A, idProduct=0x000A, serial_number="E66")
    caught = refused(bus, DeviceNotFoundError, other, HUB, Device(Interface(endpoint(IN)), idVendor=1))
    assert "1209:0001" in caught.message
    assert "Rigs here: usb://2e8a:000a/E66 (stand-in)" in caught.remedy
    assert bus.closed == 1
    assert "No USB device here looks like a rig" in refused(bus, DeviceNotFoundError, HUB).remedy


def test_a_serial_number_selects_one_of_two_devices(bus: Any) -> None:
    pair = (Device(), Device(serial_number="B", port_numbers=(2,)))
    caught = refused(bus, DeviceNotFoundError, *pair)
    assert "usb://1209:0001/A, usb://1209:0001/B" in caught.remedy
    unknown = refused(bus, DeviceNotFoundError, *pair, url="usb://1209:0001/C")
    assert "of a connected device: A, B" in unknown.remedy
    open_link("usb://1209:0001/B").close()
    assert pair[0].calls == []
    assert "claim" in pair[1].calls


def test_a_serial_number_is_read_from_sysfs(bus: Any, tmp_path: Path) -> None:
    (tmp_path / "1-4").mkdir()
    (tmp_path / "1-4" / "serial").write_text("KERNEL\n")
    bus.devices = [Device(serial_number="ASKED", port_numbers=(4,))]
    (found,) = links.available_devices()
    assert (found.url, found.path, found.is_rig) == ("usb://1209:0001/KERNEL", "1-4", True)


@pytest.mark.parametrize(
    "interfaces",
    [
        [Interface(endpoint(IN), endpoint(OUT), kind=0x0A)],  # CDC data: that is serial://
        [Interface(endpoint(IN))],
        [Interface(endpoint(IN), endpoint(OUT), endpoint(0x82))],
        [Interface(endpoint(IN, INTERRUPT), endpoint(OUT))],
        [Interface(endpoint(IN), endpoint(OUT), alternate=1)],
        [Interface()],
    ],
)
def test_a_device_without_a_pair_of_bulk_pipes_is_no_rig(bus: Any, interfaces: Any) -> None:
    assert "not a haptic rig" in refused(bus, IncompatibleDeviceError, Device(*interfaces)).message
    assert [device.is_rig for device in links.available_devices()] == [False]


def test_the_pipes_are_found_among_other_interfaces_and_endpoints(bus: Any) -> None:
    composite = Device(
        Interface(endpoint(0x83, INTERRUPT), kind=2),
        Interface(endpoint(0x85, INTERRUPT), endpoint(0x84, size=512), endpoint(0x02, size=512), number=3),
    )
    assert links._find_interface(composite) == links._Pipes(3, 0x84, 0x02, 512)


@pytest.mark.parametrize(
    ("call", "number", "message", "remedy"),
    [
        ("get_active_configuration", errno.EACCES, "no permission", RULES_COMMAND),
        ("claim", errno.EBUSY, "in use", "/dev/bus/usb/001/007"),  # the node that fuser wants
    ],
)
def test_a_device_that_may_not_be_opened(bus: Any, call: str, number: int, message: str, remedy: str) -> None:
    caught = refused(bus, DeviceNotFoundError, Device(fails={call: error(number)}))
    assert message in caught.message
    assert remedy in caught.remedy


@pytest.mark.parametrize("fails", [error(errno.ENODEV), error(errno.EIO), NotImplementedError("no")])
def test_any_other_error_of_opening_is_typed_and_gives_the_bus_back(bus: Any, fails: Any) -> None:
    refused(bus, DeviceNotFoundError, Device(fails={"claim": fails}))
    assert bus.closed == 1


def test_a_driver_of_the_kernel_gives_way_and_comes_back_and_a_halt_is_cleared(bus: Any) -> None:
    device = Device(driver=True, fails={"clear_halt 0x1": error(errno.EPIPE)})
    bus.devices = [device]
    open_link("usb://1209:0001").close()
    assert device.calls == [
        "get_active_configuration", "is_kernel_driver_active", "detach_kernel_driver", "claim",
        "clear_halt 0x81", "clear_halt 0x1", "release", "attach_kernel_driver",
    ]  # fmt: skip
    assert bus.closed == 1


def test_a_device_without_a_configuration_is_configured(bus: Any) -> None:
    device = Device(fails={"get_active_configuration": usb.core.USBError("Configuration not set")})
    bus.devices = [device]
    open_link("usb://1209:0001").close()
    assert "set_configuration" in device.calls


def test_without_libusb_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(**options: Any) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb_handle, "_own_backend", lambda: None)
    monkeypatch.setattr(usb_handle.usb.core, "find", nothing)
    with pytest.raises(DeviceNotFoundError, match="libusb") as caught:
        usb_handle.UsbBus()
    assert "apt install libusb-1.0-0" in caught.value.remedy
    assert links.available_devices() == []


def test_an_untested_libusb_is_named_and_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    device = SimpleNamespace(backend=SimpleNamespace(lib=SimpleNamespace(), ctx=None))
    assert "backend is not libusb 1.0" in usb_handle._find_difference(device)
    monkeypatch.setattr(usb_handle, "_version", lambda: (1, 9))
    assert "not among the tested ones" in usb_handle.unsuitable(device)
    assert usb_handle._own_backend() is None
    monkeypatch.setattr(usb_handle.sys, "byteorder", "big")
    assert "64-bit Linux" in usb_handle.unsuitable(device)


def test_the_layout_of_a_transfer_is_what_the_compiled_code_reads() -> None:
    assert usb_handle.Transfer.status.offset == compiled.STATUS_AT
    assert usb_handle.Transfer.length.offset == compiled.LENGTH_AT == compiled.STATUS_AT + 4
    assert usb_handle.Transfer.actual_length.offset == compiled.ACTUAL_AT
    assert usb_handle.Transfer.user_data.offset == compiled.USER_DATA_AT


def test_libusbs_statuses_are_error_numbers() -> None:
    numbers = [0, errno.EIO, errno.ETIMEDOUT, errno.ECANCELED, errno.EPIPE, errno.ENODEV, errno.EOVERFLOW]
    assert [compiled.errno_of_status(status) for status in range(7)] == numbers
    assert compiled.errno_of_status(7) == compiled.errno_of_status(-1) == errno.EIO


def test_libusbs_codes_are_those_that_pyusb_knows() -> None:
    """pyusb has its own table, which is independent."""
    for code, number in _libusb_errno.items():
        known = number is not None and code not in (-10, -12, -99)
        assert compiled.errno_of_code(code) == (number if known else errno.EIO) or code == 0
    assert compiled.errno_of_code(0) == compiled.errno_of_code(5) == 0
