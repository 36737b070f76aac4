"""The process that reads, draws and computes for a page (runs *errands*, see `rig.extras.console.errands`).

``python -P -m rig.extras.console errands``: each line of standard input is an errand. Its reply is one line, with the
result and the number of bytes that follow, or with the error; lines ``{"compiling": …}`` may come before. The process
ends when its input ends.
"""

import json
import os
import sys
from collections.abc import Callable
from typing import Any, BinaryIO

from rig.core.errors import RigError
from rig.core.present import plain
from rig.extras.console import hits, map_errands, recording_errands, regions, session_desk, session_lists
from rig.realtime import compiling

# Each takes its content by name and returns a result, or one and bytes.
ERRANDS: dict[str, Callable[..., Any]] = {
    "experiment": hits.describe_rig,
    "regions": regions.find_regions,
    "sessions": session_lists.list_sessions,
    "resumed": session_lists.describe_resumption,
    "session digest": session_desk.digest_of,
    "maps": map_errands.directories,
    "map": map_errands.describe_map,
    "map growth": map_errands.growth,
    "map theory": map_errands.theory,
    "map hit": map_errands.find_recording,
    "recordings": recording_errands.list_recordings,
    "recording": recording_errands.describe_recording,
    "cut": recording_errands.cut,
    "save cut": recording_errands.save_cut,
    "picture": recording_errands.picture,
    "export": recording_errands.export_recording,
}


def main() -> None:
    """Read, draw or compute for a page as each line of standard input requests, until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    # Libraries print on standard output, which must contain replies only: send their output to standard error.
    os.dup2(2, 1)
    compiling.listen(lambda busy: _write_message(answers, {"compiling": busy}))
    for line in sys.stdin.buffer:
        asked = json.loads(line)
        try:
            result = ERRANDS[asked["errand"]](**asked["content"])
        except RigError as error:
            _write_message(answers, error.as_mapping())
        except Exception as error:
            # A bug in an errand is reported to the page; the process continues with the next errand.
            _write_message(
                answers, {"error": f"{asked['errand']}: {error!r}", "remedy": "report this defect"}
            )
        else:
            found, data = result if isinstance(result, tuple) else (result, b"")
            _write_message(answers, {"result": plain(found), "bytes": len(data)}, data)


def _write_message(answers: BinaryIO, message: dict[str, Any], data: bytes = b"") -> None:
    answers.write(json.dumps(message).encode() + b"\n")
    answers.write(data)
    answers.flush()
