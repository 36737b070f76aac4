"""Store the result of each finished task of a sweep in a file, the journal, so that a stopped sweep can resume.

The file has lines (`rig.recording.lines`) that are appended and never changed::

    first   : {"sweep": 1, "work": …, "version": …, "tasks": …, "plan": SHA-256 of work, version and tasks, "first": …}
    others  : {"key": …, "result": …}, a line for each finished task, in the order in which they finished

A line with a wrong CRC is ignored, and its task is run again. If the process dies, no appended line is lost; after a
power cut at most the lines since the last sync are lost.
"""

import json
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError, RecordingError
from rig.core.regular_file import open_regular
from rig.recording.files import plain_errors
from rig.recording.lines import LineFile, check_line_end, line_of, object_of

VERSION = 1
NOT_DONE = -1
SHOWN_DIFFERENCES, SHOWN_LETTERS = 3, 60


class Memory:
    """A store of task results in memory, with the methods of `Journal`; the results are lost when the process ends."""

    def __init__(self, total: int) -> None:
        self._texts: list[str | None] = [None] * total
        self.damaged = 0

    def done(self) -> list[int]:
        """Return the indices of the finished tasks, ascending."""
        return [index for index, text in enumerate(self._texts) if text is not None]

    def append(self, index: int, key: str, text: str) -> None:
        """Store the result (JSON text) of the task with this index; the key, needed in a file only, is ignored."""
        self._texts[index] = text

    def results(self, indices: Iterable[int]) -> Iterator[Any]:
        """Yield the results (JSON values) of the finished tasks with these indices."""
        return (json.loads(self._texts[index] or "null") for index in indices)

    def sync(self) -> None:
        """Do nothing: results in memory need no disk."""

    def close(self) -> None:
        """Do nothing: there is no file to close."""


class Journal:
    """An open journal: the file with the results of a sweep's tasks, locked against other processes.

    Parameters
    ----------
    path
        Path of the file, created if it does not exist.
    header
        Content of the first line without its version: a description of all tasks. Two journals belong to the same sweep
        if the values of ``plan`` are equal.
    keys
        Keys of all tasks, in the order of the tasks.

    Raises
    ------
    ConfigError
        The journal belongs to another sweep.
    RecordingError
        The file is not a journal, is used by another process, or cannot be read or written.
    """

    def __init__(self, path: Path, header: Mapping[str, Any], keys: Sequence[str]) -> None:
        self.path = path
        self.damaged = 0  # number of ignored lines
        self._places = array("q", [NOT_DONE]) * len(keys)  # byte at which the line of each task begins
        self._file = LineFile(path, remedy="wait until that process has ended, or give another file")
        try:
            self._end = self._load({"sweep": VERSION, **header}, keys)
        except BaseException:
            self._file.close(sync=False)
            raise

    def done(self) -> list[int]:
        """Return the indices of the finished tasks, ascending."""
        return [index for index, place in enumerate(self._places) if place != NOT_DONE]

    def append(self, index: int, key: str, text: str) -> None:
        """Append the result (JSON text) of the task with this index and key to the file."""
        line = line_of(f'{{"key":{json.dumps(key)},"result":{text}}}')
        self._file.append(line)
        self._places[index] = self._end
        self._end += len(line)

    def results(self, indices: Iterable[int]) -> Iterator[Any]:
        """Yield the results (JSON values) of the finished tasks with these indices, reading one line at a time.

        The journal may be closed already. Raise `RecordingError` if the file has changed since it was opened.
        """
        with plain_errors("read", self.path), open_regular(self.path) as file:
            for index in indices:
                file.seek(self._places[index])
                found = object_of(file.readline())
                if found is None:
                    raise RecordingError(
                        f"{self.path} changed while it was read", remedy="run the same command again"
                    )
                yield found["result"]

    def sync(self) -> None:
        """Write the appended lines to disk, if some time has passed since the last write."""
        self._file.sync()

    def close(self) -> None:
        """Write all lines to disk and release the lock."""
        self._file.close()

    def _load(self, header: Mapping[str, Any], keys: Sequence[str]) -> int:
        """Read an existing file of results, or begin a new one; return the length of its valid part (bytes)."""
        wanted = line_of(json.dumps(header))
        with plain_errors("read", self.path), open_regular(self.path) as file:
            first = file.readline()
        # The file is new, or its first line is incomplete: in both cases it contains no result.
        if len(first) < len(wanted) and wanted.startswith(first):
            return self._begin(wanted)
        check_line_end(self.path, first)
        there = object_of(first)
        if there is None or "sweep" not in there:
            raise RecordingError(
                f"{self.path} is not a file of task results (journal), or its first line is damaged",
                remedy=f"give another file, or remove {self.path} to start again",
            )
        _refuse_other_sweep(self.path, there, json.loads(json.dumps(header)))
        end = self._read_results(len(first), {key: index for index, key in enumerate(keys)})
        self._file.truncate(end)
        return end

    def _begin(self, first: bytes) -> int:
        self._file.truncate(0)
        self._file.append(first)
        self._file.sync(at_once=True)
        self._file.sync_name()
        return len(first)

    def _read_results(self, end: int, index_of: Mapping[str, int]) -> int:
        for place, line in self._file.lines():
            if place == 0:
                continue
            found = object_of(line)
            index = None if found is None else index_of.get(found["key"])
            if index is None:
                self.damaged += 1
            elif self._places[index] == NOT_DONE:
                self._places[index] = place
            end = place + len(line)
        return end


def read_on(path: Path, place: int = 0) -> tuple[list[tuple[str, Any]], int]:
    """Return pairs (task key, result) from the journal's lines after byte `place`, and the byte of the next line.

    Another process may be writing this file of results: it is not locked, an incomplete last line is left for the next
    call, and a damaged line is skipped. Raise `RecordingError` if the file cannot be read.
    """
    found = []
    with plain_errors("read", path), open_regular(path) as file:
        file.seek(place)
        for line in file:
            if not line.endswith(b"\n"):
                break
            place += len(line)
            entry = object_of(line)
            if entry is not None and "key" in entry:
                found.append((entry["key"], entry["result"]))
    return found, place


def _refuse_other_sweep(path: Path, there: dict[str, Any], here: dict[str, Any]) -> None:
    """Raise `ConfigError` with the differences if the file's header `there` belongs to other tasks than `here`."""
    if (there["sweep"], there.get("plan")) == (here["sweep"], here["plan"]):
        return
    differences = [
        text for key in here if key != "plan" for text in _differences(there.get(key), here[key], key)
    ]
    differences = differences or ["a task after the first"]
    more = ["…"] if len(differences) > SHOWN_DIFFERENCES else []
    raise ConfigError(
        f"{path} belongs to another plan: {'; '.join(differences[:SHOWN_DIFFERENCES] + more)}",
        remedy=f"give the same options as before, or another journal; or remove {path} to start again",
    )


def _differences(there: Any, here: Any, where: str) -> Iterator[str]:
    """Yield a text for each value that differs, like ``first.payload.wall.stiffness: 40 in the file, 50 now``."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**there, **here}:
            yield from _differences(there.get(key), here.get(key), f"{where}.{key}")
    elif json.dumps(there) != json.dumps(here):
        yield f"{where}: {_shorten(there)} in the file, {_shorten(here)} now"


def _shorten(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= SHOWN_LETTERS else text[:SHOWN_LETTERS] + "…"
