"""Submit the tasks (function calls) of a sweep, store results, report progress and handle Ctrl-C, in one thread.

`rig.experiments.sweep.run` uses the class `Coordinator`. After the first Ctrl-C no new task starts; after the second
Ctrl-C the sweep does not wait for running tasks.
"""

from __future__ import annotations

import math
import queue
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from rig.experiments.sweep._executors import Done, Executor, Failure, Work, as_json, perform
from rig.experiments.sweep._journal import Journal, Memory
from rig.realtime.handlers import handle_signals
from rig.realtime.source_files import code_version
from rig.realtime.stop_requests import RunSeries, listening

POLL_S = 0.05

Watch = Callable[["Progress"], None]


@dataclass(frozen=True, slots=True)
class Task:
    """A task of a sweep (a set of independent computations): the function call ``work(payload)``.

    Attributes
    ----------
    key
        Name of the task, unique in the sweep.
    work
        Function at the top level of a module, which other processes can import. Its argument is the payload, its result
        are JSON values, which must depend on the payload only.
    payload
        Arguments of the function, as JSON values (numpy values become Python values, tuples become lists).
    weight
        Expected duration, in a unit that is the same for all tasks.
    """

    key: str
    work: Work
    payload: Mapping[str, Any]
    weight: float = 1.0

    @property
    def work_name(self) -> str:
        """Return the name of the task's function, ``module:function``, by which the file of results refers to it."""
        return f"{self.work.__module__}:{self.work.__qualname__}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """A snapshot of the progress of a sweep (many tasks that run in parallel).

    Attributes
    ----------
    done, running, total
        Numbers of finished tasks, of submitted tasks that are not finished, and of all tasks.
    kept
        Number of finished tasks whose results were in the journal (file of results) before this run.
    weight_done, weight_total, weight_kept
        Sums of the weights of the finished tasks, of all tasks, and of the tasks in `kept`.
    units
        Number of units of work, for example hits, in the results of this run.
    elapsed_s
        Time since the start of this run (s).
    workers
        Number of tasks that can run at once; 0 while a cluster has no workers.
    damaged
        Number of lines of the journal that could not be read; their tasks run again.
    stopping
        True if no more tasks are submitted.
    """

    total: int
    weight_total: float
    kept: int = 0
    weight_kept: float = 0.0
    done: int = 0
    weight_done: float = 0.0
    running: int = 0
    units: int = 0
    elapsed_s: float = 0.0
    workers: int = 0
    damaged: int = 0
    stopping: bool = False

    @classmethod
    def begin(cls, tasks: Sequence[Task], kept: Sequence[int], damaged: int) -> Progress:
        """Return the progress before any task is submitted.

        `kept` has the indices of the tasks that an earlier run finished; `damaged` is the number of unreadable lines in
        the file of results.
        """
        weight = sum(tasks[index].weight for index in kept)
        return cls(
            total=len(tasks),
            weight_total=sum(task.weight for task in tasks),
            kept=len(kept),
            weight_kept=weight,
            done=len(kept),
            weight_done=weight,
            damaged=damaged,
        )

    @property
    def fraction(self) -> float:
        """Return the finished fraction of all tasks by their weights (0 to 1)."""
        return 1.0 if self.done == self.total else self.weight_done / self.weight_total

    @property
    def units_per_s(self) -> float:
        """Return the number of units of work, for example hits, per second in this run."""
        return self.units / max(self.elapsed_s, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """Return the estimated time until all tasks are finished (s) at this run's mean speed; None before a result."""
        achieved, left = self.weight_done - self.weight_kept, self.weight_total - self.weight_done
        if self.done == self.total:
            return 0.0
        return self.elapsed_s * left / achieved if achieved > 0.0 else None


