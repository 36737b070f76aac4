"""Who hands out the tasks of a sweep, keeps what comes back, and knows how far it is.

A thread of its own does all three, so that no Ctrl-C can strike between a result and its line in the journal. The
caller's thread waits, shows the progress and takes the Ctrl-C: the first one ends the handing out, a second one the
waiting for what is running.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import IntEnum
from statistics import median
from typing import Any

from rig.experiments.sweep.executors import Executor, Failure, Job, Report, as_json
from rig.experiments.sweep.journal import Journal, Memory
from rig.realtime.stop_requests import Series, listening

POLL_S = 0.05
SPEEDS = 32  # so many of the last tasks tell how long the next ones take
SHARES = 2.0  # near the end a batch is at most one of so many that each worker still gets


@dataclass(frozen=True, slots=True)
class Task:
    """One independent piece of a computation.

    Attributes
    ----------
    key
        Its name, different from all others of the sweep.
    payload
        What the work gets, in values that JSON can hold (numpy's become plain ones, tuples lists).
    weight
        How long it takes, in a unit that is the same for all tasks.
    """

    key: str
    payload: Mapping[str, Any]
    weight: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """How far a sweep is.

    Attributes
    ----------
    done, running, total
        Tasks that are done, handed out, and all.
    kept
        Those of the done that the journal already held.
    weight_done, weight_running, weight_total, weight_kept
        The same by weight.
    units
        What the results of this run stand for.
    elapsed_s
        Time since the start of this run.
    workers
        How many can work at once; 0 while a cluster has none.
    damaged
        Lines of the journal that could not be read; their tasks run again.
    stopping
        Whether no more tasks are handed out.
    """

    total: int
    weight_total: float
    kept: int = 0
    weight_kept: float = 0.0
    done: int = 0
    weight_done: float = 0.0
    running: int = 0
    weight_running: float = 0.0
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
    def tasks_per_s(self) -> float:
        """Tasks per second of this run."""
        return (self.done - self.kept) / max(self.elapsed_s, 1e-9)

    @property
    def units_per_s(self) -> float:
        """Units per second of this run."""
        return self.units / max(self.elapsed_s, 1e-9)

    @property
    def seconds_left(self) -> float | None:
        """Time until the end at the speed of this run; None before anything is known of it."""
        achieved, left = self.weight_done - self.weight_kept, self.weight_total - self.weight_done
        if self.done == self.total:
            return 0.0
        return self.elapsed_s * left / achieved if achieved > 0.0 else None


class Stop(IntEnum):
    """How much of an end the caller wants."""

    NO = 0
    DRAIN = 1  # hand out nothing more, keep what is running
    LEAVE = 2  # at once


class Coordinator:
    """One run over the tasks that are not done yet. `run` it, then read `failure` and `interruption`.

    Attributes
    ----------
    progress
        How far it is, replaced as a whole, so that any thread may read it.
    failure
        Of the first task in order that raised, or why nothing could be run; None when all went well.
    interruption
        What struck the waiting thread: Ctrl-C, or what `watch` raised.
    """

    def __init__(
        self, tasks: Sequence[Task], kept: Sequence[int], store: Journal | Memory, executor: Executor
    ) -> None:
        self.progress = Progress.begin(tasks, kept, store.damaged)
        self.failure: Failure | None = None
        self.interruption: BaseException | None = None
        self._tasks = tasks
        self._store = store
        self._executor = executor
        done = set(kept)
        left = [index for index in range(len(tasks)) if index not in done]
        self._queue = deque(sorted(left, key=lambda index: -tasks[index].weight))
        self._weight_queued = self.progress.weight_total - self.progress.weight_done
        self._out: dict[int, list[Job]] = {}  # by ticket
        self._speeds: deque[float] = deque(maxlen=SPEEDS)  # seconds per weight
        self._started_s = time.monotonic()
        self._stop = Stop.NO
        self._error: BaseException | None = None
        # Not Thread.join: interrupted by Ctrl-C, it forgets in Python 3.11 that the thread is still running.
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._body, name="rig-sweep", daemon=True)

    def run(self, watch: Callable[[Progress], None] | None) -> None:
        """Run until all is done, a task has failed, or Ctrl-C. Raises what kept the coordinator from its work."""
        self._thread.start()
        try:
            with listening() as series:
                self._wait(watch, series)
        except BaseException as error:
            self.interruption, self._stop = error, Stop.DRAIN
            try:
                self._wait(watch if isinstance(error, KeyboardInterrupt) else None)
            except BaseException:
                self._leave()
        if self._error is not None:
            raise self._error
        if watch is not None and self.interruption is None:
            try:
                watch(self.progress)
            except BaseException as error:  # Ctrl-C after the last task: told like one before it
                self.interruption = error

    def _wait(self, watch: Callable[[Progress], None] | None, series: Series | None = None) -> None:
        while not self._ended.wait(POLL_S):
            if series is not None and series.is_stopped:
                raise KeyboardInterrupt  # Ctrl-C, seen in a thread that gets none, or `rig.stop`
            if watch is not None:
                watch(self.progress)

    def _leave(self) -> None:
        while not self._ended.is_set():
            with suppress(KeyboardInterrupt):
                self._stop = Stop.LEAVE
                self._ended.wait(POLL_S)

    # In the coordinator's thread ----------------------------------------------------------------------

    def _body(self) -> None:
        workers = 0
        try:
            while self._stop != Stop.LEAVE and (self._out or (self._queue and not self._stopping())):
                workers = self._executor.capacity()
                self._hand_out(workers)
                self._look(workers)
                for ticket, report in self._executor.finished(POLL_S):
                    self._keep(self._out.pop(ticket), report)
                self._store.sync()
            self._look(workers)
        except BaseException as error:
            self._error = error
        finally:
            self._ended.set()

    def _stopping(self) -> bool:
        return self._stop != Stop.NO or self.failure is not None

    def _hand_out(self, workers: int) -> None:
        while self._queue and len(self._out) < workers and not self._stopping():
            batch = self._batch(workers)
            self._out[self._executor.submit(batch)] = batch

    def _look(self, workers: int) -> None:
        """Write down who is at what."""
        running = [job.index for batch in self._out.values() for job in batch]
        self.progress = replace(
            self.progress,
            running=len(running),
            weight_running=sum(self._tasks[index].weight for index in running),
            elapsed_s=time.monotonic() - self._started_s,
            workers=workers,
            stopping=self._stopping(),
        )

    def _batch(self, workers: int) -> list[Job]:
        """Take the next tasks off the queue: one, or as many as make a batch of the wanted length."""
        wanted = 0.0
        if self._executor.batch_s > 0.0 and self._speeds:
            in_time = self._executor.batch_s / max(median(self._speeds), 1e-9)
            wanted = min(in_time, self._weight_queued / (SHARES * workers))
        batch: list[Job] = []
        weight = 0.0
        while self._queue and (not batch or weight + self._tasks[self._queue[0]].weight <= wanted):
            task = self._tasks[index := self._queue.popleft()]
            batch.append(Job(index, as_json(task.payload, sort_keys=True)))
            weight += task.weight
        self._weight_queued -= weight
        return batch

    def _keep(self, batch: Sequence[Job], report: Report) -> None:
        now = self.progress
        done, weight_done, units = now.done, now.weight_done, now.units
        for job in report.completed:
            task = self._tasks[job.index]
            self._store.append(job.index, task.key, job.text)
            self._speeds.append(job.seconds / task.weight)
            done, weight_done, units = done + 1, weight_done + task.weight, units + job.units
        self.progress = replace(now, done=done, weight_done=weight_done, units=units)
        self._take_back(batch[len(report.completed) :])
        if report.failure is not None and self._comes_first(report.failure):
            self.failure = report.failure

    def _take_back(self, jobs: Sequence[Job]) -> None:
        """Put what a batch had no time for to the front again."""
        self._queue.extendleft(job.index for job in reversed(jobs))
        self._weight_queued += sum(self._tasks[job.index].weight for job in jobs)

    def _comes_first(self, failure: Failure) -> bool:
        if self.failure is None or failure.index is None:
            return True
        return self.failure.index is not None and failure.index < self.failure.index
