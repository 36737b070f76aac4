"""The simulated rig as a process of its own: a pseudo-terminal that any serial program opens, in real time.

The device here is the one of `device`, its clock that of `real_time`; this file gives it a port.

It mirrors a USB serial device: it stays when a host goes, even by kill -9, and its watchdog knows of that only by
the silence. After the hang-up of the line it writes nothing, for it would not be read; what a host does not read in
time is thrown away, newest first, whole frames only.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.devices.hand import SharedHand
from sim_backend.device import SimulatedDevice
from sim_backend.driven_hand import DrivenHand
from sim_backend.firmware import FirmwareDevice
from sim_backend.real_time import READ_BYTES, FirmwareTime, Port, RealTime, sleep_until

POSITION_RATE_DEFAULT = 1_000
POSITION_RATE_MAXIMUM = 4_000  # what an ordinary kernel wakes a Python process for, with room for the frames
FIRMWARE_RATE_MAXIMUM = (
    20_000  # of compiled ticks, which need no waking each; beyond, a line of 3 Mbaud is full
)
PENDING_BYTES = 8192  # answers that the host has not read yet
FIRMWARE_PENDING_BYTES = 65536  # and BATCH of 100 ms and more


def serve(
    model: RigModel,
    *,
    rate: int = POSITION_RATE_DEFAULT,
    seed: int = 0,
    name: str | None = None,
    firmware: bool = False,
    hand: str | Path | None = None,
    announce: Callable[[str], None] = print,
    stop_event: threading.Event | None = None,
    link_path: str | Path | None = None,
    duration_s: float | None = None,
) -> None:
    """Run a simulated rig behind a pseudo-terminal until it is stopped.

    Parameters
    ----------
    model
        The physics.
    rate
        Ticks a second (Hz) that the device advertises and runs until it is configured.
    seed
        Of the sensor noise.
    name
        What the device calls itself; the model's name unless given.
    firmware
        The device is the firmware itself, compiled for this machine, which can run the law.
    hand
        File through which a person drives the hand at the handle (`rig.devices.hand`); without one it plays its
        script.
    announce
        Called once with the path of the port, when a host can open it.
    stop_event
        Ends the run when it is set.
    link_path
        A symbolic link to make to the port, for a name that stays; removed at the end.
    duration_s
        Ends the run after this time (s).

    Notes
    -----
    Called in the main thread it also ends, cleanly, on SIGINT (Ctrl-C) and SIGTERM.

    Raises
    ------
    ConfigError
        A rate that the port cannot carry, `link_path` exists and is no symbolic link, or the firmware cannot be made;
        no such hand, or a rig that is not held by a person.
    """
    maximum = FIRMWARE_RATE_MAXIMUM if firmware else POSITION_RATE_MAXIMUM
    if not 50 <= rate <= maximum:
        raise ConfigError(
            f"rate = {rate} Hz is outside 50 … {maximum}",
            remedy="run faster in virtual time (sim://)"
            + ("" if firmware else f", or as firmware, up to {FIRMWARE_RATE_MAXIMUM} Hz"),
        )
    stop = stop_event or threading.Event()
    timed = _timed_firmware if firmware else _timed_device
    pending = FIRMWARE_PENDING_BYTES if firmware else PENDING_BYTES
    with _Port(pending) as port:
        body = timed(model, port, stop, name=name, position_rate_default=rate, seed=seed)
        with _driven(body, model, hand), _linked(link_path, port.path), _signals(stop):
            announce(str(link_path) if link_path is not None else port.path)
            body.run(duration_s)


# No truth is kept: it would grow without bound, and could not be read.


def _timed_device(model: RigModel, port: Port, stop: threading.Event, **options: Any) -> RealTime:
    options |= {"position_rate_maximum": POSITION_RATE_MAXIMUM, "keep_truth": False}
    return RealTime(SimulatedDevice(model, **options), port, stop)


def _timed_firmware(model: RigModel, port: Port, stop: threading.Event, **options: Any) -> FirmwareTime:
    options |= {"position_rate_maximum": FIRMWARE_RATE_MAXIMUM, "keep_truth": False}
    return FirmwareTime(FirmwareDevice(model, **options), port, stop)


@contextlib.contextmanager
def _driven(body: RealTime | FirmwareTime, model: RigModel, hand: str | Path | None) -> Iterator[None]:
    """Let a person drive the hand, if there is a file for it."""
    if hand is None:
        yield
        return
    with SharedHand.open(hand) as shared:
        body.device.hardware.drive_hand(DrivenHand(model, shared.read))
        yield


class _Port:
    """The master side of a pseudo-terminal in raw mode. No call blocks beyond its deadline."""

    def __init__(self, pending: int = PENDING_BYTES) -> None:
        self._room = pending
        self._master, slave = os.openpty()
        self.path = os.ttyname(slave)
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        os.close(slave)  # from now on a hang-up shows that no host has it open
        self._pending = b""
        self._hung_up = False

    def __enter__(self) -> _Port:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._master)

    def read(self, deadline_ns: int) -> bytes:
        """Return what the host sent, waiting for it until the deadline; without a host, nothing, at the deadline."""
        if self._hung_up:  # the descriptor polls as readable then: sleep instead, and look once
            sleep_until(deadline_ns)
        remaining_s = max(0, deadline_ns - time.monotonic_ns()) * 1e-9
        readable, _, _ = select.select([self._master], [], [], remaining_s)
        if not readable:
            self._hung_up = False
            return b""
        try:
            data = os.read(self._master, READ_BYTES)
        except OSError:
            self._hang_up()
            return b""
        self._hung_up = False
        return data

    def write(self, frames: bytes) -> None:
        """Send answers, now or as soon as the host reads; a host that leaves kilobytes unread loses them."""
        if self._hung_up:
            return
        self._flush()
        if frames and len(self._pending) + len(frames) <= self._room:
            self._pending += frames
            self._flush()

    def _flush(self) -> None:
        if not self._pending:
            return
        with contextlib.suppress(OSError):
            self._pending = self._pending[os.write(self._master, self._pending) :]

    def write_if_free(self, frame: bytes) -> None:
        """Send a frame that is worth nothing later, unless older ones still wait; its sequence shows the loss."""
        if self._pending:
            self.write(b"")
        if not self._pending:
            self.write(frame)

    def _hang_up(self) -> None:
        """When a host goes, what it has not read goes too: the next one begins with an empty line."""
        if not self._hung_up:
            self._hung_up = True
            self._pending = b""
            with contextlib.suppress(OSError, termios.error):
                slave = os.open(
                    self.path, os.O_RDWR | os.O_NOCTTY
                )  # its line discipline keeps 4 KiB for ever
                termios.tcflush(slave, termios.TCIFLUSH)
                os.close(slave)


@contextlib.contextmanager
def _linked(link_path: str | Path | None, target: str) -> Iterator[None]:
    """Keep a symbolic link to the port while it is open."""
    if link_path is None:
        yield
        return
    link = Path(link_path)
    if link.exists() and not link.is_symlink():
        raise ConfigError(f"{link} exists and is not a symbolic link", remedy="choose another path")
    try:
        link.unlink(missing_ok=True)
        link.symlink_to(target)
    except OSError as error:
        raise ConfigError(f"{link} cannot be made: {error}", remedy="choose another path") from error
    try:
        yield
    finally:
        if link.is_symlink() and os.readlink(link) == target:
            link.unlink()


@contextlib.contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Turn SIGINT and SIGTERM into `stop` while this lasts; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
