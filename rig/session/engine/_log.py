"""The log of a session: one line for each event, written to disk before the session continues.

The state of a session is computed from its log (`_state`). A line (`rig.recording.lines`) contains an event::

    {"n": number from 0, "after": CRC of the line before (0 for the first), "at": seconds since 1970, "kind": …, …}

The first line also has ``"log"``, the version of the format. Lines are never changed or removed: a correction is a new
event.
"""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count, takewhile
from pathlib import Path
from typing import Any

from rig.core.errors import RecordingError
from rig.core.present import plain
from rig.recording.files import plain_errors, whole_file
from rig.recording.lines import LineFile, check_line_end, line_of, object_of

# Version of the events and their content; raise it when the meaning of a key changes.
VERSION = 4
RESERVED = ("n", "after", "at", "kind", "log")


@dataclass(frozen=True, slots=True)
class Event:
    """Event of a session: number from 0, time at which it was written (s since 1970), kind, and content."""

    number: int
    at: float
    kind: str
    content: Mapping[str, Any] = field(default_factory=dict)


class DamagedLineError(RecordingError):
    """A line of a session's log is damaged.

    `events` are the events before the line, `place` is the line's offset in the file (bytes), and `last` is True if no
    line follows.
    """

    def __init__(self, path: Path, events: Sequence[Event], place: int, *, last: bool) -> None:
        where = f"{path}, line {len(events) + 1}"
        if last:
            super().__init__(
                f"{where}, the last one: damaged",
                remedy="rig session show prints the lines before it; resume without it with rig session resume "
                "--drop-damaged-line (it is moved to another file), or restore the file from a copy",
            )
        else:
            remedy = "restore the file from a copy; later lines depend on the damaged one"
            super().__init__(f"{where}: damaged", remedy=remedy)
        self.events, self.place, self.last = tuple(events), place, last


class SessionLog:
    """Open log of a session in the file `path`; only one process at a time can open it.

    `clock` gives the time of an event (s since 1970). Raise `RecordingError` if another process has the log open, a
    line is damaged or missing, or writing fails.

    Attributes
    ----------
    events
        Events so far, oldest first.
    torn
        Number of bytes of an incomplete last line that were removed: a process died while it wrote them.
    """

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.time) -> None:
        self.path = path
        self._clock = clock
        self._broken = False  # True while the file may end with an incomplete line: nothing may be appended
        self._file = LineFile(path, remedy="end the session that is running there, or wait for its end")
        try:
            self.events, self._last, self._end = _read(path, self._file.lines())
            # What a dying process left of its last line is cut off; nothing followed from it.
            self.torn = max(0, path.stat().st_size - self._end)
            self._file.truncate(self._end)
            if not self.events:
                self._file.sync_name()
        except BaseException:
            # The lock must go with the failure; nothing was written that could need a sync.
            self._file.close(sync=False)
            raise

    def append(self, kind: str, **content: Any) -> Event:
        """Append an event, write it to disk and return it; the caller may act on the event only after that.

        Raise `RecordingError` if writing failed now or left an incomplete line earlier: only the log, opened again,
        shows whether the event was stored. Raise `ValueError` for a reserved key in `content`.
        """
        taken = [name for name in RESERVED if name in content]
        if taken:
            raise ValueError(f"an event must not have the keys {', '.join(taken)}, which the log uses itself")
        # `plain` converts to JSON types, so that the event in memory equals the event that is read back.
        event = Event(len(self.events), self._clock(), kind, plain(content))
        line = self._line_of(event)
        if self._broken:
            raise RecordingError(
                f"cannot write {self.path}: an earlier write failed and may have left a partial line",
                remedy="check the disk, then continue with `rig session resume`",
            )
        # Reset only after the sync: an interruption in between may leave an incomplete line.
        self._broken = True
        try:
            self._file.append(line)
            self._file.sync(at_once=True)
        except BaseException:
            with suppress(RecordingError):
                # An incomplete line must not precede the next event.
                self._file.truncate(self._end)
                self._broken = False
            raise
        self._end += len(line)
        self.events.append(event)
        self._last = zlib.crc32(line)
        self._broken = False
        return event

    def _line_of(self, event: Event) -> bytes:
        envelope = {"n": event.number, "after": self._last, "at": event.at, "kind": event.kind}
        version = {"log": VERSION} if event.number == 0 else {}
        return line_of(json.dumps({**envelope, **version, **event.content}, allow_nan=False))

    def close(self) -> None:
        """Close the file and release its lock. All appended events are already on disk."""
        self._file.close(sync=not self._broken)

    def __enter__(self) -> SessionLog:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def read(path: Path) -> list[Event]:
    """Return the events of a session's log, also while it is written; raise `RecordingError` if it is damaged."""
    with plain_errors("read", path):
        if not path.is_file():
            raise RecordingError(f"session log {path} not found", remedy="check the path")

    def lines() -> Iterator[tuple[int, bytes]]:
        place = 0
        for line in path.read_bytes().splitlines(keepends=True):
            if line.endswith(b"\n"):
                yield place, line
            place += len(line)

    return _read(path, lines())[0]


