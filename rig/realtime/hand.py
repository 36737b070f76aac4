"""A small shared file by which a program moves the hand of a simulated rig, and reads how hand and handle moved.

The file contains the command (a sequence number, the wanted position of the hand, the press force) and a ring of the
newest motions of hand and handle, each with its CRC. The driving program writes the command several times a second,
also if nothing changes. Console and sessions write commands, simulated rigs of `rig.devices` read them. This file must
not load the loop and must not wait for the other side.
"""

from __future__ import annotations

import math
import mmap
import os
import stat
import struct
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

from rig.core.errors import ConfigError

MAGIC = b"RIGHAND1"
_VALUES = struct.Struct("<qdd")  # sequence, position, press
_MOTION = struct.Struct("<qqddd")  # number, device time, hand, handle, velocity
_CRC = struct.Struct("<I")
MOTIONS = 128  # in the ring buffer: a quarter of a second of a simulated hand's blocks
WISH_END = len(MAGIC) + _VALUES.size + _CRC.size
_MOTION_BYTES = _MOTION.size + _CRC.size
SIZE = WISH_END + MOTIONS * _MOTION_BYTES
_TRIES = 3
if sys.platform == "win32":
    _NO_WAIT = 0
else:
    _NO_WAIT = os.O_NONBLOCK  # do not wait for a terminal's carrier, if the path is a terminal


@dataclass(frozen=True, slots=True)
class Wish:
    """Command of a driving program for a simulated hand: wanted position and press force.

    Attributes
    ----------
    sequence
        Number of commands written so far; 0 before the first.
    position
        Wanted position of the hand, at the link (rad or m).
    press
        Force with which the hand presses the handle into the wall (N).
    """

    sequence: int
    position: float
    press: float


@dataclass(frozen=True, slots=True)
class HandMotion:
    """Simulated motion of hand and handle at one time; an elastic coupling connects hand and handle.

    Attributes
    ----------
    device_time_ns
        Time on the device's clock (ns), as in the recording's column ``device_time``.
    hand, handle
        Positions of hand and handle, at the link (rad or m), without measurement errors.
    velocity
        Velocity of the handle (rad/s or m/s), without measurement errors.
    """

    device_time_ns: int
    hand: float
    handle: float
    velocity: float


class SharedHand:
    """A simulated hand in a shared file: `create` opens it to move the hand, `open` to read where it must move."""

    def __init__(self, memory: mmap.mmap, path: Path) -> None:
        self.path = path
        self._memory = memory
        motions = self._whole_motions()  # written by a process that opened the file before
        self._latest = self._seen = motions[-1][0] if motions else 0

    @classmethod
    def create(cls, path: str | Path) -> SharedHand:
        """Open the file of a simulated hand for the program that moves the hand; create the file if missing.

        The file is not removed at the end: its directory's owner must do it. Raises `ConfigError` if `path` is another
        kind of file or the file cannot be created.
        """
        path = Path(path)
        try:
            with open(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), "r+b", buffering=0) as file:
                status = os.fstat(file.fileno())
                if stat.S_ISREG(status.st_mode) and status.st_size == 0:
                    file.write((MAGIC + _pack(Wish(0, 0.0, 0.0))).ljust(SIZE, b"\0"))
                return cls._mapped(file.fileno(), path)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot create this file, by which a program moves the simulated hand: {error.strerror}",
                remedy="give a path in a directory that you may write to",
            ) from None

    @classmethod
    def open(cls, path: str | Path) -> SharedHand:
        """Open an existing file to read the hand's commands; `ConfigError` if it is missing or another kind of file."""
        path = Path(path)
        try:
            descriptor = os.open(path, os.O_RDWR | _NO_WAIT)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot open this file, by which a program moves the simulated hand: {error.strerror}",
                remedy="start the program that moves the hand first: it creates the file",
            ) from None
        try:
            return cls._mapped(descriptor, path)
        finally:
            os.close(descriptor)

    @classmethod
    def _mapped(cls, descriptor: int, path: Path) -> SharedHand:
        try:
            if os.fstat(descriptor).st_size == SIZE:
                memory = mmap.mmap(descriptor, SIZE)
                if memory[: len(MAGIC)] == MAGIC:
                    return cls(memory, path)
                memory.close()
        except (OSError, ValueError):  # a directory, a pipe
            pass
        raise ConfigError(
            f"{path} is another kind of file, not the one by which a program moves the simulated hand",
            remedy="give the path that the program uses which moves the hand, or a new path",
        )

    def move(self, position: float, press: float) -> None:
        """Write the command for the simulated hand: position (rad or m, at the link) and press force into the wall (N).

        Call `move` several times a second, also without a change; else the hand lets go. Raises `ConfigError` if a
        value is not finite.
        """
        if not (math.isfinite(position) and math.isfinite(press)):
            raise ConfigError(
                f"the hand's position {position} (rad or m) or its press force {press} N is not finite",
                remedy="give finite numbers for position and force",
            )
        last = self.read()
        # Also without a change: a number that stands still means that the hand has let go.
        sequence = (0 if last is None else last.sequence) + 1
        self._memory[len(MAGIC) : WISH_END] = _pack(Wish(sequence, position, press))

    def read(self) -> Wish | None:
        """Return the newest command for the simulated hand; None if the driving program is writing at this moment."""
        # No lock and no memory order: a half-written entry fails its CRC and is read again.
        for _ in range(_TRIES):
            data = self._memory[len(MAGIC) : WISH_END]
            (crc,) = _CRC.unpack_from(data, _VALUES.size)
            if zlib.crc32(data[: _VALUES.size]) == crc:
                return Wish(*_VALUES.unpack_from(data))
        return None

    def tell(self, motion: HandMotion) -> None:
        """Write one simulated motion of hand and handle to the file, for the driving program."""
        self._latest += 1
        values = _MOTION.pack(
            self._latest, motion.device_time_ns, motion.hand, motion.handle, motion.velocity
        )
        place = WISH_END + self._latest % MOTIONS * _MOTION_BYTES
        self._memory[place : place + _MOTION_BYTES] = values + _CRC.pack(zlib.crc32(values))

    def motions(self) -> list[HandMotion]:
        """Return the simulated motions since the last call, oldest first, at most the newest 128."""
        fresh = [one for one in self._whole_motions() if one[0] > self._seen]
        self._seen = max((number for number, _ in fresh), default=self._seen)
        return [motion for _, motion in fresh]

    def _whole_motions(self) -> list[tuple[int, HandMotion]]:
        """Return (number, motion) of each motion in the file whose CRC is right, sorted by number."""
        found = []
        for place in range(WISH_END, SIZE, _MOTION_BYTES):
            data = self._memory[place : place + _MOTION_BYTES]
            number, *motion = _MOTION.unpack_from(data)
            if number > 0 and zlib.crc32(data[: _MOTION.size]) == _CRC.unpack_from(data, _MOTION.size)[0]:
                found.append((number, HandMotion(*motion)))
        return sorted(found, key=lambda one: one[0])

    def close(self) -> None:
        """Close the shared file of the simulated hand without removing it."""
        self._memory.close()

    def __enter__(self) -> SharedHand:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _pack(wish: Wish) -> bytes:
    values = _VALUES.pack(wish.sequence, wish.position, wish.press)
    return values + _CRC.pack(zlib.crc32(values))
