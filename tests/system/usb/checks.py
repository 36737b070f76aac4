"""Checks of USB links, run by name in a process whose libusb sees the emulated bus. Times are in ms."""

import contextlib
import ctypes
import errno
import os
import threading
import time
from collections.abc import Callable
from typing import Any, TextIO
from unittest.mock import patch

import numpy as np
import pytest
from numba import types

from firmware_protocol import messages as m
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
from rig.devices import _usb_plain as usb_plain
from rig.devices import _usb_queue as usb_queue
from rig.devices import open_link
from rig.devices.usb import UsbLink, available_devices
from rig.realtime.kernel import kernel, prepare
from rig.realtime.plugs import TRANSFER, WAIT
from rig.realtime.system import monotonic_now
from tests.conformance.device import check_device
from tests.conformance.host import Host
from tests.conformance.link import check_link, give, listen

SLACK_S = 5.0  # of a loaded machine
URL = "usb://1209:0001"


@kernel(types.int64(TRANSFER, WAIT, types.int64, types.uint8[::1], types.int64))
def count_reads(read: Any, wait: Any, handle: Any, into: Any, deadline_ns: Any) -> Any:  # type: ignore[no-untyped-def]
    """Read until a deadline; return how often bytes arrived, or a negative errno."""
    count = 0
    while monotonic_now(0) < deadline_ns:
        ready = wait(handle, deadline_ns)
        if ready > 0:
            ready = read(handle, into.ctypes.data + 0, len(into))
        if ready < 0:
            return ready
        count += ready > 0
    return count


class Cable:
    """Opens links to the emulated device and orders faults of the cable, over pipes to and from the bridge."""

    def __init__(self, orders: TextIO, answers: TextIO, transfers: str) -> None:
        self.url = f"{URL}?transfers={transfers}"
        self._orders, self._answers = orders, answers
        self._opened: list[UsbLink] = []

    def open(self) -> UsbLink:
        link = open_link(self.url)
        assert isinstance(link, UsbLink)
        self._opened.append(link)
        return link

    def open_silent(self) -> UsbLink:
        self.order("silent")
        return self.open()

    def order(self, command: str) -> int:
        """Order an event on the cable, such as "unplug"; return when it happened (CLOCK_MONOTONIC, ns)."""
        self._orders.write(command + "\n")
        word, _, rest = self._answers.readline().partition(" ")
        assert word == "ok", f"{command}: {word} {rest}"
        return int(rest)

    def status(self) -> dict[str, int]:
        self._orders.write("status\n")
        words = self._answers.readline().split()
        assert self._answers.readline().startswith("ok")
        return {name: int(number) for name, number in zip(words[::2], words[1::2], strict=True)}

    def tidy(self) -> None:
        for link in self._opened:
            link.close()
        self._opened.clear()
        for command in ("plug", "speak", "whole", "free"):
            self.order(command)


def conforms_as_a_link(cable: Cable) -> None:
    def speaking() -> UsbLink:
        cable.order("speak")
        return cable.open()

    check_link(speaking, cable.open_silent, slack_s=SLACK_S)


def conforms_as_a_device(cable: Cable) -> None:
    """Try up to four times: a process halted for longer than a command's lifetime makes the device fault."""
    for last in (False, False, False, True):
        try:
            check_device(cable.open, starts_in_boot=False)
        except AssertionError:
            if last:
                raise
            cable.tidy()
            heir = Host(cable.open(), first_nonce=30_000)
            heir.identify()
            time.sleep(0.2)  # the device notices that its host is gone
            heir.disarm(clear_fault=True)
            cable.tidy()
        else:
            return


def says_how_it_works(cable: Cable) -> str:
    return cable.open().note


def is_listed(cable: Cable) -> list[dict[str, Any]]:
    return [
        {"url": device.url, "name": device.product, "path": device.path, "is_rig": device.is_rig}
        for device in available_devices()
    ]


def _read_long(link: UsbLink) -> None:
    deadline = time.monotonic() + SLACK_S
    while time.monotonic() < deadline:
        link.read(SLACK_S)


