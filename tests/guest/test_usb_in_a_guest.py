"""pyusb, libusb, Linux and udev as they are, and a device that breaks on command: what arrives, what `rig` makes."""

from __future__ import annotations

import errno
import threading

import pytest
import usb.core
import usb.util
from usb.backend import libusb1

import rig.devices
from rig.devices import open_device
from rig.errors import DeviceNotFoundError, LinkLostError
from sim_backend.usb import ENDPOINT_IN, ENDPOINT_OUT, PRODUCT, VENDOR, VENDOR_CLASS
from tests.guest import vhci
from tests.guest.hits import MODEL, check_ended_safely, short_hit
from tests.guest.plugged import plugged, plugged_rig

pytestmark = pytest.mark.skipif(not vhci.is_here(), reason="no vhci_hcd here: run .ci/guest")

LONG_MS = 20_000
SHORT_MS = 100
READ = 4096
STRIKE_AFTER_S = 0.3


def find(serial):
    """A fresh look at the bus: pyusb keeps what it has once seen, a backend made anew does not."""
    backend = libusb1.get_backend()
    return usb.core.find(
        idVendor=VENDOR,
        idProduct=PRODUCT,
        backend=backend,
        custom_match=lambda device: usb.util.get_string(device, device.iSerialNumber) == serial,
    )


@pytest.fixture(scope="module")
def bare():
    with plugged("bare") as made:
        yield made


@pytest.fixture
def opened(bare):
    """The device through pyusb, its pipes empty."""
    device = find("bare")
    assert device is not None
    usb.util.claim_interface(device, 0)
    yield device
    for address in (ENDPOINT_IN, ENDPOINT_OUT):
        bare.bus.silence(address, False)
    usb.util.dispose_resources(device)


def number_of(call):
    with pytest.raises(usb.core.USBError) as caught:
        call()
    return caught.value.errno


# ---------------------------------------------------------------------- what pyusb is given


def test_linux_enumerates_the_rig(opened):
    assert opened.manufacturer == "haptic-rig"
    assert opened.serial_number == "bare"
    assert opened.speed == usb.util.SPEED_FULL
    interface = opened.get_active_configuration()[(0, 0)]
    assert interface.bInterfaceClass == VENDOR_CLASS
    assert {endpoint.bEndpointAddress for endpoint in interface} == {ENDPOINT_IN, ENDPOINT_OUT}
    assert all(endpoint.wMaxPacketSize == 64 for endpoint in interface)


def test_bytes_pass_both_ways_as_packets(opened, bare):
    sent = bytes(range(200))
    assert opened.write(ENDPOINT_OUT, sent, LONG_MS) == 200
    bare.device.settimeout(20.0)
    packets = [bare.device.recv(READ) for _ in range(4)]
    assert [len(packet) for packet in packets] == [64, 64, 64, 8]
    assert b"".join(packets) == sent
    bare.device.send(b"short")
    assert bytes(opened.read(ENDPOINT_IN, READ, LONG_MS)) == b"short"


def test_silence_is_a_time_out_and_nothing_is_lost_by_it(opened, bare):
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        opened.read(ENDPOINT_IN, READ, SHORT_MS)
    assert caught.value.errno == errno.ETIMEDOUT
    bare.device.send(b"late")
    assert bytes(opened.read(ENDPOINT_IN, READ, LONG_MS)) == b"late"


def test_a_device_that_does_not_read_is_a_time_out(opened, bare):
    bare.bus.silence(ENDPOINT_OUT)
    assert number_of(lambda: opened.write(ENDPOINT_OUT, b"x", SHORT_MS)) == errno.ETIMEDOUT


def test_a_stall_is_a_broken_pipe_until_it_is_cleared(opened, bare):
    bare.bus.halt(ENDPOINT_IN)
    for _ in range(2):
        assert number_of(lambda: opened.read(ENDPOINT_IN, READ, LONG_MS)) == errno.EPIPE
    opened.clear_halt(ENDPOINT_IN)
    bare.device.send(b"again")
    assert bytes(opened.read(ENDPOINT_IN, READ, LONG_MS)) == b"again"


def test_more_bytes_than_asked_for_are_an_overflow(opened, bare):
    bare.device.send(bytes(60))
    assert number_of(lambda: opened.read(ENDPOINT_IN, 16, LONG_MS)) == errno.EOVERFLOW