class Coordinator:
    """A scheduler of the unfinished tasks of a sweep. Call `run`, then read `failure` and `interruption`.

    Attributes
    ----------
    failure
        Index and error of the failed task with the lowest index; the index is -1 if no task can run. None without a
        failure.
    interruption
        `KeyboardInterrupt` after Ctrl-C, or the exception that `watch` raised; else None.
    """

    def __init__(
        self,
        tasks: Sequence[Task],
        kept: Sequence[int],
        store: Journal | Memory,
        executor: Executor,
        *,
        unit: str | None,
        watch: Watch | None,
    ) -> None:
        self.failure: tuple[int, Failure] | None = None
        self.interruption: BaseException | None = None
        self._tasks, self._store, self._executor = tasks, store, executor
        self._unit, self._watch = unit, watch
        self._progress = Progress.begin(tasks, kept, store.damaged)
        left = set(range(len(tasks))).difference(kept)
        # The longest tasks first: a long task that begins last would run alone while other workers are idle.
        self._queue = deque(sorted(left, key=lambda index: (-tasks[index].weight, index)))
        self._running: dict[Future[Any], int] = {}
        self._finished: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._started_s, self._shown_s = time.monotonic(), -math.inf

    def run(self) -> None:
        """Run until all tasks are finished, one fails, or Ctrl-C; raise `RecordingError` if a result is not stored."""
        # Do not handle a signal that ends the process at once: the journal is valid after any end.
        numbers = tuple(one for one in (signal.SIGINT, signal.SIGTERM) if callable(signal.getsignal(one)))
        # A signal is stored, and handled between two results, so that the first Ctrl-C cannot separate a result from
        # its line in the journal. A line that the second Ctrl-C interrupts is ignored when the journal is read.
        signals: list[int] = []

        def note(number: int, frame: object) -> None:
            signals.append(number)
            # A second signal arrives before the first is handled if the progress function blocks on a stopped terminal.
            if len(signals) > 1:
                raise KeyboardInterrupt

        with handle_signals(numbers, note), listening() as series:
            try:
                self._work(signals, series)
            except KeyboardInterrupt as error:
                self.interruption = self.interruption or error
        # A signal during the last progress report was stored after the last look at the stored signals.
        if signals or series.is_stopped:
            self.interruption = self.interruption or KeyboardInterrupt()

    def _work(self, signals: list[int], series: RunSeries) -> None:
        while self._running or (self._queue and not self._stopping):
            self._submit_tasks()
            if self._check_interruption(signals, series):
                return
            self._store_finished()
            self._store.sync()
        self._shown_s = -math.inf
        self._check_interruption(signals, series)

    @property
    def _stopping(self) -> bool:
        return self.interruption is not None or self.failure is not None

    def _submit_tasks(self) -> None:
        workers = self._executor.workers()
        while self._queue and not self._stopping and len(self._running) < workers * self._executor.ahead:
            task = self._tasks[index := self._queue.popleft()]
            text = as_json(task.payload, sort_keys=True)
            future = self._executor.submit(perform, task.work, text, self._unit, code_version())
            self._running[future] = index
            future.add_done_callback(self._finished.put)
        self._progress = replace(
            self._progress, running=len(self._running), workers=workers, stopping=self._stopping
        )

    def _check_interruption(self, signals: list[int], series: RunSeries) -> bool:
        """Call the progress function and handle Ctrl-C; return True after a second Ctrl-C: leave running tasks."""
        before = self.interruption
        try:
            # `rig.stop`, or a Ctrl-C that another thread received, stops the series: handle it only once.
            if signals or (before is None and series.is_stopped):
                signals.clear()
                raise KeyboardInterrupt
            if self._watch is not None and time.monotonic() - self._shown_s >= POLL_S:
                self._shown_s = time.monotonic()
                self._watch(replace(self._progress, elapsed_s=self._shown_s - self._started_s))
        except BaseException as error:
            self.interruption = before or error
            if not isinstance(error, KeyboardInterrupt):
                # A progress function that failed once would fail again: continue to the end without it.
                self._watch = None
            return before is not None
        return False

    def _store_finished(self) -> None:
        """Store the results of finished tasks; wait up to 50 ms for the first result."""
        try:
            self._store_result(self._finished.get(timeout=POLL_S))
            while True:
                self._store_result(self._finished.get_nowait())
        except queue.Empty:
            return

    def _store_result(self, future: Future[Any]) -> None:
        index = self._running.pop(future)
        try:
            report: Done | Failure = future.result()
        except BaseException as error:
            # `perform` returns errors of tasks: an exception here is the executor's, for example a lost worker.
            report = self._executor.explain(error)
        if isinstance(report, Failure):
            found = (index if report.of_task else -1, report)
            # Store the failure with the lowest index, so that the error is equal on any executor.
            self.failure = min(self.failure or found, found, key=lambda failure: failure[0])
            return
        task, now = self._tasks[index], self._progress
        self._store.append(index, task.key, report.text)
        self._progress = replace(
            now,
            done=now.done + 1,
            weight_done=now.weight_done + task.weight,
            units=now.units + report.units,
            running=len(self._running),
        )
