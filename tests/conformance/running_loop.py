"""A process with a loop in shared memory that only counts; other processes can observe and stop it."""

import multiprocessing
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from typing import Any

from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.conformance.started import die_with_parent


@contextmanager
def loop_process(info: dict[str, Any]) -> Iterator[ForkProcess]:
    """Fork the process, yield it when its loop runs, and kill it at the end of the block."""
    Ring.allocate(1).close()  # loads compiled code, which a new process would load again: 0.3 s
    fork = multiprocessing.get_context("fork")
    ready, child = fork.Pipe()
    process = fork.Process(target=_run_loop, args=(info, child))
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # of other threads at a fork
        process.start()
    try:
        assert ready.recv() == "ready"
        yield process
    finally:
        process.kill()
        process.join()


def _run_loop(info: dict[str, Any], ready: Connection) -> None:
    die_with_parent()
    ring = Ring.allocate(16, info=info, shared=True)
    ring.put(control_words.PHASE, 3)
    ready.send("ready")
    ticks = 0
    while ring.get(control_words.STOP) == 0:
        ticks += 1
        ring.put(control_words.TICKS, ticks)
        time.sleep(0.001)
    ring.put(control_words.LOOP_DONE, 1)
    threading.Event().wait()