def _write_long(link: UsbLink) -> None:
    deadline = time.monotonic() + SLACK_S
    while time.monotonic() < deadline:
        link.write(b"\0" * 8)
        time.sleep(1e-3)


# What happens to a cable → the error of the link that is in use, its use, and the order.
EVENTS: dict[str, tuple[type[LinkLostError], Callable[[UsbLink], None], str]] = {
    "unplugged while reading": (UnpluggedError, _read_long, "unplug"),
    "unplugged while writing": (UnpluggedError, _write_long, "unplug"),
    "stalled while reading": (StalledError, _read_long, "stall in"),
    "stalled while writing": (StalledError, _write_long, "stall out"),
    "more came than was asked for": (OverflowedError, _read_long, "overflow"),
    "bits are damaged": (BrokenLineError, _read_long, "broken"),
    "takes only a part": (CutShortError, _write_long, "short"),
    "takes no more bytes": (BlockedError, _write_long, "silent"),
}


@patch.object(usb_queue, "OUT_LIMIT_S", 0.1)
@patch.object(usb_plain, "OUT_LIMIT_S", 0.1)
def an_event_is_one_typed_error(cable: Cable, *event: str) -> float:
    """Order a fault while a thread uses the link; return the time from the order to its error (ms)."""
    kind, act, order = EVENTS[" ".join(event)]
    link = cable.open()
    Host(link).identify()
    caught: list[tuple[int, BaseException]] = []

    def body() -> None:
        try:
            act(link)
        except BaseException as error:
            caught.append((time.monotonic_ns(), error))

    thread = threading.Thread(target=body)
    thread.start()
    time.sleep(0.02)  # it is blocked by now, or works: both are right
    happened_ns = cable.order(order)
    thread.join(SLACK_S)
    assert not thread.is_alive()
    (at_ns, error), *_ = caught
    assert type(error) is kind, repr(error)
    assert error.remedy
    assert URL in error.message
    with contextlib.suppress(LinkLostError):  # it may work in one direction; no other error may come
        link.read(0.01)
    with contextlib.suppress(LinkLostError):
        for _ in range(40):
            link.write(b"\0" * 8)
    return (at_ns - happened_ns) * 1e-6


def the_loop_sees_the_unplugging(cable: Cable) -> float:
    """Check that a read through the compiled port functions, on a thread without the GIL, reports the unplugging."""
    link = cable.open()
    port = link.port()
    buffer = np.zeros(4096, np.uint8)
    answers: list[tuple[int, int]] = []

    def body() -> None:
        got = 1
        while got >= 0:
            got = listen(
                port.read, port.wait, port.handle, buffer, time.monotonic_ns() + round(SLACK_S * 1e9)
            )
        answers.append((time.monotonic_ns(), got))

    thread = threading.Thread(target=body)
    thread.start()
    time.sleep(0.02)
    happened_ns = cable.order("unplug")
    thread.join(SLACK_S)
    (at_ns, got) = answers[0]
    assert got == -errno.ENODEV
    assert give(port.write, port.handle, np.zeros(16, np.uint8)) in (-errno.ENODEV, -errno.EIO)
    return (at_ns - happened_ns) * 1e-6


def a_full_pool_takes_nothing(cable: Cable) -> None:
    """Check that a write to a full transfer pool returns 0 without an error, and succeeds again later."""
    link = cable.open_silent()
    port = link.port()
    frame = np.zeros(32, np.uint8)
    taken = [give(port.write, port.handle, frame) for _ in range(20)]
    assert 0 in taken
    assert set(taken) <= {0, 32}
    assert taken == sorted(taken, reverse=True), "what is under way stays under way"
    deadline = time.monotonic() + SLACK_S
    last = 0
    while last == 0 and time.monotonic() < deadline:
        last = give(port.write, port.handle, frame)
        time.sleep(0.01)
    assert last == -errno.ETIMEDOUT


