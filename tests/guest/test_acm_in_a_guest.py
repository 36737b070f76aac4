"""The kernel's cdc-acm driver and pyserial on a USB serial port that is unplugged and plugged in again."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from rig.cli import device
from rig.core.errors import DeviceNotFoundError, LinkLostError, UnpluggedError
from rig.devices import open_device
from rig.devices.device import DeviceUrl
from rig.devices.serial import open_link
from tests.conformance.tolerance import too_busy
from tests.guest import gadget, vhci
from tests.guest.far_end import far_end
from tests.guest.gadget import GadgetPort, acm_gadget
from tests.guest.hits import MODEL, check_ended_safely, struck_trial, whole_hit

pytestmark = pytest.mark.skipif(not gadget.is_here(), reason="no dummy_hcd here: run .ci/guest")

PORT = "/dev/ttyACM0"
URL = f"serial://{PORT}"


@pytest.fixture(scope="module")
def made() -> Iterator[Any]:
    with acm_gadget("acm-1") as made:
        yield made


@pytest.fixture
def plugged(made: Any) -> Iterator[Any]:
    plug(made)
    yield made
    pull(made)


def plug(made: Any) -> None:
    made.plug()
    vhci.wait_until(f"{PORT} exists", lambda: os.path.exists(PORT))
    vhci.settle()


def pull(made: Any) -> None:
    made.pull()
    vhci.wait_until(f"{PORT} is gone", lambda: not os.path.exists(PORT))
    vhci.settle()


@pytest.fixture
def rig_on_it(made: Any) -> Iterator[Any]:
    with far_end(MODEL, GadgetPort) as end:
        plug(made)
        yield end
        pull(made)


def test_device_list_contains_the_port(plugged: Any) -> None:
    done = CliRunner().invoke(device.list_, ["--json"])
    assert done.exit_code == 0, done.output
    assert URL in {port["url"] for port in json.loads(done.stdout)["ports"]}


def test_a_pulled_plug_is_one_error_whatever_is_called(plugged: Any) -> None:
    link = open_link(DeviceUrl.parse(URL))
    assert link.bytes_per_second is None  # USB does not care for the baud rate
    plugged.pull()
    with pytest.raises(UnpluggedError):
        link.read(20.0)
    with pytest.raises(UnpluggedError):
        link.write(b"x")
    with pytest.raises(UnpluggedError):
        link.read(0.0)
    link.close()
    vhci.wait_until(f"{PORT} is gone", lambda: not os.path.exists(PORT))
    with pytest.raises(DeviceNotFoundError):
        open_link(DeviceUrl.parse(URL))


def test_one_program_at_a_time(plugged: Any) -> None:
    link = open_link(DeviceUrl.parse(URL))
    with pytest.raises(DeviceNotFoundError, match="in use"):
        open_link(DeviceUrl.parse(URL))
    link.close()


def test_a_whole_hit(rig_on_it: Any, tmp_path: Path) -> None:
    ended = whole_hit(URL, tmp_path)
    check_ended_safely(ended, rig_on_it, UnpluggedError)
    assert ended.error is not None or rig_on_it.left().strongest > 0


def test_pulled_in_the_middle_of_a_hit_and_plugged_in_again(
    made: Any, rig_on_it: Any, tmp_path: Path
) -> None:
    ended = struck_trial(URL, tmp_path, made.pull)
    assert isinstance(ended.error, LinkLostError)
    pull(made)  # it may have been lost before it was struck
    plug(made)
    with open_device(URL) as device:
        try:
            found = device.dictionary.device
        except LinkLostError as error:
            too_busy(error)  # a request is given up after 0.1 s, which an emulator may need for itself
    assert found == MODEL.name
    check_ended_safely(ended, rig_on_it, UnpluggedError)
