"""A process with a loop in shared memory that only counts; other processes can observe and stop it."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.conformance.started import forked


@contextmanager
def loop_process(info: dict[str, Any]) -> Iterator[BaseProcess]:
    Ring.allocate(1).close()  # loads compiled code, which each child would load again
    with forked(_run_loop, info) as (process, messages):
        assert messages.recv() == "ready"
        yield process


def _run_loop(parent: Connection, info: dict[str, Any]) -> None:
    ring = Ring.allocate(16, info=info, shared=True)
    ring.put(control_words.PHASE, 3)
    parent.send("ready")
    ticks = 0
    while ring.get(control_words.STOP) == 0:
        ticks += 1
        ring.put(control_words.TICKS, ticks)
        time.sleep(0.001)
    ring.put(control_words.LOOP_DONE, 1)
    threading.Event().wait()
