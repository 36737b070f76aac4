"""Run the tasks (function calls) of a sweep: interface of all executors, and an executor with daemon threads.

`rig.experiments.sweep.run` uses this module; `rig.extras.cluster` has an executor for Dask. Payloads and results are
passed as JSON text, errors as `Failure`, so that every executor gives the same values to the last bit. Only the
coordinator stores and counts results.
"""

import json
import platform
import queue
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol

from rig.core import extras
from rig.core.errors import ConfigError, RigError
from rig.core.this_system import processors
from rig.realtime.handlers import take_no_signals
from rig.realtime.source_files import code_version

Work = Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Done:
    """A result of a finished task: JSON text, and the number of units of work in the result."""

    text: str
    units: int


@dataclass(frozen=True, slots=True)
class Failure:
    """An exception as message, remedy and traceback (`details`); `of_task` is False if the worker runs no task."""

    message: str
    remedy: str = ""
    details: str = ""
    of_task: bool = True


class Executor(Protocol):
    """An interface of executors, which run tasks in threads or processes; one thread at a time may use an executor."""

    ahead: int  # number of submitted tasks per worker; 1: only the running task

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Schedule a call, like `concurrent.futures.Executor.submit`, and return the future of its result."""
        ...

    def workers(self) -> int:
        """Return the number of calls that can run at once; the number may change during a sweep."""
        ...

    def explain(self, error: BaseException) -> Failure:
        """Return an exception of a task's future as `Failure`; raise the exception if no task can run any more."""
        ...

    def close(self) -> None:
        """Abandon the running calls without waiting for them."""
        ...


def executor_for(scheduler: str | None, workers: int | None) -> Executor:
    """Return an executor with threads of this process, or with the workers of a Dask scheduler.

    Raise `ConfigError` if both `scheduler` and `workers` are given.
    """
    if scheduler is None:
        return Threads(workers)
    if workers is not None:
        raise ConfigError(
            "scheduler and workers are both given: a scheduler chooses its workers itself",
            remedy="give either a scheduler or a number of workers",
        )
    found: Executor = extras.load("executors", "dask")(scheduler)
    return found


def perform(work: Work, payload: str, unit: str | None, code: str) -> Done | Failure:
    """Run one task in the worker; return its result, or a `Failure` with the error.

    `payload` are the task's arguments as JSON text. `unit` names the number in the result that counts units of work
    (such as hits); `code` is the version of this package in the submitting process.
    """
    if code != code_version():
        return Failure(
            f"a worker on {platform.node()} runs haptic-rig {code_version()}, this is {code}",
            f"install the same version on {platform.node()}, and restart the worker",
            of_task=False,
        )
    try:
        result = work(json.loads(payload))
        return Done(as_json(result), 1 if unit is None else _units(result, unit))
    except BaseException as error:  # a task may raise any exception, also in a thread
        details = "".join(traceback.format_exception(error)).rstrip()
        if isinstance(error, RigError):
            return Failure(error.message, error.remedy, details)
        return Failure(": ".join(filter(None, (type(error).__name__, str(error)))), "", details)


def as_json(value: Any, *, sort_keys: bool = False) -> str:
    """Return JSON text in ASCII whose floats read back to the same bits; numpy values become Python values."""
    return json.dumps(value, separators=(",", ":"), sort_keys=sort_keys, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(
        f"a {type(value).__name__} cannot be written as JSON; use numbers, texts, booleans, None, lists and mappings"
    )


def _units(result: Any, name: str) -> int:
    rows = result if isinstance(result, list | tuple) else [result]
    return sum(int(row[name]) for row in rows)


class Threads:
    """An executor with threads of this process: compiled code runs in parallel, and the caller's own law can run."""

    # Not `concurrent.futures.ThreadPoolExecutor`: the interpreter joins its threads when it ends, so a second Ctrl-C
    # would still wait for every task that is running.

    ahead = 1

    def __init__(self, workers: int | None = None) -> None:
        """Start `workers` threads; None: one thread for each core that this process may use."""
        if workers is not None and workers < 1:
            raise ConfigError(f"workers = {workers} is out of range", remedy="give 1 or more")
        self._workers = workers or len(processors())
        self._waiting: queue.SimpleQueue[tuple[Future[Any], Callable[..., Any], Any] | None]
        self._waiting = queue.SimpleQueue()
        for number in range(self._workers):
            threading.Thread(target=self._body, name=f"rig-sweep-{number}", daemon=True).start()

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Queue a call for the next idle thread, and return the future of its result."""
        future: Future[Any] = Future()
        self._waiting.put((future, function, arguments))
        return future

    def workers(self) -> int:
        """Return the number of threads that run tasks."""
        return self._workers

    def explain(self, error: BaseException) -> Failure:
        """Raise `error`, the exception of a broken thread: exceptions of tasks are returned as results by `perform`."""
        raise error

    def close(self) -> None:
        """Let each thread end after its present call; do not wait for the threads."""
        for _ in range(self._workers):
            self._waiting.put(None)

    def _body(self) -> None:
        take_no_signals()
        while (given := self._waiting.get()) is not None:
            future, function, arguments = given
            try:
                future.set_result(function(*arguments))
            except BaseException as error:  # else the coordinator would wait for this call forever
                future.set_exception(error)
