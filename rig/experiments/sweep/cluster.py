"""Where the tasks of a sweep are worked off: the workers of a Dask scheduler.

A worker that dies takes nothing with it: the scheduler gives its batches to others, a result that died with it is
computed again, and the coordinator keeps each once. One that runs other code is refused by `run_batch` itself, whenever
it joins. Needs the package distributed (extra ``cluster``).
"""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Sequence
from importlib import import_module
from itertools import count
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.experiments.sweep.executors import Failure, Job, Order, Report, drained, run_batch

BATCH_S = 0.5  # a good length of a batch: some fifty times what it costs to send one
CONNECT_S = 10.0
CENSUS_S = 1.0  # how often the workers are counted
GATHER_S = 2.0  # for a result on its way; after that its worker may be gone, and another is at it


class Cluster:
    """The workers of one scheduler. They may come and go; while there are none, nothing is sent."""

    batch_s = BATCH_S

    def __init__(self, order: Order, scheduler: str) -> None:
        self._order = order
        self._scheduler = scheduler
        self._dask = _distributed()
        self._client = self._connect()
        self._out: dict[int, tuple[Any, Sequence[Job]]] = {}  # by ticket: the future, its batch
        self._tickets = count()
        self._outbox: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._threads = 0
        self._counted_s = -math.inf

    def capacity(self) -> int:
        """Return the number of threads of all workers; none while there are none."""
        if time.monotonic() - self._counted_s >= CENSUS_S:
            try:
                self._threads = sum(self._client.nthreads().values())
            except Exception as error:  # whatever its connection is made of
                raise self._lost() from error
            self._counted_s = time.monotonic()
        return self._threads

    def submit(self, batch: Sequence[Job]) -> int:
        """Send a batch to the scheduler."""
        ticket = next(self._tickets)
        self._out[ticket] = (self._client.submit(run_batch, self._order, batch, pure=False), batch)
        self._await(ticket)
        return ticket

    def finished(self, timeout_s: float) -> list[tuple[int, Report]]:
        """Return what has come back."""
        reports = []
        for ticket in drained(self._outbox, timeout_s):
            report = self._report(*self._out[ticket])
            if report is None:
                self._await(ticket)
            else:
                del self._out[ticket]
                reports.append((ticket, report))
        return reports

    def close(self) -> None:
        """Withdraw what is still out, and leave the scheduler."""
        self._out.clear()
        self._client.close()

    def _await(self, ticket: int) -> None:
        self._out[ticket][0].add_done_callback(lambda _: self._outbox.put(ticket))

    def _report(self, future: Any, batch: Sequence[Job]) -> Report | None:
        """Fetch what came of a batch; None when its worker died with the result, which is then computed again."""
        try:
            report: Report = future.result(timeout=GATHER_S)
        except TimeoutError:
            return None
        except self._dask.CancelledError as error:
            raise self._lost() from error
        except self._dask.KilledWorker as error:
            which = "it" if len(batch) == 1 else f"one of the {len(batch)} tasks from it on"
            ended = f"{which} ended every worker that tried it, {error.allowed_failures + 1} in all"
            return Report(failure=Failure(batch[0].index, ended, "look into the log of a worker", str(error)))
        except Exception as error:  # before our code ran: it cannot be imported, or takes other arguments
            message = f"{self._scheduler} cannot run this ({type(error).__name__}: {error})"
            remedy = "install this version of haptic-rig for scheduler and workers, and restart them"
            return Report(failure=Failure(None, message, remedy))
        return report

    def _connect(self) -> Any:
        try:
            return self._dask.Client(
                self._scheduler, timeout=CONNECT_S, set_as_default=False, name="haptic-rig"
            )
        except (OSError, ValueError, TypeError) as error:  # TimeoutError is an OSError
            raise ConfigError(
                f"no Dask scheduler answers at {self._scheduler} ({type(error).__name__}: {error})",
                remedy="start one with `dask scheduler` and name its address, like tcp://10.0.0.5:8786",
            ) from error

    def _lost(self) -> RigError:
        return RigError(f"the Dask scheduler at {self._scheduler} is gone", remedy="start it again")


def _distributed() -> Any:
    try:
        return import_module("distributed")
    except ImportError as error:
        raise ConfigError(
            "a Dask cluster needs the package distributed, which is not here",
            remedy="install it: pip install 'haptic-rig[cluster]'",
        ) from error
