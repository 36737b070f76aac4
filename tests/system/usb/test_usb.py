"""USB links over a real libusb: conformance, and one typed error for each thing that can happen to a cable.

The bus is umockdev's (`bridge.c`), the device the simulated one. Nothing is asserted about latency beyond seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

from tests.system.usb import checks
from tests.system.usb.bench import Bus, Child, build

if numba.config.DISABLE_JIT:
    pytest.skip("the device's plant is too slow for real time uncompiled", allow_module_level=True)

SECONDS = 5_000.0  # ms
RATE = 200  # Hz: each ioctl of the emulated bus costs about 0.1 ms


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("bridge"))


@pytest.fixture(scope="module", params=["queued", "plain"])
def child(request: pytest.FixtureRequest, program: Path) -> Iterator[Child]:
    bus = Bus(program, rate=RATE)
    try:
        process = Child(bus, request.param)
        yield process
        assert process.close() == 0
    finally:
        bus.close()


@pytest.mark.parametrize(
    "check",
    [
        "conforms_as_a_link",
        "conforms_as_a_device",
        "bytes_keep_their_order",
        "opening_clears_a_halt",
        "busy_is_said",
        "a_driver_of_the_kernel_is_detached",
        "nothing_is_left_behind",
    ],
)
def test_a_link(child: Child, check: str) -> None:
    child.check(check)


@pytest.mark.parametrize(
    "event",
    [
        "unplugged_while_reading",
        "unplugged_while_writing",
        "the_loop_sees_the_unplugging",
        "stalled_while_reading",
        "stalled_while_writing",
        "more_came_than_was_asked_for",
        "bits_are_damaged",
        "takes_only_a_part",
        "takes_no_more_bytes",
        "replugged",
    ],
)
def test_what_happens_to_a_cable_is_one_typed_error_soon(child: Child, event: str) -> None:
    after_ms = child.check(event)
    print(f"{event}: {after_ms:.1f} ms")
    assert after_ms < SECONDS


def test_a_device_that_takes_nothing_costs_no_time(child: Child) -> None:
    child.check("a_full_pool_takes_nothing")


def test_waiting_sleeps(child: Child) -> None:
    """Half a second without a byte; a wait that polls would burn all of it."""
    assert child.check("waiting_costs_no_time_of_the_processor") < 250.0


def test_a_device_is_listed_with_its_url(child: Child) -> None:
    (device,) = child.check("is_listed")
    assert device == {"url": f"{checks.URL}/0001", "name": "simulated rig", "path": "1-1", "is_rig": True}


def test_the_slow_way_is_said(child: Child) -> None:
    note = child.check("says_how_it_works")
    assert note == "" or "the URL asks for it" in note


URLS = [checks.URL, f"{checks.URL}?transfers=plain"]
SETTINGS = ["--set", "sampling.position_rate=500", "--set", "verdict.late_fraction=0.9"]


@pytest.mark.parametrize("url", URLS)
def test_a_whole_hit(program: Path, tmp_path: Path, url: str) -> None:
    """Homing, wall, judgement and recording; or, on a machine that has no time, a typed loss, counted and recorded."""
    code, told = _hit(program, tmp_path, url)
    assert code in (0, LinkLostError.exit_code, DeviceFaultError.exit_code)
    (path,) = tmp_path.glob("*.parquet")
    rows = reader.read(path)
    assert len(rows) > 50
    assert told["error"] is None or told["error"]["kind"] in ("LinkLostError", "DeviceFaultError")


@pytest.mark.parametrize("url", URLS)
def test_a_plug_pulled_in_a_hit(program: Path, tmp_path: Path, url: str) -> None:
    code, told = _hit(program, tmp_path, url, "unplug")
    assert code in (LinkLostError.exit_code, DeviceFaultError.exit_code)
