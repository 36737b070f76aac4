"""Offer the device's end of a line to a host in another process: a pseudo-terminal for serial programs, or a socket.

Either is one descriptor for its whole life, so that compiled code (`loop_port`) and Python move its bytes. It stays
when a host exits, even by kill -9, and serves the next one.
"""

from __future__ import annotations

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

PENDING_BYTES = 8192  # answers of the readable device that the host has not read yet
WAITING_HOSTS = 8  # for their turn at a socket


class Line:
    """A non-blocking descriptor. No call blocks beyond its deadline.

    Attributes
    ----------
    place
        Path that a host opens.
    descriptor
        This end.
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
        """Return the system calls on the descriptor, for compiled code."""
        return LoopPort.on(
            MonotonicClock(),
            read=system.descriptor_read,
            write=system.descriptor_write,
            wait=system.descriptor_wait,
            handle=self.descriptor,
        )

    def next_host(self) -> None:
        """Make ready for the next host, who begins with an empty line; called when reading fails."""
        raise NotImplementedError

    def read(self, deadline_ns: int) -> bytes:
        """Return what the host sent, waiting for it until the deadline; without a host, nothing, at the deadline."""
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
        """Send answers, now or as soon as the host reads; a host that leaves kilobytes unread loses them."""
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
        """Send a frame that is worth nothing later, unless older ones still wait; its sequence shows the loss."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)


class PseudoTerminal(Line):
    """The master side of a pseudo-terminal in raw mode."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        super().__init__(os.ttyname(slave), master)
        tty.setraw(slave)
        os.close(slave)  # from now on a hang-up shows that no host has it open

    def next_host(self) -> None:
        """Throw away what the host that went has not read: the line discipline keeps 4 KiB of it for ever."""
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.place, os.O_RDWR | os.O_NOCTTY)
            termios.tcflush(slave, termios.TCIFLUSH)
            os.close(slave)


class Socket(Line):
    """A Unix socket at a path, which one host has at a time.

    The descriptor is the socket that listens or the one that is connected: reading from the former fails when a host
    comes, from the latter when it goes.
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
        """Take the host that waits, or listen when one is gone."""
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
