"""Long computations: many independent tasks, on all cores or on a cluster, that survive whatever ends the process.

A task is a key, a function of a module and plain data, from which that function makes a result that JSON can hold.
`run` returns the results in the order of the tasks, the same to the last bit on any executor, in any order,
in one go or in ten: results always pass through JSON, which gives floats back as they were.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, overload

from rig.core.errors import ConfigError, RigError, StoppedError
from rig.experiments.sweep._coordinator import Coordinator, Progress, Task, Watch
from rig.experiments.sweep._executors import as_json, executor_for
from rig.experiments.sweep._journal import Journal, Memory
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
        """Return the number of finished tasks."""
        return len(self.results)


def run(
    tasks: Sequence[Task],
    *,
    journal: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    unit: str | None = None,
    watch: Watch | None = None,
) -> Results:
    """Run all tasks and return their results.

    Parameters
    ----------
    tasks
        Tasks to compute.
    journal
        File that keeps results as they come. What it already holds is not computed again; a finished one returns at
        once. None: results are kept in memory.
    scheduler
        Address of a Dask scheduler, like ``tcp://10.0.0.5:8786``. It and its workers need the same haptic-rig, and the
        modules of the tasks' functions. None: threads of this process.
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
        A journal of another plan; no such scheduler; workers with another haptic-rig, or without a task's function.
    RecordingError
        The journal cannot be written, or another process writes it.
    TaskError
        A task raised. No new ones were handed out; what was running has been kept.
    SweepStoppedError
        Ctrl-C: as above. A second Ctrl-C does not wait for what is running.
    """
    store = _open(tasks, journal)
    try:
        kept = store.done()
        if len(kept) == len(tasks):
            if watch is not None:
                watch(Progress.begin(tasks, kept, store.damaged))
            return Results(tasks, kept, store)
        executor = executor_for(scheduler, workers)
        try:
            coordinator = Coordinator(tasks, kept, store, executor, unit=unit, watch=watch)
            coordinator.run()
        finally:
            executor.close()
    finally:
        store.close()
    results = Results(tasks, store.done(), store)
    _raise_what_ended(coordinator, tasks, results, journal)
    return results


def run_here(
    name: str, perform: Callable[[Task], Any], tasks: Sequence[Task], *, journal: Path | None = None
) -> Results:
    """Run tasks one after the other in the caller's thread, for work with a rig or a person in it.

    Parameters
    ----------
    name
        Name of the work in the journal, instead of the tasks' functions.
    perform
        Does one task and returns what JSON can hold. An exception from it ends the run; what was done is kept.
    tasks, journal
        As in `run`, with the same errors of the journal.
    """
    store = _open(tasks, journal, name)
    try:
        kept = set(store.done())
        for index, task in enumerate(tasks):
            if index not in kept:
                store.append(index, task.key, as_json(perform(task)))
    finally:
        store.close()
    return Results(tasks, store.done(), store)


def _open(tasks: Sequence[Task], journal: Path | None, name: str | None = None) -> Journal | Memory:
    """Open where results are kept. A journal says first what is computed: ``plan`` is a hash of all that decides it."""
    if len({task.key for task in tasks}) != len(tasks):
        raise ValueError("two tasks have the same key")
    if not all(task.weight > 0.0 for task in tasks):
        raise ValueError("a task's weight is not above zero")
    works = [task.work_name if name is None else name for task in tasks]
    local = next((work for work in works if name is None and "<" in work), None)
    if local is not None:
        raise ValueError(
            f"{local} is not defined at the top level of a module, so a journal or a worker cannot "
            "refer to it"
        )
    work, code = ", ".join(dict.fromkeys(works)), code_version()
    digest = sha256(as_json([work, code]).encode())
    for task, of_task in zip(tasks, works, strict=True):
        digest.update(as_json([task.key, of_task, task.payload], sort_keys=True).encode())
    # The first task stands in the header as text, so that a refused journal can name what differs; the hash covers all.
    first = json.loads(as_json({"key": tasks[0].key, "payload": tasks[0].payload})) if tasks else None
    plan = {"work": work, "version": code, "tasks": len(tasks), "plan": digest.hexdigest(), "first": first}
    return Memory(len(tasks)) if journal is None else Journal(journal, plan, [task.key for task in tasks])


def _raise_what_ended(
    coordinator: Coordinator, tasks: Sequence[Task], results: Results, journal: Path | None
) -> None:
    """Raise the error of a sweep that did not run to its end."""
    total, failure, interruption = len(tasks), coordinator.failure, coordinator.interruption
    so_far = f"{len(results)} of {total} tasks are done" + (
        "" if journal is None else f" and stored in {journal}"
    )
    if failure is not None:
        index, why = failure
        if not why.of_task:
            raise ConfigError(why.message, remedy=why.remedy)
        key = tasks[index].key
        error = TaskError(
            f"task {key} failed: {why.message}; {so_far}", remedy=why.remedy, key=key, results=results
        )
        error.add_note(why.details)
        raise error
    if isinstance(interruption, KeyboardInterrupt):
        remedy = "the same command resumes from there" if journal else "name a journal to be able to resume"
        raise SweepStoppedError(
            f"stopped; {so_far}", remedy=remedy, total=total, results=results
        ) from interruption
    if interruption is not None:
        raise interruption
