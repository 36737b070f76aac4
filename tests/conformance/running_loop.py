"""A process with a loop in shared memory that only counts; other processes can observe and stop it."""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.conformance.started import started

ROOT = Path(__file__).parents[2]

# Arguments: info (JSON), what it does: "obey", or "deaf" to ignore the stop word. It takes and commits parameters.
# It ends when standard input does.
PROGRAM = """
from rig.core import program; program.begin()
import json, sys, threading, time
import numpy as np
from rig.realtime import control_words
from rig.realtime.mailbox import SET_FLOATS, take
from rig.realtime.ring import Ring

info, kind = json.loads(sys.argv[1]), sys.argv[2]
ring = Ring.allocate(16, info=info, shared=True)
ended = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
ring.put(control_words.PHASE, 3)
print("ready", flush=True)
into = np.zeros(SET_FLOATS)
ticks = 0
while not ended.is_set() and (kind == "deaf" or ring.get(control_words.STOP) == 0):
    ticks += 1
    ring.put(control_words.TICKS, ticks)
    number = take(ring.mailbox, into.view(np.uint8))
    if number:
        print(json.dumps({"set": number, "values": into[:8].tolist()}), flush=True)
        ring.put(control_words.PARAMETER_SET, number)
    time.sleep(0.001)
if kind != "deaf":
    ring.put(control_words.LOOP_DONE, 1)
print("done", flush=True)
ended.wait()
"""


@contextmanager
def loop_process(info: dict[str, Any] | None = None, kind: str = "obey") -> Iterator[subprocess.Popen[str]]:
    """Start the process, yield it when its loop runs, and kill it at the end of the block."""
    command = [sys.executable, "-c", PROGRAM, json.dumps(info or {}), kind]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with started(*command, cwd=ROOT, text=True, bufsize=1, **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        yield process
