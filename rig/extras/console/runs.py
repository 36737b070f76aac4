"""Runs that a page starts, changes of the followed loop's wall, the dragged handle, and the right to operate.

A run ends when no page operates the rig any more, unless it was started as detached.
"""

import asyncio
from collections.abc import Mapping
from typing import Any

from rig import config
from rig.core.errors import ConfigError
from rig.experiments.trials import live
from rig.extras.console import consent
from rig.extras.console import requests as asked
from rig.extras.console.client import Client
from rig.extras.console.jobs import Job
from rig.extras.console.lease import LOOK_S
from rig.extras.console.live import Live
from rig.extras.console.service import Handler, Service, ServiceContext
from rig.extras.console.terminal import Terminal
from rig.realtime.hand import SharedHand

PLAY = "play"  # the job whose hand is dragged


class Runs(Service):
    """Service that starts runs, or changes the wall of the control loop that `live` follows, as a page requests.

    `verified` is True if the operator has checked the polarity of encoder and motor, with the handle at position zero.
    """

    def __init__(
        self, shared: ServiceContext, live: Live, hand: SharedHand, terminal: Terminal, *, verified: bool
    ) -> None:
        self._shared, self._live, self._hand, self._terminal = shared, live, hand, terminal
        self._verified = verified
        self._regions = asyncio.Lock()

    def handlers(self) -> Mapping[str, tuple[type[asked.Request], Handler]]:
        """Return request class and handler of each request about runs, by the request's name."""
        return {
            "operate": (asked.Operate, self._operate),
            "run": (asked.Run, self._run),
            "set": (asked.Set, self._set),
            "hand": (asked.Hand, self._move),
            "regions": (asked.AskRegions, self._ask_regions),
            "experiment": (asked.AskExperiment, self._ask_experiment),
        }

    async def _operate(self, client: Client, request: asked.Operate) -> dict[str, Any]:
        if request.take:
            self._shared.lease.take(client.name)
        else:
            self._shared.lease.release(client.name)
        return {"operates": self._shared.lease.held().by == client.name}

    async def _run(self, client: Client, request: asked.Run) -> object:
        self._shared.must_operate(client)
        asked.refuse_reserved(request.changes)
        if not request.url.startswith("sim:"):
            return self.answer_later(client, request, self._run_agreed(client, request))
        return await self._start(request)

    async def _run_agreed(self, client: Client, request: asked.Run) -> dict[str, Any]:
        found = await self._described(request.rig, request.changes)
        digest = str(found["digest"])
        lines = consent.describe_run(
            request, config.experiment_from_mapping(found["experiment"], request.rig), digest
        )
        await consent.insist(self._terminal, client, request.url, lines)
        self._shared.must_operate(client)  # still: a person takes their time
        return await self._start(request, digest)

    async def _start(self, request: asked.Run, digest: str | None = None) -> dict[str, Any]:
        content: dict[str, Any] = {
            "rig": request.rig,
            "url": request.url,
            "changes": request.changes,
            "output": str(self._shared.output),
            "duration_s": request.duration_s,
            "hand": str(self._hand.path),
            "verified": self._verified,
            "digest": digest,
        }
        is_detached = request.is_detached and request.job != PLAY
        job = await self._shared.jobs.start(request.job, content, is_detached=is_detached)
        self._live.look_at_newest()
        return {"pid": job.pid}

    async def _set(self, client: Client, request: asked.Set) -> Any:
        self._shared.must_operate(client)
        followed = self._live.looked_at()
        return await asyncio.to_thread(live.change_wall, request.changes, followed.pid, patience_s=0.0)

    async def _move(self, client: Client, request: asked.Hand) -> None:
        self._shared.must_operate(client)
        job = self._shared.jobs.running
        if job is None or job.name != PLAY:  # a session moves the same hand from its own desk
            raise ConfigError(
                "no run with a dragged handle is running", remedy="start “Drag the handle” first"
            )
        self._hand.move(request.position, request.press)

    async def _ask_regions(self, client: Client, request: asked.AskRegions) -> object:
        async def found() -> Any:
            content = {name: getattr(request, name) for name in ("rig", "changes", "damping", "delay_ticks")}
            async with self._regions:  # one after the other: pages ask while a slider moves
                result, _ = await self._shared.errands.run("regions", compiling=client.compiles, **content)
            return result

        asked.refuse_reserved(request.changes)
        return self.answer_later(client, request, found())

    async def _ask_experiment(self, client: Client, request: asked.AskExperiment) -> object:
        async def found() -> Any:
            return (await self._described(request.rig, request.changes))["experiment"]

        return self.answer_later(client, request, found())

    async def _described(self, name: str, changes: Mapping[str, Any]) -> Any:
        asked.refuse_reserved(changes)
        found, _ = await self._shared.errands.run("experiment", rig=name, changes=dict(changes))
        return found

    async def every_beat(self) -> None:
        """End the running job when no page operates: its operator has left, or has given back the right to operate."""
        ending: Job | None = None  # job that received the request to end
        try:
            while True:
                ending = self._beat(ending)
                await asyncio.sleep(LOOK_S)
        except Exception:
            # No other task would end the job later: end it, even a detached one, and then the console.
            self._shared.jobs.end()
            raise

    def _beat(self, ending: Job | None) -> Job | None:
        self._shared.jobs.beat()
        self._shared.lease.expire()
        if self._shared.lease.held().by is not None:
            return None
        self._terminal.withdraw()
        job = self._shared.jobs.running
        if job is not None and job is not ending and not job.is_detached:
            job.end()
            return job
        return ending
