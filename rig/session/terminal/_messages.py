"""Messages between the session's program and its console: one JSON object in each line, with its kind.

==========  =========  ============================================================================================
from        kind       content
==========  =========  ============================================================================================
session     setup      pid of the program, keys, how the terminal was set, hand (null, or where it is moved)
session     view       `rig.session.engine._desk.DeskView`
session     ask        number (counts up), `rig.session.engine._desk.Question`
session     end        give the terminal back and go
console     alive      a few times a second, as long as it is
console     reply      number of the question, action, value
console     stop       the operator requests zero effort; the loop's stop word is set already, where there is one
console     gone       no answer can come any more: why
==========  =========  ============================================================================================
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

MOST_BYTES = 1 << 20  # of an unfinished line: more is not ours


def line_of(kind: str, **content: Any) -> bytes:
    """Return the line of a message."""
    return json.dumps({"kind": kind, **content}).encode() + b"\n"


class MessageReader:
    """Parser of a byte stream into messages; it ignores lines that are not messages."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[dict[str, Any]]:
        """Accept bytes and yield the messages that they complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > MOST_BYTES:
            self._rest = b""
        for line in lines:
            try:
                value = json.loads(line)
            except ValueError:  # also of bytes that are not UTF-8
                continue
            # Lists within lists, a few kilobytes of brackets, exhaust the parser's recursion.
            except RecursionError:
                continue
            if isinstance(value, dict) and isinstance(value.get("kind"), str):
                yield value
