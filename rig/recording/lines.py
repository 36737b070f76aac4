"""Append-only text file with a checksum in each line: appended lines survive a crash of the process.

    line = CRC-32 of the JSON (8 hex digits, as in zlib)  blank  JSON object in ASCII  newline

Logs of sessions and of maps of stable walls are such files. A written line must not be changed.
"""

import errno
import json
import os
import time
import zlib
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from shlex import quote
from typing import Any

from rig.core import locks
from rig.core.errors import RecordingError
from rig.core.regular_file import open_regular
from rig.recording.files import disk_error, plain_errors, sync_directory

SYNC_S = 0.5
_CRC_DIGITS = 8
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


class LineFile:
    """Append-only file of lines with checksums, open for writing; it is created if it does not exist.

    Raise `RecordingError` if another process is writing the file, with `remedy` as advice, or on a disk error.
    """

    def __init__(self, path: Path, *, remedy: str) -> None:
        self.path = path
        self._dirty = False
        self._synced_s = time.monotonic()
        with plain_errors("open", path):
            # Not buffered: a line that was written survives the death of this process.
            self._file = FileIO(path, "a+")
        # Only one process may write at a time: lines of two writers would be mixed.
        try:
            self._lock(remedy)
        except BaseException:
            self._file.close()
            raise

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield the byte offset and the bytes of every line that ends with a newline, also of damaged lines."""
        with plain_errors("read", self.path), open_regular(self.path) as file:
            place = 0
            for line in file:
                # The process died while it wrote a line without a newline at its end.
                if not line.endswith(b"\n"):
                    return
                yield place, line
                place += len(line)

    def truncate(self, end: int) -> None:
        """Shorten the file to `end` bytes, to remove an incomplete last line."""
        with plain_errors("write", self.path):
            self._file.truncate(end)

    def append(self, line: bytes) -> None:
        """Append the bytes of a line, which then survive a crash of the process, and after `sync` a power failure."""
        self._dirty = True
        data = line
        with plain_errors("write", self.path):
            while data:
                data = data[self._file.write(data) :]

    def sync(self, *, at_once: bool = False) -> None:
        """Flush appended lines to the disk (fsync), at most once per `SYNC_S` (s) unless `at_once` is True."""
        if self._dirty and (at_once or time.monotonic() - self._synced_s >= SYNC_S):
            with plain_errors("write", self.path):
                os.fsync(self._file.fileno())
            self._dirty, self._synced_s = False, time.monotonic()

    def sync_name(self) -> None:
        """Flush the directory entry of the file to the disk, so that a new file survives a power failure."""
        sync_directory(self.path.parent)

    def close(self, *, sync: bool = True) -> None:
        """Close the file and release its lock; before, flush all lines to the disk unless `sync` is False."""
        try:
            if sync:
                self.sync(at_once=True)
        finally:
            self._file.close()

    def _lock(self, remedy: str) -> None:
        try:
            ours = locks.lock(self._file.fileno())
        except OSError as error:
            # Some network file systems have no locks: without one two writers are not detected, but logs still work.
            if error.errno not in _NO_LOCKS:
                raise disk_error("lock", self.path, error.errno or errno.EIO) from error
            return
        if not ours:
            raise RecordingError(f"another process is writing {self.path}", remedy=remedy)


def line_of(text: str) -> bytes:
    """Return the bytes of a line (checksum, blank, text, newline) for the JSON text of an object, in ASCII."""
    body = text.encode("ascii")
    return b"%08x %s\n" % (zlib.crc32(body), body)


def check_line_end(path: Path, line: bytes) -> None:
    """Raise `RecordingError` if the checksum of a line fails only because the line ends with CR LF instead of LF."""
    if line.endswith(b"\r\n") and object_of(line[:-2] + b"\n") is not None:
        raise RecordingError(
            f"the lines of {path} end with CR LF instead of LF, so their checksums do not match; an editor, "
            "git or a file transfer has changed the line ends",
            remedy=f"restore the line ends with: sed -i 's/\\r$//' {quote(str(path))} ; transfer the file as binary "
            "(in git: attribute -text)",
        )


def object_of(line: bytes) -> dict[str, Any] | None:
    """Return the JSON object in a line of the file; None if the line is incomplete or its checksum is wrong."""
    crc, blank, body = line[:_CRC_DIGITS], line[_CRC_DIGITS : _CRC_DIGITS + 1], line[_CRC_DIGITS + 1 : -1]
    if (crc, blank, line[-1:]) != (b"%08x" % zlib.crc32(body), b" ", b"\n"):
        return None
    value: dict[str, Any] = json.loads(body)
    return value
