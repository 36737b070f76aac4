"""The log of a session: one line for each decision, on disk before anything follows from it; the state is its replay.

A line (`rig.recording.lines`) holds an event::

    {"n": number from 0, "after": CRC of the line before (0 for the first), "at": seconds since 1970, "kind": …, …}

Nothing is ever changed or taken out: a correction is an event of its own. The chain of CRCs shows a line that somebody
removed or replaced. What a dying process left of its last line is cut off; a damaged line before that is refused,
because what follows was decided on it.
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.errors import RecordingError
from rig.recording.lines import LineFile, line_of, object_of

RESERVED = ("n", "after", "at", "kind")


@dataclass(frozen=True, slots=True)
class Event:
    """One decision: its number from 0, when it was written (s since 1970), what kind it is, and what belongs to it."""

    number: int
    at: float
    kind: str
    content: Mapping[str, Any] = field(default_factory=dict)


class SessionLog:
    """An open log; one process at a time.

    Parameters
    ----------
    path
        Of the file, made when it is not there.
    clock
        Time of day (s since 1970), for `Event.at`. Nothing is decided by it.

    Attributes
    ----------
    events
        All so far, oldest first.

    Raises
    ------
    RecordingError
        Another process has it open, a line is damaged or missing, or the disk refuses.
    """

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.time) -> None:
        self.path = path
        self._clock = clock
        self._file = LineFile(path, remedy="end the session that runs there, or wait for it")
        try:
            self.events, self._last, self._end = _read(path, self._file.lines())
            self._file.truncate(self._end)
            if not self.events:
                self._file.sync_name()
        except BaseException:
            self._file.close(sync=False)
            raise

    def append(self, kind: str, **content: Any) -> Event:
        """Write an event and bring it to disk; only then may anything follow from it.

        Raises `RecordingError` when the disk refuses: then it did not happen.
        """
        taken = [name for name in RESERVED if name in content]
        if taken:
            raise ValueError(f"{', '.join(taken)} of an event is the log's own")
        event = Event(len(self.events), self._clock(), kind, content)
        line = line_of(
            json.dumps({"n": event.number, "after": self._last, "at": event.at, "kind": kind, **content})
        )
        try:
            self._file.append(line)
            self._file.sync(at_once=True)
        except BaseException:
            self._file.truncate(self._end)  # what part of it was written must not stand before the next one
            raise
        self._end += len(line)
        self.events.append(event)
        self._last = zlib.crc32(line)
        return event

    def close(self) -> None:
        """Let others have it. What was appended is on disk already."""
        self._file.close()

    def __enter__(self) -> SessionLog:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def read(path: Path) -> list[Event]:
    """The events of a log, also of one that is being written; raises as `SessionLog`."""
    if not path.is_file():
        raise RecordingError(f"there is no session log {path}", remedy="check the path")

    def lines() -> Iterator[tuple[int, bytes]]:
        place = 0
        for line in path.read_bytes().splitlines(keepends=True):
            if line.endswith(b"\n"):
                yield place, line
            place += len(line)

    return _read(path, lines())[0]


def _read(path: Path, lines: Iterator[tuple[int, bytes]]) -> tuple[list[Event], int, int]:
    """Events, CRC of the last line, and where the good part ends."""
    events: list[Event] = []
    last = end = 0
    for place, line in lines:
        found = object_of(line)
        if found is None or (found.get("n"), found.get("after")) != (len(events), last):
            raise RecordingError(
                f"{path}, line {len(events) + 1}: "
                + ("damaged" if found is None else "a line before it was removed or changed"),
                remedy="restore the file from a copy; what follows was decided on that line",
            )
        content = {name: value for name, value in found.items() if name not in RESERVED}
        events.append(Event(found["n"], found["at"], found["kind"], content))
        last, end = zlib.crc32(line), place + len(line)
    return events, last, end
