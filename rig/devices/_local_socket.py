"""Link to a program on this computer through a Unix socket, such as a simulated device that is started for a run.

`rig.devices` loads it for ``unix://``. It must not start or stop the program.
"""

from __future__ import annotations

import os
import socket
import sys
from contextlib import suppress
from shlex import quote

from rig.core import locks
from rig.core.errors import ConfigError, DeviceNotFoundError
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl

if sys.platform == "linux":
    from rig.devices.descriptor import CLOSED, DescriptorLink

assert sys.platform == "linux"


def open_link(url: DeviceUrl, model: RigModel | None = None) -> SocketLink:
    """Open a Unix socket, like ``unix:///run/rig?cpu=1``; `ConfigError` or `DeviceNotFoundError` if it fails.

    `cpu` is the number of the processor on which the program runs; the loop runs on this processor too.
    """
    url.allow(("cpu",))
    cpu = url.options.get("cpu")
    if cpu is not None and not cpu.isdecimal():
        raise ConfigError(
            f"{url.text}: cpu = {cpu!r} is not the number of a processor", remedy="give an integer from 0 on"
        )
    if not url.place:
        raise ConfigError(
            f"{url.text}: the path of the socket is missing", remedy="write it like unix:///run/rig"
        )
    lock = _lock_socket(url.place)
    # Not a pseudo-terminal: the kernel passes on its bytes in a worker thread, which waits for a processor like an
    # ordinary program. Beside two busy programs it is milliseconds late, whatever the priorities at both ends are. A
    # socket wakes its reader directly.
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    end.setblocking(False)
    try:
        end.connect(url.place)
    except OSError as error:
        end.close()
        os.close(lock)
        raise DeviceNotFoundError(
            f"no program listens at the socket {url.place}: {error.strerror or error}",
            remedy="start the program, or give the path of its socket",
        ) from None
    return SocketLink(url, end.detach(), lock, cpu=None if cpu is None else int(cpu))


def _lock_socket(place: str) -> int:
    """Lock a file beside the socket and return its descriptor; raise `DeviceNotFoundError` if it is locked."""
    try:
        lock = os.open(f"{place}.lock", os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        raise DeviceNotFoundError(
            f"no program listens at the socket {place}: {error.strerror or error}",
            remedy="start the program, or give the path of its socket",
        ) from None
    if not locks.lock(lock):
        os.close(lock)
        raise DeviceNotFoundError(
            f"{place} is in use by another program",
            remedy=f"close that program (fuser {quote(place)}.lock shows it)",
        )
    return lock


class SocketLink(DescriptorLink):
    """Link (`rig.devices.device.Link`) over a connected Unix socket."""

    bytes_per_second: float | None = None
    messages: tuple[str, ...] = ()

    def __init__(self, url: DeviceUrl, descriptor: int, lock: int, *, cpu: int | None = None) -> None:
        super().__init__(url, descriptor)
        self._lock = lock
        self.cpu = cpu

    def close(self) -> None:
        """Close the socket and release its lock; a second call does nothing."""
        if self._descriptor != CLOSED:
            with suppress(OSError):
                os.close(self._descriptor)
            os.close(self._lock)
            self._descriptor = CLOSED
