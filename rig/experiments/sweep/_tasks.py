"""Run the tasks of a sweep (independent function calls), and return their results in the order of the tasks.

A task is a key, a function of a module and plain data, from which the function computes JSON values. Results are equal
to the last bit on any executor, in any order, and after a stop and a resume: every result is converted to JSON text and
back, which does not change floats.
"""

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
    """The results (JSON values) of the function calls `tasks`, as a sequence in the order of the tasks.

    Results in a journal are read from the file at each access, so that a sweep may have more results than fit in
    memory.
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
    """A task raised an exception: `key` names the task, `results` are of finished tasks, a note is the traceback."""

    exit_code = 11

    def __init__(self, message: str, *, remedy: str, key: str, results: Results) -> None:
        super().__init__(message, remedy=remedy)
        self.key = key
        self.results = results


class SweepStoppedError(StoppedError):
    """Ctrl-C stopped the tasks: `results` are those of the finished tasks, `total` is the number of all tasks."""

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
    """Run all tasks (function calls) in parallel, and return their results in the order of the tasks.

    Parameters
    ----------
    tasks
        Tasks to compute.
    journal
        File in which each result is stored when its task has finished. Tasks whose results are in the file already are
        not run again. None: the results are stored in memory.
    scheduler
        Address of a Dask scheduler, like ``tcp://10.0.0.5:8786``. Scheduler and workers need the same version of
        haptic-rig, and the modules of the tasks' functions. None: threads of this process.
    workers
        Number of threads. None: one for each core that this process may use.
    unit
        Name of a number in each row of a result that counts units of work for the progress, for example ``ticks``.
        None: each task is one unit.
    watch
        Called with the `Progress` about twenty times a second in the thread of the caller, and at the end.

    Raises
    ------
    ConfigError
        The journal belongs to another sweep, the scheduler is not found, or its workers have another haptic-rig or lack
        a task's function.
    RecordingError
        The journal cannot be written, or another process writes it.
    TaskError
        A task raised an exception. No more tasks were started, and the results of the running tasks are stored.
    SweepStoppedError
        Ctrl-C was pressed; the results of the running tasks are stored. A second Ctrl-C does not wait for running
        tasks.
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
    _raise_ending(coordinator, tasks, results, journal)
    return results


def run_here(
    name: str, perform: Callable[[Task], Any], tasks: Sequence[Task], *, journal: Path | None = None
) -> Results:
    """Run tasks one after the other in the caller's thread, for work that needs a rig or a person.

    Parameters
    ----------
    name
        Name of the work in the journal (file of results), instead of the names of the tasks' functions.
    perform
        Function that runs one task and returns JSON values. An exception ends the run; the earlier results are stored.
    tasks, journal
        Tasks to compute, and the file of results; `ConfigError` if the file belongs to other tasks.
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
    """Open the store of results: a file with a hash of everything that determines the results, or memory."""
    if len({task.key for task in tasks}) != len(tasks):
        raise ValueError("two tasks have the same key; give each task of a sweep its own key")
    if not all(task.weight > 0.0 for task in tasks):
        raise ValueError("a task's weight is not above zero; give the expected duration in any unit")
    works = [task.work_name if name is None else name for task in tasks]
    local = next((work for work in works if name is None and "<" in work), None)
    if local is not None:
        raise ValueError(
            f"{local} is not defined at the top level of a module, so a journal or a worker cannot "
            "refer to it; move the function to the top level"
        )
    work, code = ", ".join(dict.fromkeys(works)), code_version()
    digest = sha256(as_json([work, code]).encode())
    for task, of_task in zip(tasks, works, strict=True):
        digest.update(as_json([task.key, of_task, task.payload], sort_keys=True).encode())
    # The header contains the first task as text, so that the error for another sweep can name the differences; the hash
    # covers all tasks.
    first = json.loads(as_json({"key": tasks[0].key, "payload": tasks[0].payload})) if tasks else None
    plan = {"work": work, "version": code, "tasks": len(tasks), "plan": digest.hexdigest(), "first": first}
    return Memory(len(tasks)) if journal is None else Journal(journal, plan, [task.key for task in tasks])


def _raise_ending(
    coordinator: Coordinator, tasks: Sequence[Task], results: Results, journal: Path | None
) -> None:
    """Raise the error of a task, or for an interruption; do nothing if all tasks finished."""
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
        remedy = (
            "run the same command again: it resumes from there"
            if journal
            else "give a journal the next time, to be able to resume"
        )
        raise SweepStoppedError(
            f"stopped; {so_far}", remedy=remedy, total=total, results=results
        ) from interruption
    if interruption is not None:
        raise interruption
