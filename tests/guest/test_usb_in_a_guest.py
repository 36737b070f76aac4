"""pyusb, libusb, Linux and udev with a device that fails on command, and the resulting errors of `rig`."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.messages import USB_PRODUCT, USB_VENDOR
from rig.core.errors import BlockedError, DeviceNotFoundError, LinkLostError, StalledError, UnpluggedError
from rig.devices import open_link
from sim_backend.ends.usb import ENDPOINT_IN, ENDPOINT_OUT
from tests.guest import vhci
from tests.guest.hits import MODEL, check_ended_safely, struck_trial, whole_hit
from tests.guest.plugged import plugged, plugged_rig

pytestmark = pytest.mark.skipif(not vhci.is_here(), reason="no vhci_hcd here: run .ci/guest")

LONG_S = 20.0
READ = 4096
STRIKE_AFTER_S = 0.3


@pytest.fixture(scope="module")
def bare() -> Iterator[Any]:
    with plugged("bare") as made:
        yield made


@pytest.fixture(params=["queued", "plain"])
def link(bare: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    made = open_link(f"usb://{USB_VENDOR:04x}:{USB_PRODUCT:04x}/bare?transfers={request.param}")
    yield made
    made.close()


def test_a_link_carries_bytes_and_waits_no_longer_than_it_says(link: Any, bare: Any) -> None:
    link.write(b"there")
    bare.device.settimeout(LONG_S)
    assert bare.device.recv(READ) == b"there"
    assert link.read(0.05) == b""
    bare.device.send(b"and back")
    assert link.read(LONG_S) == b"and back"


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


# One from each side of the kernel; tests/system/usb has an error for each kind of fault.
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