def test_a_packet_without_bytes_is_an_empty_read(opened, bare):
    bare.bus.fail_next(ENDPOINT_IN, 0)
    assert len(opened.read(ENDPOINT_IN, READ, LONG_MS)) == 0


def test_a_short_write_says_how_much_was_taken(opened, bare):
    bare.bus.fail_next(ENDPOINT_OUT, 0, 5)
    assert opened.write(ENDPOINT_OUT, bytes(20), LONG_MS) == 5


@pytest.mark.parametrize("status", [errno.EPROTO, errno.EILSEQ])
def test_noise_on_the_cable_is_an_error_of_input(opened, bare, status):
    bare.bus.fail_next(ENDPOINT_IN, -status)
    assert number_of(lambda: opened.read(ENDPOINT_IN, READ, LONG_MS)) == errno.EIO


def test_unplugged_in_a_blocked_read_and_after_it_and_found_again():
    with plugged("moving") as made:
        device = find("moving")
        usb.util.claim_interface(device, 0)
        threading.Timer(STRIKE_AFTER_S, made.bus.unplug).start()
        assert number_of(lambda: device.read(ENDPOINT_IN, READ, LONG_MS)) == errno.ENODEV
        assert number_of(lambda: device.read(ENDPOINT_IN, READ, LONG_MS)) == errno.ENODEV
        assert number_of(lambda: device.write(ENDPOINT_OUT, b"x", LONG_MS)) == errno.ENODEV
        usb.util.dispose_resources(device)
        made.unplug()
        assert find("moving") is None
    with plugged("moving") as made:
        device = find("moving")
        made.device.send(b"back")
        assert bytes(device.read(ENDPOINT_IN, READ, LONG_MS)) == b"back"
        usb.util.dispose_resources(device)


# ---------------------------------------------------------------------- what rig makes of it


needs_backend = pytest.mark.skipif("usb" not in rig.devices.BUILT_IN, reason="usb:// cannot be opened yet")


@needs_backend
def test_nobody_there_is_said():
    with pytest.raises(DeviceNotFoundError, match="nobody"):
        open_device(f"usb://{VENDOR:04x}:{PRODUCT:04x}/nobody")


@needs_backend
def test_a_whole_hit(tmp_path):
    with plugged_rig("whole", MODEL) as made:
        with open_device(made.url) as device:
            assert device.dictionary.device == MODEL.name
        ended = short_hit(made.url, tmp_path)
        check_ended_safely(ended, made.far_end)
        assert made.far_end.left().strongest > 0


STRIKES = {
    "unplug": lambda bus: bus.unplug(),
    "stall of what comes": lambda bus: bus.halt(ENDPOINT_IN),
    "stall of what goes": lambda bus: bus.halt(ENDPOINT_OUT),
    "silence": lambda bus: bus.silence(ENDPOINT_IN),
    "a device that reads nothing": lambda bus: bus.silence(ENDPOINT_OUT),
    "overflow": lambda bus: bus.fail_next(ENDPOINT_IN, -errno.EOVERFLOW),
    "noise": lambda bus: bus.fail_next(ENDPOINT_IN, -errno.EPROTO),
    "a short packet": lambda bus: bus.fail_next(ENDPOINT_IN, 0, 7),
    "a short write": lambda bus: bus.fail_next(ENDPOINT_OUT, 0, 7),
}


@needs_backend
@pytest.mark.parametrize("strike", STRIKES)
def test_struck_in_the_middle_of_a_hit(strike, tmp_path):
    with plugged_rig(f"struck-{list(STRIKES).index(strike)}", MODEL) as made:
        ended = short_hit(made.url, tmp_path, strike=lambda: STRIKES[strike](made.bus))
        check_ended_safely(ended, made.far_end)


@needs_backend
def test_plugged_in_again_it_is_opened_again():
    with plugged_rig("again", MODEL) as made, open_device(made.url) as device:
        device.identify()
        made.unplug()
        with pytest.raises(LinkLostError):
            device.identify()
    with plugged_rig("again", MODEL) as made, open_device(made.url) as device:
        assert device.dictionary.device == MODEL.name
