"""Stop all runs of this process on request: by a signal, by `rig.stop`, or at the end of the program.

One word counts the requests. In every tick a loop compares the word with its value when the run began, so a request
needs no GIL and reaches any number of loops in any threads.

Trials, the loop, sweeps, hits and motions use it. This file must not end a loop: each loop compares the word and ends
by its own rules.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from numba import types

from rig.core.errors import StoppedError
from rig.realtime.atomics import add_word, load_word, read_word, static_words, store_word, write_word
from rig.realtime.kernel import kernel, prepare
from rig.realtime.native import address_of, native_call

if sys.platform == "win32":
    STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGBREAK)
else:
    STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

# Words of the table: number of requests, last signal, runs in progress, signal whose default action waits for these
# runs, process number (a forked child has a copy); then, by signal number, the handler that was installed before.
_REQUESTS, _LAST, _RUNS, _DEFERRED, _PROCESS, _DISPLACED = 0, 1, 2, 3, 4, 8
_TABLE_WORDS = 64
_SIG_DFL, _SIG_IGN = 0, 1
_SA_SIGINFO, _SA_ONSTACK, _SA_RESTART = 0x4, 0x08000000, 0x10000000
LEAVE_S = 20.0  # longest wait of an ending program for its runs and their recordings
_POLL_S = 0.01

_i64, _ptr = types.int64, types.uintp
_HANDLER_SIGNATURE = _i64(types.int32, _ptr, _ptr)
_static_table = static_words("rig_stop_requests", _TABLE_WORDS)
_call_handler = native_call(3)
_set_handler = types.ExternalFunction("signal", _ptr(types.int32, _ptr))
_raise = types.ExternalFunction("raise", types.int32(types.int32))
_getpid = types.ExternalFunction("getpid", types.int32())


@kernel(_i64(_ptr, _i64))
def _add_request(table: int, number: int) -> int:
    """Count a stop request by signal `number`, 0 for this program itself; return the number of runs in progress."""
    store_word(table + 8 * _LAST, number)
    add_word(table + 8 * _REQUESTS, 1)
    return int(load_word(table + 8 * _RUNS))


@kernel(_HANDLER_SIGNATURE)
def _on_signal(number: int, info: int, context: int) -> int:
    """Count a signal as a stop request and call the handler that was installed before; return 0.

    The default action (to end the process) waits until the last recording is complete. Called with `number` 0, the
    function only returns the address of the table of requests.
    """
    table = _static_table()
    if number == 0:
        return int(table)
    store_word(table + 8 * _LAST, number)
    add_word(table + 8 * _REQUESTS, 1)
    displaced = load_word(table + 8 * (_DISPLACED + number))
    if displaced == _SIG_DFL:
        # Stored before the runs are read: of a request and a new run, one then sees the other.
        store_word(table + 8 * _DEFERRED, number)
        if load_word(table + 8 * _RUNS) == 0 or load_word(table + 8 * _PROCESS) != _getpid():
            _set_handler(number, _SIG_DFL)
            _raise(number)  # delivered when this returns
    elif displaced != _SIG_IGN:
        _call_handler(displaced, number, info, context)
    return 0


class _Action(ctypes.Structure):
    _fields_ = [
        ("handler", ctypes.c_size_t),
        ("mask", ctypes.c_ubyte * 128),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    ]


class _Hook:
    """Compiled handler of stop signals (Ctrl-C, SIGTERM, …): it counts a signal, then calls the previous handler."""

    def __init__(self) -> None:
        self._handler = address_of(_on_signal, _HANDLER_SIGNATURE)
        self.table = int(_on_signal(0, 0, 0))
        self._displaced: dict[int, _Action] = {}
        # Handlers that were installed before this one: they do not call it, so it must be placed before them again.
        self._known_handlers = {_SIG_DFL}
        self._libc = ctypes.CDLL(None)

    def place(self) -> None:
        """Install this handler in front of the present signal handlers, again if another handler has replaced it."""
        # Python runs its handlers in the main thread alone, and late where that thread waits in C. So this one stands
        # before them, counts, and calls the earlier one: Python's table and the wake-up descriptor of asyncio are
        # unchanged.
        for number in STOPPING:
            present = self._action(number)
            # `signal.signal` replaces this handler by the interpreter's, which calls no other.
            placed_before = number in self._displaced
            if present.handler in (self._handler, _SIG_IGN) or (
                placed_before and present.handler not in self._known_handlers
            ):
                continue
            write_word(self.table + 8 * (_DISPLACED + number), present.handler)
            flags = present.flags & (_SA_ONSTACK | _SA_RESTART) if present.handler else _SA_RESTART
            own_action = _Action(self._handler, present.mask, flags | _SA_SIGINFO, None)
            self._libc.sigaction(int(number), ctypes.byref(own_action), None)
            self._displaced[number] = present
            self._known_handlers.add(present.handler)

    def remove(self) -> None:
        """Restore the signal handlers that were installed before this one, unless another handler has replaced it."""
        for number, before in self._displaced.items():
            if self._action(number).handler == self._handler:
                self._libc.sigaction(int(number), ctypes.byref(before), None)
        self._displaced.clear()

    def _action(self, number: int) -> _Action:
        found = _Action()
        self._libc.sigaction(int(number), None, ctypes.byref(found))
        return found


class _Process:
    """Stop requests of this process: shared words, number of listening contexts, and whether the program is ending."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.hook = _Hook() if sys.platform == "linux" else None
        self._memory = np.zeros(_TABLE_WORDS if self.hook is None else 0, np.int64)
        self.table = int(self._memory.ctypes.data) if self.hook is None else self.hook.table
        self.listeners = 0
        self.leaving = False
        write_word(self.table + 8 * _PROCESS, os.getpid())
        prepare(_add_request)  # else a handler compiles it, and a second signal waits for that compilation

    def forget(self) -> None:
        """Reset the stop requests in a forked child process, which runs none of its parent's threads."""
        self.lock = threading.RLock()
        self.listeners = 0
        for word, value in ((_RUNS, 0), (_DEFERRED, 0), (_PROCESS, os.getpid())):
            write_word(self.table + 8 * word, value)
        if self.hook is not None:
            self.hook.remove()


