"""What a view of the page needs of the server: requests that it answers, and files that it gives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.console.client import Client
from rig.console.jobs import Job, Jobs
from rig.console.lease import Lease
from rig.console.requests import Request
from rig.core.errors import ConfigError

Handler = Callable[[Client, Any], Awaitable[Any]]


@dataclass(frozen=True, slots=True)
class Download:
    """A file for a page that shows the token."""

    kind: str
    body: bytes


@dataclass(slots=True)
class Shared:
    """What all services have in common.

    Attributes
    ----------
    clients
        The pages that are open.
    lease, jobs
        Who operates, and what they have started.
    output
        Directory of the recordings.
    blinded
        Whether whoever sits here must not know the wall of the run that goes on: its loop is looked at by nobody.
    """

    clients: set[Client]
    lease: Lease
    jobs: Jobs
    output: Path
    blinded: bool = False

    def must_operate(self, client: Client) -> None:
        """Refuse whoever only looks on; whoever asks while nobody operates does from now on."""
        if not self.lease.take(client.name):
            raise ConfigError("another page operates", remedy="let it release first, or close it")


class Service(ABC):
    """The server's side of a view."""

    @abstractmethod
    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return by `do` the kind of a request and what answers it; it raises `RigError` for what cannot be done."""

    def greet(self, client: Client) -> None:  # noqa: B027  (most have nothing to say)
        """A page has come."""

    def job_says(self, job: Job, message: Mapping[str, Any]) -> bool:
        """A job has said something; whether it was said to this service alone, and not to the pages."""
        return False

    async def download(self, path: str) -> Download | None:
        """Return the file of a path, or None where it is not of this service."""
        return None

    async def close(self) -> None:  # noqa: B027
        """End what goes on."""
