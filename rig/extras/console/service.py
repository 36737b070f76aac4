"""What a view of the page needs of the server: requests that it answers, and files that it gives."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.extras.console.client import Client, defect, trouble
from rig.extras.console.errands import Errands
from rig.extras.console.jobs import Job, Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.requests import Request

Handler = Callable[[Client, Any], Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class Download:
    """A file for a page that shows the token."""

    kind: str
    body: bytes


@dataclass(slots=True)
class ServiceContext:
    """What all services have in common.

    Attributes
    ----------
    clients
        The pages that are open.
    participants
        The participants' screens that are open.
    lease, jobs
        Who operates, and what they have started.
    output
        Directory of the recordings.
    errands
        What is read, drawn and computed elsewhere.
    blinded
        Whether the operator must not know the wall of the current run: no page then shows its loop.
    """

    clients: set[Client]
    lease: Lease
    jobs: Jobs
    output: Path
    errands: Errands = field(default_factory=Errands)
    participants: set[Client] = field(default_factory=set)
    blinded: bool = False

    def must_operate(self, client: Client) -> None:
        """Raise `ConfigError` if another page operates; make `client` the operator if none does."""
        if not self.lease.take(client.name):
            raise ConfigError("another page operates the rig", remedy="close that page first")

    async def save_cut(self, path: Path, first_s: float, last_s: float, zero_ns: int | None = None) -> Any:
        """Have a stretch of a recording saved beside the others (`rig.extras.console.recording_errands.save_cut`)."""
        saved, _ = await self.errands.run(
            "save cut",
            path=str(path),
            first_s=first_s,
            last_s=last_s,
            output=str(self.output),
            zero_ns=zero_ns,
        )
        return saved

    def report_trouble(self, error: RigError) -> None:
        """Tell every page what went wrong, where none has asked."""
        for client in self.clients:
            client.put(trouble(error))


LATER = object()  # what a handler returns that will answer by itself


class Service(ABC):
    """The server's side of a view."""

    @cached_property
    def _working(self) -> set[asyncio.Task[None]]:
        return set()

    def answer_later(self, client: Client, request: Request, work: Coroutine[Any, Any, Any]) -> object:
        """Answer a request when some work is done, and meanwhile take the page's next ones; return `LATER`."""

        async def answered() -> None:
            try:
                client.reply(request.number, await work)
            except RigError as error:
                client.reply(request.number, error=error)
            except Exception as error:
                client.reply(request.number, error=defect(request.do, error))

        self.run_beside(answered())
        return LATER

    def run_beside(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Do something beside; it ends with the service at the latest."""
        task = asyncio.create_task(work)
        self._working.add(task)
        task.add_done_callback(self._working.discard)
        return task

    @abstractmethod
    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return by `do` the kind of a request and what answers it; it raises `RigError` for what cannot be done."""

    def greet(self, client: Client) -> None:  # noqa: B027  (most have nothing to say)
        """Send a newly connected page what it must know."""

    def handle_job_message(self, job: Job, message: Mapping[str, Any]) -> bool:
        """Take a message of a job; return True if it is for this service alone, and not for the pages."""
        return False

    async def download(self, path: str) -> Download | None:
        """Return the file of a path, or None where it is not of this service."""
        return None

    async def close(self) -> None:
        """Cancel the tasks that still run, and wait for their end."""
        for task in self._working:
            task.cancel()
        await asyncio.gather(*self._working, return_exceptions=True)
