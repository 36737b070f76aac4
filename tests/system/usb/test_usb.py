"""USB links over a real libusb: conformance, and one typed error for each fault of a cable.

umockdev emulates the bus (`bridge.c`); the device is the simulated one. No latency below seconds is asserted.
"""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.system.usb import checks
from tests.system.usb.emulated_bus import Bus, Child, build

pytestmark = pytest.mark.exhaustive(
    "tests/rig/devices/test_usb.py::test_any_other_error_of_opening_is_typed_and_gives_the_bus_back"
)

Check = Callable[..., Any]

SECONDS = 5_000.0  # ms
RATE = 400  # Hz: each ioctl of the emulated bus costs about 0.1 ms


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("bridge"))


@pytest.fixture(scope="module")
def child() -> Iterator[Child]:
    """Start one process for all checks: it loads everything once, and opens a new link for each."""
    process = Child()
    yield process
    assert process.close() == 0


@pytest.fixture(scope="module")
def bus(program: Path) -> Iterator[Bus]:
    with closing(Bus(program, rate=RATE)) as one:
        yield one


@pytest.fixture(params=["queued", "plain"])
def check(request: pytest.FixtureRequest, child: Child, bus: Bus) -> Check:
    """Return a function that runs a check by its name, with one transfer mode."""
    return partial(child.check, bus, request.param)


LINK = """
conforms_as_a_link conforms_as_a_device bytes_keep_their_order opening_clears_a_halt a_busy_device_is_refused
a_driver_of_the_kernel_gives_way_and_comes_back nothing_is_left_behind a_full_pool_takes_nothing
"""


@pytest.mark.parametrize("what", LINK.split())
def test_a_link(check: Check, what: str) -> None:
    check(what)


EVENTS = [f"an_event_is_one_typed_error {event}" for event in checks.EVENTS]


@pytest.mark.parametrize("event", [*EVENTS, "the_loop_sees_the_unplugging", "replugged"])
def test_each_event_of_a_cable_is_one_typed_error(check: Check, event: str) -> None:
    assert check(event) < SECONDS


def test_waiting_sleeps(check: Check) -> None:
    """A wait that polls would use all 0.1 s of processor time, or call the kernel all the time."""
    burnt_ms, asked = check("waiting")
    assert burnt_ms < 50.0
    assert asked < 30


def test_queued_transfers_need_no_lock_of_the_interpreter(check: Check) -> None:
    """The unarmed device sends about 20 packets in this time; one good attempt of ten suffices on a busy machine."""
    if check("says_how_it_works") == "":
        assert any(check("packets_come_while_python_is_locked") > 5 for _ in range(10))


def test_a_device_is_listed_with_its_url(check: Check) -> None:
    (device,) = check("is_listed")
    assert device == {"url": f"{checks.URL}/0001", "name": "simulated rig", "path": "1-1", "is_rig": True}


def test_plain_transfers_are_noted_with_their_reason(check: Check) -> None:
    note = check("says_how_it_works")
    assert note == "" or "the URL has transfers=plain" in note
