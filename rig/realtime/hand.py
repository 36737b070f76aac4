"""What somebody's hand wants, in a small shared file: whoever moves a mouse writes it, a simulated rig reads it.

The file holds a sequence number, a position, a press and their CRC. Writer and reader need no lock and no order of
memory: what was caught half written has no CRC and is looked at again. Whoever is silent has let go: the sequence
stands still, so a writer says something several times a second even where nothing changes.
"""

from __future__ import annotations

import math
import mmap
import os
import stat
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

from rig.core.errors import ConfigError

MAGIC = b"RIGHAND1"
_VALUES = struct.Struct("<qdd")  # sequence, position, press
_CRC = struct.Struct("<I")
SIZE = len(MAGIC) + _VALUES.size + _CRC.size
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Wish:
    """Where a hand wants to be, and how hard it presses.

    Attributes
    ----------
    sequence
        Counts the writings; 0 as long as nobody has written.
    position
        At the link (rad or m).
    press
        At the handle, into the wall (N).
    """

    sequence: int
    position: float
    press: float


class SharedHand:
    """A hand in a file: `create` to move it, `open` to look at it. Close either."""

    def __init__(self, memory: mmap.mmap, path: Path) -> None:
        self.path = path
        self._memory = memory

    @classmethod
    def create(cls, path: str | Path) -> SharedHand:
        """Make the file, or go on with the one that is there, to move it.

        Whoever owns its directory removes it. Raises `ConfigError` when something else has that name, or it cannot be
        made.
        """
        path = Path(path)
        descriptor = -1
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            told = os.fstat(descriptor)
            if stat.S_ISREG(told.st_mode) and told.st_size == 0:
                os.pwrite(descriptor, MAGIC + _packed(Wish(0, 0.0, 0.0)), 0)
            return cls._mapped(descriptor, path, mmap.ACCESS_WRITE)
        except OSError as error:
            raise ConfigError(
                f"{path}: cannot be made: {error.strerror}", remedy="name a file in a directory of your own"
            ) from None
        finally:
            if descriptor >= 0:
                os.close(descriptor)

    @classmethod
    def open(cls, path: str | Path) -> SharedHand:
        """Open a file that somebody made, to look at it; raises `ConfigError` when there is none."""
        path = Path(path)
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError as error:
            raise ConfigError(
                f"{path}: no hand there: {error.strerror}", remedy="whoever moves it makes the file first"
            ) from None
        try:
            return cls._mapped(descriptor, path, mmap.ACCESS_READ)
        finally:
            os.close(descriptor)

    @classmethod
    def _mapped(cls, descriptor: int, path: Path, access: int) -> SharedHand:
        try:
            right = os.fstat(descriptor).st_size == SIZE and os.pread(descriptor, len(MAGIC), 0) == MAGIC
            if right:
                return cls(mmap.mmap(descriptor, SIZE, access=access), path)
        except (OSError, ValueError):  # a directory, a pipe
            pass
        raise ConfigError(
            f"{path} is not the file of a driven hand", remedy="give it a name that nothing else has"
        )

    def move(self, position: float, press: float) -> None:
        """Say where the hand wants to be (rad or m, at the link), and how hard it presses into the wall (N).

        Raises `ConfigError` for what is no number.
        """
        if not (math.isfinite(position) and math.isfinite(press)):
            raise ConfigError(f"a hand at {position} with {press} N", remedy="give finite numbers")
        last = self.read()
        sequence = (0 if last is None else last.sequence) + 1
        self._memory[len(MAGIC) : SIZE] = _packed(Wish(sequence, position, press))

    def read(self) -> Wish | None:
        """What was said last; None while it is being written."""
        for _ in range(_TRIES):
            data = self._memory[len(MAGIC) : SIZE]
            (crc,) = _CRC.unpack_from(data, _VALUES.size)
            if zlib.crc32(data[: _VALUES.size]) == crc:
                return Wish(*_VALUES.unpack_from(data))
        return None

    def close(self) -> None:
        """Let go of the file, which stays."""
        self._memory.close()

    def __enter__(self) -> SharedHand:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _packed(wish: Wish) -> bytes:
    values = _VALUES.pack(wish.sequence, wish.position, wish.press)
    return values + _CRC.pack(zlib.crc32(values))
