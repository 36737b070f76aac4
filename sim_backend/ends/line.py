"""Offer the device side of a line to a host in another process: as a pseudo-terminal or as a Unix socket.

A line keeps one file descriptor for its whole life, so that compiled code (`loop_port`) and Python can use it. The
descriptor stays open when a host exits, even by kill -9, and the line serves the next host. `pty` and `outlets` use it.
"""

import contextlib
import os
import select
import socket
import sys
import termios
import time
import tty
from pathlib import Path
from typing import Self

from rig.devices.port import LoopPort
from rig.realtime import system
from rig.realtime.clock import MonotonicClock
from sim_backend.ends.real_time import READ_BYTES, sleep_until

assert sys.platform == "linux"

PENDING_BYTES = 8192  # unread output of the device in Python
WAITING_HOSTS = 8  # largest number of hosts that wait at a socket


class Line:
    """The device side of a line, on a non-blocking file descriptor. No method blocks beyond its deadline.

    Attributes
    ----------
    place
        Path that a host opens.
    descriptor
        File descriptor of the device side.
    """

    def __init__(self, place: str, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self.place = place
        self.descriptor = descriptor
        self._pending = b""
        self._hung_up = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self.descriptor)

    def loop_port(self) -> LoopPort:
        """Return compiled functions that read, write and wait on the file descriptor."""
        return LoopPort.on(
            MonotonicClock(),
            read=system.descriptor_read,
            write=system.descriptor_write,
            wait=system.descriptor_wait,
            handle=self.descriptor,
        )

    def next_host(self) -> None:
        """Prepare for the next host, which must find an empty line; called after a read has failed."""
        raise NotImplementedError

    def read(self, deadline_ns: int) -> bytes:
        """Return bytes from the host; wait for some until the deadline (CLOCK_MONOTONIC, ns), then return b""."""
        if self._hung_up:  # the descriptor polls as readable then: sleep instead, and look once
            sleep_until(deadline_ns)
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select([self.descriptor], [], [], remaining_s)
        data = b""
        if readable:
            with contextlib.suppress(OSError):
                data = os.read(self.descriptor, READ_BYTES)
            if not data:
                self._pending = b""
                self.next_host()
        self._hung_up = bool(readable and not data)
        return data

    def write(self, frames: bytes) -> None:
        """Send frames now, or when the host reads; discard them if more than 8 KiB (`PENDING_BYTES`) are unread."""
        if self._hung_up:
            return
        self._flush()
        # What a host does not read in time is discarded, newest first, whole frames only.
        if frames and len(self._pending) + len(frames) <= PENDING_BYTES:
            self._pending += frames
            self._flush()

    def _flush(self) -> None:
        if not self._pending:
            return
        with contextlib.suppress(OSError):
            self._pending = self._pending[os.write(self.descriptor, self._pending) :]

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame unless older ones still wait; the host sees the loss from the sequence numbers."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)


class PseudoTerminal(Line):
    """The device side (master) of a pseudo-terminal in raw mode."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        super().__init__(os.ttyname(slave), master)
        tty.setraw(slave)
        os.close(slave)  # from now on a read error (EIO) means that no host has the terminal open

    def next_host(self) -> None:
        """Discard the bytes that the last host has not read: the terminal driver stores up to 4 KiB."""
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.place, os.O_RDWR | os.O_NOCTTY)
            termios.tcflush(slave, termios.TCIFLUSH)
            os.close(slave)


class Socket(Line):
    """The device side of a Unix socket at a path, used by one host at a time.

    The descriptor is either the listening or the connected socket. A read from the listening socket fails when a host
    connects, a read from the connected socket when the host disconnects.
    """

    def __init__(self, path: Path) -> None:
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.bind(str(path))
        self._listener.listen(WAITING_HOSTS)
        self._connected = False
        super().__init__(str(path), os.dup(self._listener.fileno()))

    def __exit__(self, *error: object) -> None:
        super().__exit__(*error)
        self._listener.close()
        Path(self.place).unlink(missing_ok=True)

    def next_host(self) -> None:
        """Accept the waiting host, or listen again after a host has disconnected."""
        now = self._listener
        if not self._connected:
            try:
                now, _ = self._listener.accept()
            except OSError:  # it went before its turn
                return
            now.setblocking(False)
        os.dup2(now.fileno(), self.descriptor)
        self._connected = now is not self._listener
        if self._connected:
            now.close()
