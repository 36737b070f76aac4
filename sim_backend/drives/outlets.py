"""Offer a simulated drive to hosts: at a pseudo-terminal, on a CAN interface, or at a Unix socket that acts as a bus.

A CAN bus is a file descriptor that passes one frame of linux/can.h in each message (`socket_can`). The name of the bus
selects one of two kinds, which are read and written with the same calls:

* ``vcan0``, ``can0``: a network interface, opened as ``socket(AF_CAN, SOCK_RAW, CAN_RAW)`` and bound to it;
* ``/run/…`` (a path): a Unix socket, opened as ``socket(AF_UNIX, SOCK_SEQPACKET)`` and connected to it, for machines
  whose kernel has no CAN. A frame from one host reaches the drive and all other hosts.
"""

import os
import select
import socket
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

from rig.core.errors import ConfigError, DeviceNotFoundError
from sim_backend.drives.socket_can import FD_BYTES, Frames, from_wire, to_wire
from sim_backend.ends.real_time import sleep_until

if sys.platform == "linux":
    from sim_backend.ends.line import PseudoTerminal as RawTerminal

assert sys.platform == "linux"

HOSTS = 8


class UnpluggableTerminal(RawTerminal):
    """A pseudo-terminal that can be unplugged: then the host reads an end of file."""

    _pulled = False

    def unplug(self) -> None:
        """Close the terminal, so that the host reads an end of file."""
        self._pulled = True
        os.close(self.descriptor)

    def read(self, deadline_ns: int) -> bytes:
        """Return bytes from the host; wait for some until the deadline (CLOCK_MONOTONIC, ns), then return b""."""
        if self._pulled:
            sleep_until(deadline_ns)
            return b""
        return super().read(deadline_ns)

    def write(self, frames: bytes) -> None:
        """Send bytes to the host; discard them after `unplug`."""
        if not self._pulled:
            super().write(frames)

    def __exit__(self, *error: object) -> None:
        if not self._pulled:
            super().__exit__(*error)


class DriveSockets:
    """The drive's side of a CAN bus: a CAN socket, or the Unix sockets of all hosts.

    Attributes
    ----------
    place
        Name of the CAN interface, or path of the Unix socket, that a host opens.
    """

    def __init__(self, place: str) -> None:
        self.place = place
        self._listener: socket.socket | None = None
        self._ends: list[socket.socket] = []
        if "/" in place:
            self._listener = _listener(place)
        else:
            self._ends.append(_interface(place))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Leave the bus: a host at a Unix socket reads an end of file, one at a CAN interface receives nothing more."""
        for end in self._ends:
            end.close()
        self._ends = []
        if self._listener is not None:
            self._listener.close()
            self._listener = None
            Path(self.place).unlink(missing_ok=True)

    def read(self, deadline_ns: int) -> bytes:
        """Return the received CAN frames, 72 bytes each; wait for one until the deadline (CLOCK_MONOTONIC, ns)."""
        ready = [*self._ends, *([self._listener] if self._listener is not None else [])]
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select(ready, [], [], remaining_s)
        if self._listener in readable:
            self._ends.append(self._listener.accept()[0])
        frames = b""
        for end in readable:
            if end is not self._listener:
                frames += self._receive(end)
        return frames

    def _receive(self, end: socket.socket) -> bytes:
        message = b""
        with suppress(OSError):
            message = end.recv(FD_BYTES)
        if self._listener is not None and not message:  # the host is gone
            self._ends.remove(end)
            end.close()
        elif self._listener is not None:
            self._send(message, [other for other in self._ends if other is not end])
        return from_wire(message)

    def write(self, frames: bytes) -> None:
        """Send CAN frames (72 bytes each) to the hosts on the bus; a host whose buffer is full loses them."""
        for unit in Frames().split(frames):
            self._send(to_wire(unit), self._ends)

    @staticmethod
    def _send(message: bytes, ends: list[socket.socket]) -> None:
        for end in ends:
            with suppress(OSError):
                end.send(message, socket.MSG_DONTWAIT)


def _listener(place: str) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        listener.bind(place)
    except OSError as error:
        listener.close()
        raise ConfigError(
            f"the socket {place} cannot be created: {error}",
            remedy="give a path that does not exist yet, in a directory with write permission",
        ) from error
    listener.listen(HOSTS)
    return listener


def _interface(name: str) -> socket.socket:
    try:
        end = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        end.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        end.bind((name,))
    except OSError as error:
        raise DeviceNotFoundError(
            f"{name} is not a CAN interface of this computer: {error}",
            remedy=f"create one: ip link add {name} type vcan && ip link set {name} up; if the kernel has no vcan, "
            "give a path with a slash instead, where a socket is created",
        ) from error
    return end
