"""pyusb, libusb, Linux and udev with a device that fails on command, and the resulting errors of `rig`."""

import errno
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import usb.core
import usb.util
from usb.backend import libusb1

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from rig.core.errors import (
    BlockedError,
    BrokenLineError,
    CutShortError,
    DeviceNotFoundError,
    LinkLostError,
    OverflowedError,
    StalledError,
    UnpluggedError,
)
from rig.devices import open_link
from rig.devices.usb import available_devices
from sim_backend.ends.usb import ENDPOINT_IN, ENDPOINT_OUT, VENDOR_CLASS
from tests.guest import vhci
from tests.guest.hits import MODEL, check_ended_safely, struck_trial, whole_hit
from tests.guest.plugged import plugged, plugged_rig

pytestmark = pytest.mark.skipif(not vhci.is_here(), reason="no vhci_hcd here: run .ci/guest")

LONG_S, LONG_MS = 20.0, 20_000
READ = 4096
STRIKE_AFTER_S = 0.3


def find(serial: Any) -> Any:
    """Find the device with a new backend, because pyusb caches the devices of an old one."""
    backend = libusb1.get_backend()
    return usb.core.find(
        idVendor=USB_VENDOR,
        idProduct=USB_PRODUCT,
        backend=backend,
        custom_match=lambda device: usb.util.get_string(device, device.iSerialNumber) == serial,
    )


@pytest.fixture(scope="module")
def bare() -> Iterator[Any]:
    with plugged("bare") as made:
        yield made


@pytest.fixture
def opened(bare: Any) -> Iterator[Any]:
    """The bare device, opened through pyusb, with empty pipes."""
    device = find("bare")
    assert device is not None
    usb.util.claim_interface(device, 0)
    yield device
    bare.bus.heal()
    usb.util.dispose_resources(device)


# ---------------------------------------------------------------------- what pyusb is given


def test_linux_enumerates_the_rig(opened: Any) -> None:
    assert opened.manufacturer == "haptic-rig"
    assert opened.serial_number == "bare"
    assert opened.speed == usb.util.SPEED_FULL
    interface = opened.get_active_configuration()[(0, 0)]
    assert interface.bInterfaceClass == VENDOR_CLASS
    assert {endpoint.bEndpointAddress for endpoint in interface} == {ENDPOINT_IN, ENDPOINT_OUT}
    assert all(endpoint.wMaxPacketSize == 64 for endpoint in interface)


def test_bytes_pass_both_ways_as_packets(opened: Any, bare: Any) -> None:
    sent = bytes(range(200))
    assert opened.write(ENDPOINT_OUT, sent, LONG_MS) == 200
    bare.device.settimeout(LONG_S)
    packets = [bare.device.recv(READ) for _ in range(4)]
    assert [len(packet) for packet in packets] == [64, 64, 64, 8]
    assert b"".join(packets) == sent
    bare.device.send(b"short")
    assert bytes(opened.read(ENDPOINT_IN, READ, LONG_MS)) == b"short"


# ---------------------------------------------------------------------- what rig makes of it


