"""Find the shared memory (`rig.realtime.ring`) of each loop that runs on this computer, and request loops to stop.

`rig.__main__`, `rig stop`, the console and the ring use it. Stopping a rig must not wait for imports: `rig.__main__`
writes the stop word before it parses the rest of its command line, and this file imports only a few constants and
modules that Python loads at its start. It must not import numba or numpy.
"""

from __future__ import annotations

import mmap
import os
import sys
from collections.abc import Iterator
from io import FileIO

from rig.realtime.control_words import CONTROL_BYTES, CREATOR, LAYOUT_VERSION, LOOP_DONE, STOP, VERSION

if sys.platform == "linux":
    from rig.realtime import _anonymous_memory as anonymous_memory

    place = anonymous_memory
else:
    from rig.realtime import _named_memory as named_memory

    place = named_memory


class LoopMemory:
    """The control words (64-bit words in shared memory) of a running loop; a context manager that closes them.

    Raise `OSError` if the process has ended or belongs to another user, or the file is not the memory of a loop.

    Attributes
    ----------
    pid
        Number of the process that created the memory.
    path
        Path of the memory among that process's open files, for example ``/proc/PID/fd/N``.
    held
        Path by which this process can open the memory again, also after the other process has ended.
    ran
        True if the loop was still running when `ask_to_stop` was called.
    """

    def __init__(self, pid: int, path: str) -> None:
        self.pid, self.path = pid, path
        self.ran = False
        self._file = FileIO(path, "r+")
        self.held = place.held(path, self._file.fileno())
        try:
            if not place.is_sound(self._file.fileno()):
                raise OSError(f"the file {path} is not sealed: it could become shorter while it is read")
            self.words = memoryview(mmap.mmap(self._file.fileno(), CONTROL_BYTES)).cast("q")
        except (OSError, ValueError) as error:
            self._file.close()
            raise OSError(f"{path} is not the memory of a running loop") from error

    def ask_to_stop(self) -> None:
        """Request this loop to stop: set its stop word to minus this process's number, unless it is set already."""
        # 0: the memory is still being created, and no loop runs in it yet.
        if self.words[VERSION] != 0:
            self.ran = self.words[LOOP_DONE] == 0
            if self.words[STOP] == 0:
                self.words[STOP] = -os.getpid()

    def made_by(self, pid: int) -> bool:
        """Return True if process `pid` created this memory, or its creator is unknown (memory of another version)."""
        # In another layout the word CREATOR may be elsewhere.
        if self.words[VERSION] != LAYOUT_VERSION:
            return self.words[VERSION] != 0
        return place.is_process(pid, self.words[CREATOR])

    def close(self) -> None:
        """Close this access to the loop's memory; a second call does nothing."""
        if not self._file.closed:
            self.words.release()
            self._file.close()

    def __enter__(self) -> LoopMemory:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def memories(pid: int | None = None) -> Iterator[LoopMemory]:
    """Yield the memory of each running loop (of process `pid`, if given) once; the caller must close each memory."""
    known: set[tuple[int, int]] = set()
    for process, path in place.paths(pid):
        try:
            there = os.stat(path)
            memory = LoopMemory(process, path)
        # The loop has ended during the search.
        except OSError:
            continue
        if (there.st_dev, there.st_ino) not in known and _made_by(memory):
            known.add((there.st_dev, there.st_ino))
            yield memory
        else:
            memory.close()


def _made_by(memory: LoopMemory) -> bool:
    try:
        return memory.made_by(memory.pid)
    except OSError:
        return False


def ask_to_stop(pid: int | None = None) -> list[LoopMemory]:
    """Set the stop words of the loops of a process (None: of all) without waiting; the caller closes the memories."""
    asked = []
    for memory in memories(pid):
        memory.ask_to_stop()
        asked.append(memory)
    return asked