_processes: list[_Process] = []
_creation_lock = threading.RLock()
_of_thread = threading.local()


def _process() -> _Process:
    if not _processes:  # without the lock, which a thread of the parent may hold at a fork
        with _creation_lock:
            if not _processes:
                process = _Process()
                if hasattr(os, "register_at_fork"):
                    os.register_at_fork(after_in_child=process.forget)
                _processes.append(process)
    return _processes[0]


def _word(index: int) -> int:
    return _process().table + 8 * index


def address() -> int:
    """Return the address of the int64 that counts the stop requests of this process; the address never changes."""
    return _word(_REQUESTS)


def count() -> int:
    """Return the number of stop requests since the start of this process."""
    return int(read_word(_word(_REQUESTS)))


def running() -> int:
    """Return the number of runs of this process that are in progress."""
    return int(read_word(_word(_RUNS)))


def last_signal() -> int | None:
    """Return the signal that caused the newest stop request; None without one, or if this program requested it."""
    return int(read_word(_word(_LAST))) or None


def requester() -> str:
    """Return, for a message, what caused the newest stop request: a signal's name ("SIGINT") or "this program"."""
    number = last_signal()
    return "this program" if number is None else signal.Signals(number).name


def request(number: int = 0) -> int:
    """Request all runs of this process to stop, for signal `number` or 0; return the number of runs in progress."""
    return int(_add_request(_process().table, number))


class RunSeries:
    """A series of runs, all of which a single stop request ends, also if the request comes between two runs.

    As a context manager it includes the runs that this thread starts within the context. Of nested series, the
    outermost counts.

    Attributes
    ----------
    since
        Number of stop requests of this process (`count`) when the series began.
    """

    def __init__(self) -> None:
        outer: RunSeries | None = getattr(_of_thread, "series", None)
        self.since: int = count() if outer is None else outer.since
        self._before = outer

    def __enter__(self) -> RunSeries:
        self._before = getattr(_of_thread, "series", None)
        _of_thread.series = self._before or self
        return self

    def __exit__(self, *error: object) -> None:
        _of_thread.series = self._before

    @property
    def is_stopped(self) -> bool:
        """Return True if a stop was requested since this series of runs began, or the program is ending."""
        return _process().leaving or count() != self.since

    def check(self) -> None:
        """Raise `StoppedError` if a stop was requested since this series began; call it before each run."""
        if self.is_stopped:
            raise StoppedError(f"stopped by {requester()} before the next run began; the effort is zero")


@contextmanager
def listening() -> Iterator[RunSeries]:
    """Count stop signals within this context; yield an object whose `is_stopped` is True after a stop request."""
    if threading.current_thread() is threading.main_thread():
        yield RunSeries()
    else:
        with _install_hook(_process()):
            yield RunSeries()


@contextmanager
def together() -> Iterator[None]:
    """Let one stop request end all runs of this thread within this context; do not `yield` to a caller inside it."""
    with listening() as series, series:
        yield


@contextmanager
def _install_hook(process: _Process) -> Iterator[None]:
    with process.lock:
        process.listeners += 1
        if process.hook is not None:
            process.hook.place()
    try:
        yield
    finally:
        with process.lock:
            process.listeners -= 1
            if process.hook is not None and process.listeners == 0:
                process.hook.remove()


def renew() -> None:
    """Reinstall the stop-signal handlers if a run needs them and a library has replaced them; call it repeatedly."""
    process = _process()
    if process.hook is not None:
        with process.lock:
            if process.listeners:
                process.hook.place()


@contextmanager
def run() -> Iterator[RunSeries]:
    """Count stop signals during one run; yield an object whose `is_stopped` is True after a stop request.

    Enter the context before the run arms a device, and leave it after the recording is complete. The end of the
    program, and a signal whose default action would end the process, wait for the end of the context.
    """
    process = _process()
    with _install_hook(process):
        series = RunSeries()
        with process.lock:
            _count_runs(process, +1)
        try:
            yield series
        finally:
            with process.lock:
                _count_runs(process, -1)


def _count_runs(process: _Process, change: int) -> None:
    """Add `change` (±1) to the number of runs in progress; after the last run, raise a deferred signal."""
    runs = running() + change
    write_word(_word(_RUNS), runs)
    atexit.unregister(_leave)
    if runs:
        atexit.register(_leave)
    elif number := int(read_word(_word(_DEFERRED))):
        _raise_deferred(process, number)


def _raise_deferred(process: _Process, number: int) -> None:
    """Send the deferred signal `number` to this process again, now with its default action, which ends the process."""
    write_word(_word(_DEFERRED), 0)
    if process.hook is not None:
        process.hook.remove()
    os.kill(os.getpid(), number)


def _leave() -> None:
    """Request the runs of all threads to stop at the end of the program; wait for them, at most `LEAVE_S` (20 s)."""
    # The interpreter does not wait for daemon threads; 3.11 and 3.12 also forget a thread whose `join` got a Ctrl-C.
    _process().leaving = True
    request()
    until = time.monotonic() + LEAVE_S
    while running() and time.monotonic() < until:
        with suppress(KeyboardInterrupt):
            time.sleep(_POLL_S)
