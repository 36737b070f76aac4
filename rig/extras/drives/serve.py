"""Run a bridge in a process: find the drive, compare it with the rig, and run the C code between bus and host.

The drive is off before and afterwards, also if the process ends by SIGINT, SIGTERM or because the host has closed its
end. If the process cannot switch the drive off (kill -9, a computer that hangs), the drive's own watchdog does, after
five periods.
"""

import contextlib
import os
import signal
import socket
import sys
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.extras.drives.library import Bridge, FittedDrive
from rig.extras.drives.library import BridgeFacts as BusFacts
from rig.realtime.scheduling import BoardScheduling, obtained

if sys.platform == "linux":
    from rig.extras.drives.address import DriveFacts, address_of
    from rig.extras.drives.bus import open_bus

assert sys.platform == "linux"


@dataclass(frozen=True, slots=True)
class Found:
    """Report of a ready bridge: the drive, messages about settings that could not be applied, the process id."""

    drive: FittedDrive
    messages: tuple[str, ...]
    process: int


def look(url: DeviceUrl) -> DriveFacts:
    """Return the facts that the drive at a URL reports, without changing it; raise `RigError` if it is not usable."""
    address = address_of(url)
    with contextlib.closing(open_bus(url)) as bus:
        return address.look(bus)


def serve(
    url: DeviceUrl,
    model: RigModel,
    *,
    host: socket.socket | None = None,
    announce: Callable[[str, Found], object] = lambda place, found: None,
    facts: BusFacts | None = None,
    realtime: str = "try",
    cpu: int | None = None,
) -> None:
    """Run a bridge (firmware on this computer in front of a drive) until it is stopped.

    Raises `RigError` if the drive is missing, its replies are wrong, or it does not match the rig; nothing has moved.

    Parameters
    ----------
    url
        URL of the drive: ``moteus:///dev/fdcanusb?id=1``, ``moteus://can0``, ``odrive://can0?endpoints=FILE``.
    model
        Rig that the drive moves.
    host
        Connected socket to the host; the bridge ends when the host closes it. None: a pseudo-terminal, which serves one
        host after the other.
    announce
        Called once with the path of the port ("" for a socket), when a host may connect.
    facts
        Memory for the statistics of the bus.
    realtime, cpu
        Scheduling (see ``host.realtime``) and processor.
    """
    address = address_of(url)
    bus = open_bus(url)
    with contextlib.closing(bus), obtained(BoardScheduling(realtime, cpu=cpu)) as granted:
        found = address.find(bus, model)
        bridge = Bridge(model, found, checksum=bus.checksum, socket=bus.is_socket, facts=facts)
        with _open_host_end(host) as (descriptor, place), _wake_on_signal() as wake:
            granted.enter_thread()
            try:
                announce(place, Found(found, (*bus.messages, *granted.messages), os.getpid()))
                bridge.run(host=descriptor, bus=bus.descriptor, wake=wake, host_stays=host is None)
            finally:
                granted.leave_thread()


@contextlib.contextmanager
def _open_host_end(host: socket.socket | None) -> Iterator[tuple[int, str]]:
    """Yield the file descriptor by which the firmware receives from the host, and the path that a host opens.

    The path is "" if `host` is a connected socket; otherwise a pseudo-terminal is opened.
    """
    if host is not None:
        host.setblocking(False)
        yield host.fileno(), ""
        return
    master, slave = os.openpty()
    try:
        place = os.ttyname(slave)
        tty.setraw(slave)
        # With this end closed, the other end reports a hang-up while no host has the port open.
        os.close(slave)
        os.set_blocking(master, False)
        yield master, place
    finally:
        os.close(master)


@contextlib.contextmanager
def _wake_on_signal() -> Iterator[int]:
    """Yield a file descriptor that becomes readable on SIGINT or SIGTERM."""
    readable, writable = os.pipe()
    os.set_blocking(writable, False)
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(one, lambda *_: None) for one in numbers]
    # While C code runs, Python calls no signal handler, but it still writes to this descriptor.
    wakes_before = signal.set_wakeup_fd(writable)
    try:
        yield readable
    finally:
        signal.set_wakeup_fd(wakes_before)
        for one, handler in zip(numbers, before, strict=True):
            signal.signal(one, handler)
        os.close(readable)
        os.close(writable)
