"""Long computations: many independent tasks, on all cores or on a cluster, that survive whatever ends the process.

A task is a key and plain data; the work is a function, named by a string, from that data to a result that JSON can
hold. `run` returns the results in the order of the tasks, the same to the last bit whoever computed them, in whatever
order, in one go or in ten: results always pass through JSON, which gives floats back as they were.

What is where: `rig.experiments.sweep.coordinator` hands out and keeps, `rig.experiments.sweep.executors` and
`rig.experiments.sweep.cluster` are where tasks run, `rig.experiments.sweep.journal` is the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, overload

from rig.core.errors import ConfigError, RigError, StoppedError
from rig.experiments.sweep.cluster import Cluster
from rig.experiments.sweep.coordinator import Coordinator, Progress, Task
from rig.experiments.sweep.executors import Order, Threads, as_json
from rig.experiments.sweep.journal import Journal, Memory
from rig.realtime.source_files import code_version


class Results(Sequence[Any]):
    """Results of `tasks`, in their order; those in a journal are read as they are asked for, and never all held.

    Equal results are equal in every bit and in the types that they are made of, wherever they were computed.
    """

    def __init__(self, tasks: Sequence[Task], indices: Sequence[int], store: Journal | Memory) -> None:
        self.tasks = tasks if len(indices) == len(tasks) else [tasks[index] for index in indices]
        self._indices = indices
        self._store = store

    def __len__(self) -> int:
        return len(self._indices)

    def __iter__(self) -> Iterator[Any]:
        return self._store.results(self._indices)

    @overload
    def __getitem__(self, number: int) -> Any: ...
    @overload
    def __getitem__(self, number: slice) -> list[Any]: ...
    def __getitem__(self, number: int | slice) -> Any:
        if isinstance(number, slice):
            return list(self._store.results(self._indices[number]))
        return next(iter(self._store.results([self._indices[number]])))


class TaskError(RigError):
    """A task raised. `key` names it; `results` are those of the tasks that are done. Its traceback is a note."""

    exit_code = 11

    def __init__(self, message: str, *, remedy: str, key: str, results: Results) -> None:
        super().__init__(message, remedy=remedy)
        self.key = key
        self.results = results


class SweepStoppedError(StoppedError):
    """A person stopped the sweep. `results` are those of the tasks that are done, out of `total`."""

    def __init__(self, message: str, *, remedy: str, total: int, results: Results) -> None:
        super().__init__(message, remedy=remedy)
        self.total = total
        self.results = results

    @property
    def done(self) -> int:
        """How many tasks are done."""
        return len(self.results)


def run(
    work: str,
    tasks: Sequence[Task],
    *,
    journal: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    unit: str | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Results:
    """Run all tasks and return their results.

    Parameters
    ----------
    work
        ``module:function``, imported where it runs: payload (a dict) → result. It must depend on nothing but the
        payload. Threads run it in this process, several at a time.
    tasks
        What to compute.
    journal
        File that keeps results as they come. What it already holds is not computed again; a finished one returns at
        once. None: results are kept in memory.
    scheduler
        Address of a Dask scheduler, like ``tcp://10.0.0.5:8786``. It and its workers need the same haptic-rig, the
        workers also the module of `work`. None: threads of this process.
    workers
        How many threads. [one for each core that this process may use]
    unit
        Name of a number in each row of a result that says for how many units the row stands, like ``trials``. None: a
        task is a unit.
    watch
        Called some twenty times a second in the thread of the caller, and at the end.

    Raises
    ------
    ConfigError
        A journal of another plan; work that cannot be imported; no such scheduler; workers with another haptic-rig.
    RecordingError
        The journal cannot be written, or another process writes it.
    TaskError
        A task raised. No new ones were handed out; what was running has been kept.
    SweepStoppedError
        Ctrl-C: as above. A second Ctrl-C does not wait for what is running.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError(
            "a scheduler decides on its workers itself",
            remedy="give either a scheduler or a number of workers",
        )
    header = _header(work, tasks)
    store = Memory(len(tasks)) if journal is None else Journal(journal, header, [task.key for task in tasks])
    try:
        kept = store.done()
        if len(kept) == len(tasks):
            if watch is not None:
                watch(Progress.begin(tasks, kept, store.damaged))
            return Results(tasks, kept, store)
        order = Order(work, unit, code_version())
        executor = Threads(order, workers) if scheduler is None else Cluster(order, scheduler)
        try:
            coordinator = Coordinator(tasks, kept, store, executor)
            coordinator.run(watch)
        finally:
            executor.close()
    finally:
        store.close()
    results = Results(tasks, store.done(), store)
    _raise_what_ended(coordinator, tasks, results, journal)
    return results


def run_here(
    work: str, perform: Callable[[Task], Any], tasks: Sequence[Task], *, journal: Path | None = None
) -> Results:
    """Run tasks one after the other in the caller's thread, for work with a rig or a person in it.

    Parameters
    ----------
    work
        What the journal calls it.
    perform
        Does one task and returns what JSON can hold. An exception from it ends the run; what was done is kept.
    tasks, journal
        As in `run`, with the same errors of the journal.
    """
    header = _header(work, tasks)
    store = Memory(len(tasks)) if journal is None else Journal(journal, header, [task.key for task in tasks])
    try:
        kept = set(store.done())
        for index, task in enumerate(tasks):
            if index not in kept:
                store.append(index, task.key, as_json(perform(task)))
    finally:
        store.close()
    return Results(tasks, store.done(), store)


def _header(work: str, tasks: Sequence[Task]) -> dict[str, Any]:
    """Return what a journal says first: ``plan`` is a hash of all that decides the results."""
    if len({task.key for task in tasks}) != len(tasks):
        raise ValueError("two tasks have the same key")
    if not all(task.weight > 0.0 for task in tasks):
        raise ValueError("a task's weight is not above zero")
    code = code_version()
    digest = sha256(as_json([work, code]).encode())
    for task in tasks:
        digest.update(as_json([task.key, task.payload], sort_keys=True).encode())
    first = json.loads(as_json({"key": tasks[0].key, "payload": tasks[0].payload})) if tasks else None
    return {"work": work, "version": code, "tasks": len(tasks), "plan": digest.hexdigest(), "first": first}


def _raise_what_ended(
    coordinator: Coordinator, tasks: Sequence[Task], results: Results, journal: Path | None
) -> None:
    """Raise the error of a sweep that did not run to its end."""
    total, failure, interruption = len(tasks), coordinator.failure, coordinator.interruption
    so_far = f"{len(results)} of {total} tasks are done" + (
        "" if journal is None else f" and kept in {journal}"
    )
    if failure is not None and failure.index is None:
        raise ConfigError(failure.message, remedy=failure.remedy)
    if failure is not None and failure.index is not None:
        key = tasks[failure.index].key
        error = TaskError(
            f"task {key} failed: {failure.message}; {so_far}", remedy=failure.remedy, key=key, results=results
        )
        error.add_note(failure.details)
        raise error
    if isinstance(interruption, KeyboardInterrupt):
        remedy = "the same command resumes from there" if journal else "name a journal to be able to resume"
        raise SweepStoppedError(
            f"stopped; {so_far}", remedy=remedy, total=total, results=results
        ) from interruption
    if interruption is not None:
        raise interruption
