"""Handle a page's requests about devices: connected devices, the quality of a link, the meaning of each fault.

The server uses `Devices`; the job's process calls `doctor`. This file must not move a rig.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Ge, Le

from firmware_protocol.faults import Fault
from rig.core.present import page_items
from rig.doctor.here import here
from rig.experiments.hits.examine import ExaminationRequest, examine
from rig.extras.console.client import Client
from rig.extras.console.hits import experiment_of
from rig.extras.console.requests import Name, Request
from rig.extras.console.service import Handler, Service, ServiceContext
from rig.extras.console.talk import Talk


@dataclass(frozen=True, kw_only=True, slots=True)
class AskDevices(Request):
    """Request the list of connected devices, and of the faults that a device can report."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Examine(Request):
    """Request an examination of this computer and, if `url` is not empty, of the device at `url`; nothing moves."""

    rig: Name = "koul-compliant"
    url: Name = ""
    seconds: Annotated[float, Ge(0.1), Le(60.0)] = 4.0


class Devices(Service):
    """Service that handles a page's requests about devices."""

    def __init__(self, shared: ServiceContext) -> None:
        self._shared = shared

    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return request class and handler of each request about devices, by the request's name."""
        return {"devices": (AskDevices, self._devices), "examine": (Examine, self._examine)}

    async def _devices(self, client: Client, request: AskDevices) -> Any:
        found = await asyncio.to_thread(here)
        faults = [{"name": one.name, "text": one.text, "remedy": one.remedy} for one in Fault if one]
        return {"items": page_items(found.items()), "faults": faults}

    async def _examine(self, client: Client, request: Examine) -> Any:
        self._shared.must_operate(client)
        content = {"rig": request.rig, "url": request.url, "seconds": request.seconds}
        job = await self._shared.jobs.start("doctor", content)
        return {"pid": job.pid}


def doctor(content: Mapping[str, Any], talk: Talk) -> Any:
    """Examine this computer and the device at ``content["url"]``, and report the progress through `talk`.

    Return ``items``, the findings for the page, and ``error``, a text or None.
    """
    url = str(content["url"])
    question = ExaminationRequest(
        experiment=experiment_of(content),
        url=url or None,
        realtime=url.startswith("sim:"),
        seconds=float(content["seconds"]),
    )
    found = examine(question, lambda what, share: talk.progress(stage=what, share=share))
    return {"items": page_items(found.items()), "error": None if found.error is None else str(found.error)}
