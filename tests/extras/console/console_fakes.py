"""A page that stores its messages, and errands that run in this process."""

import asyncio
import json
import struct
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.errors import RigError
from rig.core.present import plain
from rig.extras.console.errand_worker import ERRANDS
from rig.extras.console.errands import Errands
from rig.extras.console.jobs import Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.requests import request_of
from rig.extras.console.service import LATER, Service, ServiceContext

# Of the job that runs a session: a participant in simulation.
CONTENT: dict[str, Any] = {
    "protocol": "mine.toml", "code": "P01", "directory": "", "study": "", "digest": None, "row": None, "person": None,
    "realtime": False, "again": False, "at": "trial", "other_device": False, "other_protocol": False, "url": "",
    "verified": False, "arm_anyway": False, "lossy_anyway": False, "lsl": False, "hand": "", "hand_kind": None,
}  # fmt: skip


class Page:
    """A fake of `rig.extras.console.client.Client`."""

    def __init__(self, name: str = "a page of 8") -> None:
        self.name = name
        self.messages: list[dict[str, Any]] = []
        self.answers: dict[int, Any] = {}

    def put(self, message: str) -> None:
        self.messages.append(json.loads(message))

    def put_newest(self, message: dict[str, Any]) -> None:
        self.messages.append(message)

    def compiles(self, busy: bool) -> None:
        pass

    def reply(self, number: int, result: Any = None, error: RigError | None = None) -> None:
        self.answers[number] = plain(result) if error is None else error


class Here(Errands):
    async def run(self, errand: str, *, compiling: Any = None, **content: Any) -> tuple[Any, bytes]:
        result = ERRANDS[errand](**json.loads(json.dumps(content)))
        return result if isinstance(result, tuple) else (result, b"")


def shared(output: Path, errands: Errands | None = None) -> ServiceContext:
    return ServiceContext(set(), Lease(), Jobs(lambda job, message: None), output, errands or Here())


async def ask(service: Service, page: Any, do: str, **content: Any) -> Any:
    """Send a message to a service as the socket would; return its reply or raise its error."""
    handlers = service.handlers()
    number = len(page.answers) + 1
    text = json.dumps({"do": do, "number": number, **content})
    request = request_of(text, {name: kind for name, (kind, _) in handlers.items()})
    result = await handlers[do][1](page, request)
    if result is not LATER:
        return result
    async with asyncio.timeout(60.0):
        while number not in page.answers:
            await asyncio.sleep(0.001)
    answer = page.answers[number]
    if isinstance(answer, RigError):
        raise answer
    return answer


def frame_of(data: bytes) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], Any]:
    """Return header, minima and maxima by column, and times, decoded as the page does."""
    (length,) = struct.unpack_from("<I", data)
    assert (4 + length) % 8 == 0, "a browser reads float64 at multiples of 8"
    header = json.loads(data[4 : 4 + length])
    arrays = 1 + len(header["columns"]) * (1 if header["step"] == 1 else 2)
    numbers = np.frombuffer(data, "<f8", offset=4 + length).reshape(arrays, header["points"])
    low = dict(zip(header["columns"], numbers[1:], strict=False))
    high = dict(zip(header["columns"], numbers[1 + len(low) :], strict=False)) or low
    return header, low, high, numbers[0]


def run(body: Callable[[], Coroutine[Any, Any, Any]]) -> Any:
    return asyncio.run(body())
