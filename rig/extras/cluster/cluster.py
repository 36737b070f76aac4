"""Executor that runs the tasks of a sweep on the workers of a Dask scheduler. Needs the extra ``cluster``.

If a worker dies, the scheduler gives its tasks to other workers, and computes results that are lost with the worker
again. Each task refuses to run on a worker that has another version of the code.
"""

import math
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from importlib import import_module
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.experiments.sweep import Failure

CONNECT_S = 10.0
CENSUS_S = 1.0  # how often the workers are counted


class Cluster:
    """Executor for sweeps (many independent simulations) on the workers of one Dask scheduler.

    Workers may join and leave while a sweep runs; without workers no task is sent.
    """

    # Tasks sent ahead to a worker: sending one takes some 10 ms, so the next one must already wait there.
    ahead = 2

    def __init__(self, scheduler: str) -> None:
        try:
            self._dask = import_module("distributed")
        except ImportError as error:
            raise ConfigError(
                "a Dask cluster needs the package distributed, which is not installed",
                remedy="install it: pip install 'haptic-rig[cluster]'",
            ) from error
        self._scheduler = scheduler
        self._client = self._connect()
        self._pool = self._client.get_executor(pure=False)
        self._threads, self._counted_s = 0, -math.inf

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Send the call ``function(*arguments)`` to the scheduler; return the future of its result."""
        future: Future[Any] = self._pool.submit(function, *arguments)
        return future

    def workers(self) -> int:
        """Return how many tasks can run at once: the number of threads of all workers; 0 without workers."""
        if time.monotonic() - self._counted_s >= CENSUS_S:
            try:
                self._threads = sum(self._client.nthreads().values())
            except Exception as error:
                # distributed raises errors of whatever library carries the connection.
                raise self._scheduler_lost_error() from error
            self._counted_s = time.monotonic()
        return self._threads

    def explain(self, error: BaseException) -> Failure:
        """Return why a task failed and what to do; raise `RigError` if the scheduler is gone."""
        if isinstance(error, CancelledError):
            raise self._scheduler_lost_error() from error
        if isinstance(error, self._dask.KilledWorker):
            ended = f"it ended every worker that ran it ({error.allowed_failures + 1} workers)"
            return Failure(ended, "find the cause in the log of a worker", str(error))
        why = error.__cause__ or error
        # The task failed before its code ran: the worker cannot import the code, or has another version of it.
        return Failure(
            f"{self._scheduler} cannot run this ({type(why).__name__}: {' '.join(str(why).split())})",
            "install this version of haptic-rig, and the package of the work, for scheduler and workers, and restart "
            "them",
            of_task=False,
        )

    def close(self) -> None:
        """Cancel unfinished tasks, and disconnect from the scheduler."""
        self._client.close()

    def _connect(self) -> Any:
        try:
            return self._dask.Client(
                self._scheduler, timeout=CONNECT_S, set_as_default=False, name="haptic-rig"
            )
        except (OSError, ValueError, TypeError) as error:  # TimeoutError is an OSError
            raise ConfigError(
                f"no reply from a Dask scheduler at {self._scheduler} ({type(error).__name__}: {error})",
                remedy="start one with `dask scheduler` and name its address, like tcp://10.0.0.5:8786",
            ) from error

    def _scheduler_lost_error(self) -> RigError:
        return RigError(
            f"the connection to the Dask scheduler at {self._scheduler} was lost",
            remedy="start the scheduler again",
        )
