"""Child process that serves something to this process: it announces its address, and ends with this process.

`rig.devices.local`, the bridge (firmware in front of a drive) and the simulation use it, whatever a process serves.
"""

import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

from rig.core import program
from rig.core.errors import DeviceNotFoundError, RigError

START_TIMEOUT_S = 60.0  # the first start compiles the plant
STOP_TIMEOUT_S = 5.0


@contextmanager
def start_announced(
    serve: Callable[..., None], *arguments: Any, name: str, by_hand: str, descriptors: Sequence[int] = ()
) -> Iterator[Any]:
    """Start a child process, yield the object that it announces (such as its address), and end it after the block.

    The child also ends when this process ends, even by kill -9, but not when the thread that started it ends.

    Parameters
    ----------
    serve
        Function of a module. The child calls it with a function to announce an object, and with `arguments`, which are
        pickled.
    name
        Name of the child process.
    by_hand
        Command with which a user can start the same process, to see why it did not start.
    descriptors
        File descriptors that the child inherits, under the same numbers.

    Raises
    ------
    DeviceNotFoundError
        The child does not start.
    RigError
        Error that `serve` raised before it announced anything.
    """
    if sys.platform == "win32":  # a child there gets no descriptors by number
        raise DeviceNotFoundError(
            f"the process {name} cannot be started on Windows",
            remedy="use Linux, or a real device on a serial (COM) port",
        )
    else:
        served = pickle.dumps((serve, arguments))
        ours, theirs = Pipe()
        with ours:
            with theirs:
                process = subprocess.Popen(
                    _command(theirs.fileno(), name),
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(), *descriptors),
                    # Ctrl-C is for the host: a simulated device that died of it could not be brought to rest.
                    start_new_session=True,
                )
            _lifelines.add(ours)
            try:
                yield _receive_first(ours, served, name, by_hand)
            finally:
                _lifelines.discard(ours)
                _end(process)


_lifelines: set[Connection] = set()


def _close_lifelines() -> None:
    # A forked copy of this process would keep the child processes alive by its copies of the connections.
    while _lifelines:
        _lifelines.pop().close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_lifelines)


def _command(descriptor: int, name: str) -> list[str]:
    """Return the child's command line: same interpreter and module path, but without the working directory."""
    root = str(Path(__file__).parents[2])
    path = [entry for entry in sys.path if entry]
    path += [] if root in path else [root]
    begin = f"import sys; sys.path[:] = {path!r}; from rig.core.process import serve_parent; "
    return [sys.executable, "-P", "-c", f"{begin}serve_parent({descriptor})", name]


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(STOP_TIMEOUT_S)


def _receive_first(ours: Connection, served: bytes, name: str, by_hand: str) -> Any:
    with suppress(EOFError, OSError):
        ours.send_bytes(served)
        if ours.poll(START_TIMEOUT_S):
            message = ours.recv()
            if isinstance(message, RigError):
                raise message
            return message
    raise DeviceNotFoundError(
        f"the process {name} did not start", remedy=f"start it by hand to see why: {by_hand}"
    )


def serve_parent(descriptor: int) -> None:
    """Call a function that the parent process sends, with its arguments: the main function of a child process."""
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the thread that started this may take no signals
    parent = Connection(descriptor)
    try:
        served = parent.recv_bytes()
    except EOFError:
        return
    threading.Thread(target=_end_with_parent, args=(descriptor,), name="rig-parent", daemon=True).start()
    program.begin()
    serve, arguments = pickle.loads(served)
    try:
        serve(parent.send, *arguments)
    except RigError as error:
        parent.send(error)


def _end_with_parent(descriptor: int) -> None:
    # Not PR_SET_PDEATHSIG: it acts when the thread ends that started this process.
    if sys.platform != "win32":  # where `start_announced` refuses
        ended = select.poll()
        ended.register(descriptor, 0)  # a hang-up is reported always
        ended.poll()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(STOP_TIMEOUT_S)
        os.kill(os.getpid(), signal.SIGKILL)
