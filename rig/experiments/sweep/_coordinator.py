"""Hand out the tasks of a sweep, store the results, report the progress and handle Ctrl-C, all in the caller's thread.

`_tasks` runs it. The first Ctrl-C ends the handing out, a second one the waiting for running tasks, at once.
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
    """One independent piece of a computation: ``work(payload)``.

    Attributes
    ----------
    key
        Its name, different from all others of the sweep.
    work
        Function of a module, which other processes import: payload (a dict) → result that JSON can hold. It must
        depend on nothing but the payload.
    payload
        Arguments of the work, in values that JSON can hold (numpy's become plain ones, tuples lists).
    weight
        How long it takes, in a unit that is the same for all tasks.
    """

    key: str
    work: Work
    payload: Mapping[str, Any]
    weight: float = 1.0

    @property
    def work_name(self) -> str:
        """Return the work as ``module:function``, by which a journal names it."""
        return f"{self.work.__module__}:{self.work.__qualname__}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    done, running, total
        Tasks that are done, handed out, and all.
    kept
        Those of the done that the journal already held.
    weight_done, weight_total, weight_kept
        The same by weight.
    units
        Units of work that the results of this run represent.
    elapsed_s
        Time since the start of this run.
    workers
        How many can work at once; 0 while a cluster has none.
    damaged
        Lines of the journal that could not be read; their tasks run again.
    stopping
        True if no more tasks are handed out.
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
        """Return the progress before anything has been handed out; `kept` are the tasks already done."""
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
        """Share of the work that is done, by weight."""
        return 1.0 if self.done == self.total else self.weight_done / self.weight_total

    @property
    def units_per_s(self) -> float:
        """Return units per second of this run."""
        return self.units / max(self.elapsed_s, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """Time until the end at the speed of this run; None before anything is known of it."""
        achieved, left = self.weight_done - self.weight_kept, self.weight_total - self.weight_done
        if self.done == self.total:
            return 0.0
        return self.elapsed_s * left / achieved if achieved > 0.0 else None


class Coordinator:
    """One run over the tasks that are not done yet. `run` it, then read `failure` and `interruption`.

    Attributes
    ----------
    failure
        Index of the first task in order that failed, -1 when no task can run, and what went wrong; None if all is well.
    interruption
        Ctrl-C, or what `watch` raised.
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
        self._tasks, self._store, self._executor, self._unit, self._watch = (
            tasks,
            store,
            executor,
            unit,
            watch,
        )
        self._progress = Progress.begin(tasks, kept, store.damaged)
        left = set(range(len(tasks))).difference(kept)
        # The heaviest first: a long task that begins last would keep one worker busy while the others idle.
        self._queue = deque(sorted(left, key=lambda index: (-tasks[index].weight, index)))
        self._out: dict[Future[Any], int] = {}
        self._back: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._started_s, self._shown_s = time.monotonic(), -math.inf

    def run(self) -> None:
        """Run until all is done, a task has failed, or Ctrl-C. Raises what kept it from its work."""
        # A signal that ends the process at once is left alone: the journal is good whatever ends it.
        numbers = tuple(one for one in (signal.SIGINT, signal.SIGTERM) if callable(signal.getsignal(one)))
        # A signal is only noted, and acted on between two results: no Ctrl-C strikes between a result and its line in
        # the journal. A line that the second one tears is left out when the journal is read.
        signals: list[int] = []

        def note(number: int, frame: object) -> None:
            signals.append(number)
            if len(signals) > 1:  # the first is not acted on: the watcher waits for a stopped terminal
                raise KeyboardInterrupt

        with handle_signals(numbers, note), listening() as series:
            try:
                self._work(signals, series)
            except KeyboardInterrupt as error:
                self.interruption = self.interruption or error

    def _work(self, signals: list[int], series: RunSeries) -> None:
        while self._out or (self._queue and not self._stopping):
            self._hand_out()
            if self._check_interruption(signals, series):
                return
            self._take()
            self._store.sync()
        self._shown_s = -math.inf
        self._check_interruption(signals, series)

    @property
    def _stopping(self) -> bool:
        return self.interruption is not None or self.failure is not None

    def _hand_out(self) -> None:
        workers = self._executor.workers()
        while self._queue and not self._stopping and len(self._out) < workers * self._executor.ahead:
            task = self._tasks[index := self._queue.popleft()]
            text = as_json(task.payload, sort_keys=True)
            future = self._executor.submit(perform, task.work, text, self._unit, code_version())
            self._out[future] = index
            future.add_done_callback(self._back.put)
        self._progress = replace(
            self._progress, running=len(self._out), workers=workers, stopping=self._stopping
        )

    def _check_interruption(self, signals: list[int], series: RunSeries) -> bool:
        """Show the progress and act on Ctrl-C; returns True for the second one, which waits for nothing."""
        before = self.interruption
        try:
            # `rig.stop`, and a Ctrl-C that another thread was given, count in the series: once.
            if signals or (before is None and series.is_stopped):
                signals.clear()
                raise KeyboardInterrupt
            if self._watch is not None and time.monotonic() - self._shown_s >= POLL_S:
                self._shown_s = time.monotonic()
                self._watch(replace(self._progress, elapsed_s=self._shown_s - self._started_s))
        except BaseException as error:
            self.interruption = before or error
            if not isinstance(error, KeyboardInterrupt):
                # A watcher that fails once fails at every look: the run then ends without one.
                self._watch = None
            return before is not None
        return False

    def _take(self) -> None:
        """Keep the results that have come back; wait a moment for the first one."""
        try:
            self._keep(self._back.get(timeout=POLL_S))
            while True:
                self._keep(self._back.get_nowait())
        except queue.Empty:
            return

    def _keep(self, future: Future[Any]) -> None:
        index = self._out.pop(future)
        try:
            report: Done | Failure = future.result()
        except BaseException as error:
            # `perform` returns the errors of a task: what is raised here is the executor's own, such as a lost worker.
            report = self._executor.explain(error)
        if isinstance(report, Failure):
            found = (index if report.of_task else -1, report)
            # The failure of the first task in order, so that the error is the same on any executor.
            self.failure = min(self.failure or found, found, key=lambda failure: failure[0])
            return
        task, now = self._tasks[index], self._progress
        self._store.append(index, task.key, report.text)
        self._progress = replace(
            now,
            done=now.done + 1,
            weight_done=now.weight_done + task.weight,
            units=now.units + report.units,
            running=len(self._out),
        )