def bytes_keep_their_order(cable: Cable) -> None:
    """Write requests in pieces of every size and read the reply in pieces: nothing is lost, doubled or swapped."""
    link = cable.open()
    host = Host(link)
    for size in (1, 7, 63, 64, 65, 511):
        request = b"".join(host.connection.send(m.Identify(host.nonce(), 0)) for _ in range(8))
        for start in range(0, len(request), size):
            link.write(request[start : start + size])
        answered = 0
        deadline = time.monotonic() + SLACK_S
        while answered < 8 and time.monotonic() < deadline:
            answered += sum(isinstance(event.message, m.Identity) for event in host.events(0.1))
        assert answered == 8


def replugged(cable: Cable) -> float:
    """Check that the old link stays lost and that a new link finds the new device; return the time (ms)."""
    old = cable.open()
    Host(old).identify()
    cable.order("unplug")
    with pytest.raises(UnpluggedError):
        _read_long(old)
    with pytest.raises(DeviceNotFoundError, match="there is no USB device 1209:0001"):
        cable.open()
    plugged_ns = cable.order("plug")
    with pytest.raises(LinkLostError):
        old.read(0.0)
    new = cable.open()
    Host(new).identify()
    found_ns = time.monotonic_ns()
    old.close()
    Host(new, first_nonce=100).identify()
    return (found_ns - plugged_ns) * 1e-6


def opening_clears_a_halt(cable: Cable) -> None:
    link = cable.open()
    cable.order("stall in")
    with pytest.raises(StalledError):
        _read_long(link)
    link.close()
    Host(cable.open()).identify()


def a_busy_device_is_refused(cable: Cable) -> None:
    cable.order("busy")
    with pytest.raises(DeviceNotFoundError, match="in use by another program") as caught:
        cable.open()
    assert "fuser /dev/bus/usb/001/" in caught.value.remedy


def a_driver_of_the_kernel_gives_way_and_comes_back(cable: Cable) -> None:
    def moved() -> tuple[int, int]:
        status = cable.status()
        return status["detached"], status["attached"]

    detached, attached = moved()
    cable.order("driver cdc_acm")
    link = cable.open()
    Host(link).identify()
    assert moved() == (detached + 1, attached)
    link.close()
    assert moved() == (detached + 1, attached + 1)
    cable.open().close()
    assert moved() == (detached + 1, attached + 1)


def nothing_is_left_behind(cable: Cable) -> None:
    """Check that closed links leave no descriptor, thread, pending transfer or claimed interface."""

    def kept() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))

    found = []
    for _ in range(4):
        with contextlib.closing(cable.open()) as link:
            Host(link).identify()
        found.append(kept())
    assert len(set(found[1:])) == 1, "the first time libraries start threads of their own"
    status = cable.status()
    assert (status["pending"], status["claimed"]) == (0, 0), status


def waiting(cable: Cable) -> tuple[float, int]:
    """Wait 0.1 s without a byte; return the processor time (ms) and the number of calls to the kernel."""
    link = cable.open_silent()
    link.read(0.01)  # what is compiled or loaded for it is not the wait's
    asked, before = cable.status()["asked"], time.process_time()
    assert link.read(0.1) == b""
    return (time.process_time() - before) * 1e3, cable.status()["asked"] - asked


def packets_come_while_python_is_locked(cable: Cable) -> int:
    """Hold the GIL while compiled code reads; return how many packets it received."""
    link = cable.open()
    Host(link).identify()
    port = link.port()
    prepare(count_reads, port.read, port.wait)
    into = np.zeros(4096, np.uint8)
    counts: list[int] = []
    begun = threading.Event()

    def body() -> None:
        begun.set()
        counts.append(count_reads(port.read, port.wait, port.handle, into, time.monotonic_ns() + 200_000_000))

    thread = threading.Thread(target=body)
    thread.start()
    begun.wait(SLACK_S)
    time.sleep(0.05)  # it is in compiled code by now
    ctypes.PyDLL(None).usleep(250_000)
    thread.join(SLACK_S)
    return counts[0]
