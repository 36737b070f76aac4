"""Messages between the session's process and its console: one JSON object per line, with the message's kind.

==========  =========  ============================================================================================
from        kind       content
==========  =========  ============================================================================================
session     setup      pid of the session's process, keys, settings of the terminal, simulated hand (or null)
session     view       `rig.session.engine._desk.DeskView`
session     ask        number of the question (counts up), `rig.session.engine._desk.Question`
session     end        restore the terminal and exit
console     alive      sent a few times a second while the console runs
console     reply      number of the question, action, value
console     stop       the operator requests zero effort; the stop word of a running loop is set already
console     gone       no reply is possible any more: reason
==========  =========  ============================================================================================

Both processes (`_child` and `_program`) use it.
"""

import json
from collections.abc import Iterator
from typing import Any

# Longest unfinished line (bytes); a longer one does not come from this protocol.
MOST_BYTES = 1 << 20


def line_of(kind: str, **content: Any) -> bytes:
    """Return a message as bytes: a JSON object with ``kind`` and the content, and a newline."""
    return json.dumps({"kind": kind, **content}).encode() + b"\n"


class MessageReader:
    """Parser of a byte stream into messages; it ignores lines that are not messages."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[dict[str, Any]]:
        """Accept bytes and yield the messages that are complete, as dictionaries with ``kind``."""
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
