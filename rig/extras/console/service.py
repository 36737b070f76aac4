"""Base class of the server's services: each service handles the requests, job messages and downloads of one view.

`devices`, `live`, `maps`, `recordings`, `runs` and `sessions` are services; `server` passes requests to them. A handler
must not block the server's event loop.
"""

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
    """A file to download: its media type and its content."""

    kind: str
    body: bytes


@dataclass(slots=True)
class ServiceContext:
    """State that the services of all views of the page share.

    Attributes
    ----------
    clients, participants
        Open pages of operators, and open participants' screens.
    lease, jobs, errands
        The right to operate the rig; the running job; processes that read, draw and compute for a page.
    output
        Directory of the recordings.
    blinded
        True if the operator must not know the wall of the current run: no page then shows its control loop.
    """

    clients: set[Client]
    lease: Lease
    jobs: Jobs
    output: Path
    errands: Errands = field(default_factory=Errands)
    participants: set[Client] = field(default_factory=set)
    blinded: bool = False

    def must_operate(self, client: Client) -> None:
        """Raise `ConfigError` if another page operates the rig; make `client` the operator if no page does."""
        if not self.lease.take(client.name):
            raise ConfigError("another page operates the rig", remedy="close that page first")

    async def save_cut(self, path: Path, first_s: float, last_s: float, zero_ns: int | None = None) -> Any:
        """Save a time span (s) of a recording as a new recording; return its name and facts.

        The times count from `zero_ns` (ns, device clock; None: from the first row).
        """
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
        """Send an error to every page, outside of any request."""
        for client in self.clients:
            client.put(trouble(error))


LATER = object()  # returned by a handler that sends its reply later


class Service(ABC):
    """Base class of a service: it handles the requests of one view of the page, such as maps or recordings."""

    @cached_property
    def _working(self) -> set[asyncio.Task[None]]:
        return set()

    def answer_later(self, client: Client, request: Request, work: Coroutine[Any, Any, Any]) -> object:
        """Reply to a request when the coroutine `work` is done; return `LATER`, which the handler must return."""

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
        """Run the coroutine `work` as a task, which `close` cancels if it still runs."""
        task = asyncio.create_task(work)
        self._working.add(task)
        task.add_done_callback(self._working.discard)
        return task

    @abstractmethod
    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return request class and handler by the request's name; a handler refuses a request by raising `RigError`."""

    def greet(self, client: Client) -> None:  # noqa: B027  (most have nothing to say)
        """Send a newly connected page its initial messages."""

    def handle_job_message(self, job: Job, message: Mapping[str, Any]) -> bool:
        """Handle a message of a background job (run, session or map); return True if the pages must not receive it."""
        return False

    async def download(self, path: str) -> Download | None:
        """Return the file for the path of a URL, or None if this service does not serve the path."""
        return None

    async def close(self) -> None:
        """Cancel the tasks of this service that still run, and wait for their end."""
        for task in self._working:
            task.cancel()
        await asyncio.gather(*self._working, return_exceptions=True)