def set_damaged_line_aside(path: Path) -> Path | None:
    """Move a damaged last line of a log to a new file next to the log; return its path, or None without damage.

    Raise `RecordingError` if another line is damaged, another process has the log open, or writing fails.
    """
    file = LineFile(path, remedy="end the session that is running there, or wait for its end")
    try:
        try:
            _read(path, file.lines())
        except DamagedLineError as error:
            if not error.last:
                raise
            beside = next(name for name in _beside(path) if not name.exists())
            with plain_errors("read", path):
                damaged = path.read_bytes()[error.place :]
            with whole_file(beside) as kept:
                kept.write(damaged)
            file.truncate(error.place)
            return beside
        return None
    finally:
        file.close()


def set_aside(path: Path) -> list[Path]:
    """Return the files with damaged lines that were moved out of the log at `path`, oldest first."""
    return list(takewhile(Path.exists, _beside(path)))


def log_losses(event: Event) -> list[str]:
    """Return sentences about lost lines of the log, from the event that was written when the session was resumed."""
    losses = []
    if torn := event.content.get("torn"):
        losses.append(f"the last line of the log was incomplete, as after a crash: {torn} bytes were dropped")
    damaged = [one["file"] for one in event.content.get("damaged", ())]
    if damaged:
        losses.append(f"a damaged line of the log was moved to another file: {', '.join(damaged)}")
    return losses


def _beside(path: Path) -> Iterator[Path]:
    return (path.with_name(f"{path.name}.damaged-{number}") for number in count(1))


def _read(path: Path, lines: Iterator[tuple[int, bytes]]) -> tuple[list[Event], int, int]:
    """Return the events of a log, the CRC of its last line, and the byte offset at which the valid part ends."""
    events: list[Event] = []
    last = end = 0
    for place, line in lines:
        found = object_of(line)
        if found is None:
            # A damaged line is refused, because what follows was decided on it. The last one may be set aside.
            check_line_end(path, line)
            raise DamagedLineError(path, events, place, last=next(lines, None) is None)
        # The chain of CRCs shows a line that was removed or replaced.
        if (found.get("n"), found.get("after")) != (len(events), last):
            raise RecordingError(
                f"{path}: a line before line {len(events) + 1} was removed or changed",
                remedy="restore the file from a copy; later lines depend on the changed one",
            )
        if not events and found.get("log") != VERSION:
            raise RecordingError(
                f"{path}, line 1: the log has format version {found.get('log')}; this version of haptic-rig "
                f"reads version {VERSION}",
                remedy="read it with the version of haptic-rig given in its first line under versions",
            )
        content = {name: value for name, value in found.items() if name not in RESERVED}
        events.append(Event(found["n"], found["at"], found["kind"], content))
        last, end = zlib.crc32(line), place + len(line)
    return events, last, end
