"""Read files that a user or a page names: only regular files, without waiting, and up to a largest size.

Experiment files, maps, journals, recordings, studies and images of firmware are read through it. It must not write.
"""

import errno
import io
import os
import stat
from pathlib import Path

# Of a text that a person writes: the largest here has 27 kB, and more takes seconds to parse.
TEXT_BYTES = 1 << 20
TABLE_BYTES = 1 << 26  # of a file that a program writes: a plan, a table of endpoints, an image of a firmware
ROWS_BYTES = 1 << 31  # of a table that is held in memory as a whole, with several copies
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def open_regular(path: str | Path, most: int | None = None) -> io.BufferedReader:
    """Open a regular file to read; raise `OSError` for a file of another type or of more than `most` bytes."""
    _check(os.stat(path), path, most)
    # The file owns its descriptor from the start: whatever interrupts, it is closed once.
    file = open(  # noqa: SIM115  (the caller closes it)
        path, "rb", opener=lambda place, _: os.open(place, _FLAGS)
    )
    try:
        _check(os.fstat(file.fileno()), path, most)  # another file may have taken its name
    except BaseException:
        file.close()
        raise
    return file


def read_regular(path: str | Path, most: int = TEXT_BYTES) -> bytes:
    """Return the content of a regular file; raise `OSError` for another type or for more than `most` bytes."""
    with open_regular(path, most) as file:
        data = file.read(most + 1)
    if len(data) > most:  # it grew, or lies in /proc, where sizes are 0
        raise _too_large(path, most)
    return data


def _check(facts: os.stat_result, path: str | Path, most: int | None) -> None:
    if stat.S_ISDIR(facts.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    # A FIFO would wait for its writer, a device would never end, and opening a serial port can reset its board.
    if not stat.S_ISREG(facts.st_mode):
        raise OSError(errno.ENXIO, "not a regular file", str(path))
    if most is not None and facts.st_size > most:
        raise _too_large(path, most)


def _too_large(path: str | Path, most: int) -> OSError:
    return OSError(errno.EOVERFLOW, f"larger than {most >> 20} MiB", str(path))
