"""A simulated rig behind a port, served by a thread of this process."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Queue
from typing import Any

from rig.core.model import RigModel
from sim_backend.ends import pty
from tests.conformance.rigs import rotary_rig
from tests.conformance.started import WAIT_S


@contextmanager
def served_rig(model: RigModel | None = None, **options: Any) -> Iterator[str]:
    """Serve a rig with `sim_backend.ends.pty.serve`; yield the path of its port; raise the server's error."""
    announced: Queue[str] = Queue()
    stop, errors = threading.Event(), []

    def body() -> None:
        try:
            pty.serve(model or rotary_rig(), announce=announced.put, stop_event=stop, **options)
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=body, daemon=True)
    thread.start()
    try:
        yield announced.get(timeout=WAIT_S)
    finally:
        stop.set()
        thread.join(WAIT_S)
    assert not thread.is_alive()
    if errors:
        raise errors[0]