@pytest.fixture(params=["queued", "plain"])
def link(bare: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    made = open_link(f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/bare?transfers={request.param}")
    yield made
    bare.bus.heal()
    made.close()


def test_a_link_carries_bytes_and_waits_no_longer_than_it_says(link: Any, bare: Any) -> None:
    link.write(b"there")
    bare.device.settimeout(LONG_S)
    assert bare.device.recv(READ) == b"there"
    assert link.read(0.05) == b""
    bare.device.send(b"and back")
    assert link.read(LONG_S) == b"and back"


# A fault in the instant in which libusb withdraws the transfer is reported as a timeout (the plain link's writes have
# 5 ms). So a fault stays, as of a bad cable, until it is reported.
OFTEN = 100
READS = {
    "stall": (lambda bus: bus.halt(ENDPOINT_IN), StalledError),
    "overflow": (lambda bus: bus.fail_next(ENDPOINT_IN, -errno.EOVERFLOW, times=OFTEN), OverflowedError),
    "noise": (lambda bus: bus.fail_next(ENDPOINT_IN, -errno.EPROTO, times=OFTEN), BrokenLineError),
}
WRITES = {
    "stall": (lambda bus: bus.halt(ENDPOINT_OUT), StalledError),
    "silence": (lambda bus: bus.silence(ENDPOINT_OUT), BlockedError),
    "a short write": (lambda bus: bus.fail_next(ENDPOINT_OUT, 0, 5, times=OFTEN), CutShortError),
    "noise": (lambda bus: bus.fail_next(ENDPOINT_OUT, -errno.EPROTO, times=OFTEN), BrokenLineError),
}


@pytest.mark.parametrize("strike", READS)
def test_fault_of_a_read_has_its_own_error(strike: Any, link: Any, bare: Any) -> None:
    act, kind = READS[strike]
    act(bare.bus)
    check_is(kind, lambda: read_for(link))


@pytest.mark.parametrize("strike", WRITES)
def test_fault_of_a_write_has_its_own_error(strike: Any, link: Any, bare: Any) -> None:
    act, kind = WRITES[strike]
    act(bare.bus)
    check_is(kind, lambda: write_for(link))


def read_for(link: Any) -> None:
    deadline = time.monotonic() + LONG_S
    while time.monotonic() < deadline:
        link.read(1.0)


def write_for(link: Any) -> None:
    """Write repeatedly: a later write reports the failure, because no write waits for its end."""
    for _ in range(20):
        link.write(bytes(20))
        time.sleep(0.05)


def check_is(kind: Any, act: Any) -> None:
    with pytest.raises(LinkLostError) as caught:
        act()
    assert type(caught.value) is kind, repr(caught.value)
    assert caught.value.remedy


def test_opening_anew_clears_a_halt(bare: Any) -> None:
    bare.bus.halt(ENDPOINT_IN)
    made = open_link(f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/bare")
    bare.device.send(b"well again")
    assert made.read(LONG_S) == b"well again"
    made.close()


def test_absent_device_is_an_error_that_lists_the_present_ones(bare: Any) -> None:
    with pytest.raises(DeviceNotFoundError, match="bare"):
        open_link(f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/absent")
    assert "bare" in {device.serial for device in available_devices() if device.is_rig}


def test_one_program_at_a_time(link: Any) -> None:
    with pytest.raises(DeviceNotFoundError, match="in use"):
        open_link(link.url.text)


@pytest.mark.parametrize("transfers", ["queued", "plain"])
def test_a_pulled_plug_is_one_error_and_the_next_device_is_found(transfers: str) -> None:
    url = f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/pulled?transfers={transfers}"
    with plugged("pulled") as made:
        link = open_link(url)
        threading.Timer(STRIKE_AFTER_S, made.bus.unplug).start()
        check_is(UnpluggedError, lambda: read_for(link))
        check_is(UnpluggedError, lambda: write_for(link))
        link.close()
        made.unplug()
        with pytest.raises(DeviceNotFoundError):
            open_link(url)
    with plugged("pulled") as made:
        link = open_link(url)
        made.device.send(b"back")
        assert link.read(LONG_S) == b"back"
        link.close()


def test_a_whole_hit(tmp_path: Path) -> None:
    with plugged_rig("whole", MODEL) as made:
        ended = whole_hit(made.url, tmp_path)
        check_ended_safely(ended, made.far_end)
        assert ended.error is not None or made.far_end.left().strongest > 0


# One from each side of the kernel; all kinds end a hit in tests/system/usb, and have their names above, in this kernel.
STRIKES = {
    "unplug": (lambda bus: bus.unplug(), UnpluggedError),
    "stall": (lambda bus: bus.halt(ENDPOINT_IN), StalledError),
    "a device that reads nothing": (lambda bus: bus.silence(ENDPOINT_OUT), BlockedError),
}


@pytest.mark.parametrize("strike", STRIKES)
def test_struck_in_the_middle_of_a_hit(strike: Any, tmp_path: Path) -> None:
    act, kind = STRIKES[strike]
    with plugged_rig(f"struck-{list(STRIKES).index(strike)}", MODEL) as made:
        ended = struck_trial(made.url, tmp_path, lambda: act(made.bus))
        check_ended_safely(ended, made.far_end, kind)
