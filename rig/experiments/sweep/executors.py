"""Where the tasks of a sweep are worked off: what all such places have in common, and threads of this process.

A *batch* of jobs goes out, a `Report` comes back. Work is named by a string and imported where it runs; payloads and
results travel as JSON text, errors as `Failure`, so that all places give the same values to the last bit and nothing of
a task but plain data ever crosses a process. The coordinator (`rig.experiments.sweep.run`) alone keeps and counts.
"""

from __future__ import annotations

import json
import platform
import queue
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pkgutil import resolve_name
from typing import Any, Protocol

from rig.core.errors import ConfigError, RigError
from rig.core.this_system import processors
from rig.realtime.handlers import take_no_signals
from rig.realtime.source_files import code_version

LONGEST_S = 1.0  # a batch gives back what it has not begun by then


@dataclass(frozen=True, slots=True)
class Job:
    """One task on its way: its number in the plan, and its payload in JSON."""

    index: int
    payload: str


@dataclass(frozen=True, slots=True)
class Completed:
    """A job that was run: its result in JSON, for how many units it stands, how long it took (s)."""

    index: int
    text: str
    units: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Failure:
    """What went wrong; `index` is that of the job that raised, None when nothing could be run at all."""

    index: int | None
    message: str
    remedy: str = ""
    details: str = ""  # the traceback, where it happened


@dataclass(frozen=True, slots=True)
class Report:
    """The result of a batch, in its order: jobs completed up to the first failure, or until its time was over."""

    completed: tuple[Completed, ...] = ()
    failure: Failure | None = None


@dataclass(frozen=True, slots=True)
class Order:
    """What every batch of a sweep has in common.

    Attributes
    ----------
    work
        ``module:function``.
    unit
        Name of the number in each row of a result that says for how many units it stands; None: one a task.
    code
        `code_version` of the process that asks: another code would give other results.
    """

    work: str
    unit: str | None
    code: str


class Executor(Protocol):
    """Somewhere to run batches. Used by one thread at a time."""

    batch_s: float  # how long a batch had better take (s); 0: one job each

    def capacity(self) -> int:
        """Return how many batches can be worked on at once, now; it may change."""
        ...

    def submit(self, batch: Sequence[Job]) -> int:
        """Send a batch off and return its ticket."""
        ...

    def finished(self, timeout_s: float) -> list[tuple[int, Report]]:
        """Return the tickets that have come back, each once; wait for one at most this long."""
        ...

    def close(self) -> None:
        """Forget what is still out."""
        ...


# What runs where the work is done --------------------------------------------------------------------


def run_batch(order: Order, batch: Sequence[Job]) -> Report:
    """Run jobs one after another, at least one, up to the first that raises or until `LONGEST_S` have passed."""
    if order.code != code_version():
        return Report(failure=_other_code(order.code))
    try:
        work = find_work(order.work)
    except ConfigError as error:
        return Report(failure=Failure(None, error.message, error.remedy))
    completed: list[Completed] = []
    began = time.perf_counter()
    for job in batch:
        started = time.perf_counter()
        if completed and started - began > LONGEST_S:
            break
        try:
            result = work(json.loads(job.payload))
            text = as_json(result)
            units = 1 if order.unit is None else _units(result, order.unit)
        except BaseException as error:  # somebody else's code may raise anything, and this may be a thread
            return Report(tuple(completed), _failure(job.index, error))
        completed.append(Completed(job.index, text, units, time.perf_counter() - started))
    return Report(tuple(completed))


def find_work(name: str) -> Callable[[dict[str, Any]], Any]:
    """Import the function of ``module:function``; raises `ConfigError`."""
    try:
        found = resolve_name(name)
    except Exception as error:  # the module may raise anything
        raise ConfigError(
            f"the work {name!r} cannot be imported ({type(error).__name__}: {error})",
            remedy="name it as module:function, and install its package where the work is done",
        ) from error
    return found  # type: ignore[no-any-return]


def as_json(value: Any, *, sort_keys: bool = False) -> str:
    """Return JSON in ASCII whose floats read back to the same bits; numpy's values become plain ones."""
    return json.dumps(value, separators=(",", ":"), sort_keys=sort_keys, default=_plain)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"JSON cannot hold a {type(value).__name__}")


def _units(result: Any, name: str) -> int:
    rows = result if isinstance(result, list | tuple) else [result]
    return sum(int(row[name]) for row in rows)


def _failure(index: int, error: BaseException) -> Failure:
    details = "".join(traceback.format_exception(error)).rstrip()
    if isinstance(error, RigError):
        return Failure(index, error.message, error.remedy, details)
    said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return Failure(index, said, "", details)


def _other_code(asked: str) -> Failure:
    return Failure(
        None,
        f"a worker on {platform.node()} runs haptic-rig {code_version()}, this is {asked}",
        "install the same version there, and restart the worker",
    )


# Threads ---------------------------------------------------------------------------------------------


class Threads:
    """Threads of this process. Right for work that spends its time without the GIL, as compiled trials do."""

    batch_s = 0.0

    def __init__(self, order: Order, workers: int | None = None) -> None:
        """One thread for each core that this process may use, unless told otherwise."""
        if workers is not None and workers < 1:
            raise ConfigError(f"{workers} workers cannot do anything", remedy="give 1 or more")
        find_work(order.work)  # imports, and thereby compiles, once and before anything is promised
        self._order = order
        self._workers = workers or len(processors())
        self._tickets = count()
        self._inbox: queue.SimpleQueue[tuple[int, Sequence[Job]] | None] = queue.SimpleQueue()
        self._outbox: queue.SimpleQueue[tuple[int, Report]] = queue.SimpleQueue()
        for number in range(self._workers):
            # Daemons: a task that never ends must not keep the program from ending.
            threading.Thread(target=self._body, name=f"rig-sweep-{number}", daemon=True).start()

    def capacity(self) -> int:
        """Return the number of threads."""
        return self._workers

    def submit(self, batch: Sequence[Job]) -> int:
        """Hand a batch to the next idle thread."""
        ticket = next(self._tickets)
        self._inbox.put((ticket, batch))
        return ticket

    def finished(self, timeout_s: float) -> list[tuple[int, Report]]:
        """Return what has come back."""
        return drained(self._outbox, timeout_s)

    def close(self) -> None:
        """Let the threads end after what they are at."""
        for _ in range(self._workers):
            self._inbox.put(None)

    def _body(self) -> None:
        take_no_signals()
        while (given := self._inbox.get()) is not None:
            ticket, batch = given
            self._outbox.put((ticket, run_batch(self._order, batch)))


def drained(waiting: queue.SimpleQueue[Any], timeout_s: float) -> list[Any]:
    """Wait for one entry at most this long, then take all that are there."""
    found = []
    try:
        found.append(waiting.get(timeout=timeout_s))
        while True:
            found.append(waiting.get_nowait())
    except queue.Empty:
        return found
