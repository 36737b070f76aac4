"""A process that serves something to this one: it announces where, and ends with whoever started it.

It hears no Ctrl-C, which is for the host: a device that died of it could not be brought to rest. It settles that before
it loads what it serves.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.reduction import ForkingPickler
from types import ModuleType
from typing import Any

from rig.core import program
from rig.core.errors import DeviceNotFoundError, RigError

START_TIMEOUT_S = 60.0  # the first start compiles the plant
STOP_TIMEOUT_S = 5.0
SAFE_PATH = "PYTHONSAFEPATH"  # python -P, for the children of this process
PR_SET_PDEATHSIG = 1  # linux/prctl.h


class _Later:
    """Something that a child imports when it asks for it, and not before its first line."""

    def __init__(self, value: Any) -> None:
        self._value = value

    def __getstate__(self) -> bytes:
        return bytes(ForkingPickler.dumps(self._value))

    def __setstate__(self, pickled: bytes) -> None:
        self._pickled = pickled

    def loaded(self) -> Any:
        return pickle.loads(self._pickled)


@contextmanager
def announced(serve: Callable[..., None], *arguments: Any, name: str, by_hand: str) -> Iterator[Any]:
    """Start a process, yield what it announces, and end it with the context.

    Parameters
    ----------
    serve
        Of a module: called there with a function that announces, and with `arguments`, which are pickled.
    name
        Of the process.
    by_hand
        The command that starts it for a person, who wants to see why it did not come up.

    Raises
    ------
    DeviceNotFoundError
        It does not come up.
    RigError
        What `serve` raised before it announced anything.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(
        target=_child, args=(sender, _Later((serve, arguments))), name=name, daemon=True
    )
    with _no_modules_from_here():
        process.start()
    sender.close()
    try:
        yield _first(receiver, name, by_hand)
    finally:
        process.terminate()
        process.join(STOP_TIMEOUT_S)
        if process.is_alive():
            process.kill()
            process.join(STOP_TIMEOUT_S)


@contextmanager
def _no_modules_from_here() -> Iterator[None]:
    """Start a child by multiprocessing: ``python -c``, which else imports what lies here, a json.py for one.

    And the program itself: a script that hits a wall in real time would begin again in the child.
    """
    before, program = os.environ.get(SAFE_PATH), sys.modules["__main__"]
    os.environ[SAFE_PATH], sys.modules["__main__"] = "1", ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = program
        os.environ.pop(SAFE_PATH)
        if before is not None:
            os.environ[SAFE_PATH] = before


def _child(pipe: Any, served: _Later) -> None:
    if sys.platform == "linux":
        os.setsid()
        _die_with_parent()
    program.begin()
    serve, arguments = served.loaded()
    try:
        serve(pipe.send, *arguments)
    except RigError as error:
        pipe.send(error)


def _die_with_parent() -> None:
    """Ask Linux for SIGTERM when the parent dies, also of kill -9: no device process is left behind."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _first(receiver: Any, name: str, by_hand: str) -> Any:
    with suppress(EOFError):
        if receiver.poll(START_TIMEOUT_S):
            said = receiver.recv()
            if isinstance(said, RigError):
                raise said
            return said
    raise DeviceNotFoundError(
        f"the process {name} did not start", remedy=f"start it by hand to see why: {by_hand}"
    )
