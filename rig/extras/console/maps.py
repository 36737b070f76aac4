"""Handle a page's requests about maps (which walls are stable or passive): show maps of any program, and update them.

A map that a page starts is a job like others (`rig.extras.console.map_jobs`), whose results are also read from the
directory. This module never moves a rig: a map on a device is started by its command, where a person confirms each hit.
"""

import asyncio
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from rig.core.errors import ConfigError, RigError
from rig.experiments.mapping.interface import MapRequest
from rig.extras.console.client import Client, defect, trouble
from rig.extras.console.place import directory_in
from rig.extras.console.requests import Changes, Name, Request, refuse_reserved
from rig.extras.console.service import Handler, Service, ServiceContext

MAPS = "maps"  # beside the directory of the recordings, as the command has it
POLL_S = 0.5
JOB = "map"


@dataclass(frozen=True, kw_only=True, slots=True)
class AskMaps(Request):
    """Request the list of maps (which walls are stable or passive)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RunMap(Request, MapRequest):
    """Request to measure which walls of a simulated rig are stable or passive."""

    domain: Literal["time", "frequency"] = "time"
    rig: Name = "koul-compliant"
    changes: Changes = field(default_factory=dict)
    ratio: Annotated[float, Ge(1.0001), Le(1e6)] = 1.06
    is_detached: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class EndMap(Request):
    """Request the end of the running map of stable walls; finished results stay, and a repeated request continues."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WatchMap(Request):
    """Request a map of stable walls and updates while it is being measured; an empty name ends the updates."""

    map: Name


@dataclass(frozen=True, kw_only=True, slots=True)
class AskTheory(Request):
    """Request the stiffness limits of linear theory for the sampling schemes of a map."""

    map: Name


@dataclass(frozen=True, kw_only=True, slots=True)
class AskHit(Request):
    """Request the recording of one wall hit of a map, by its stiffness (N/m or N·m/rad) and its stiffness search.

    `key` is the search, as scheme/damping/encoder offset/repeat.
    """

    map: Name
    key: Name
    stiffness: float


@dataclass(slots=True)
class Watched:
    """A map (which walls are stable or passive) that at least one page shows.

    A *column* has the results of all stiffnesses at one damping, for one scheme, encoder offset and repeat.

    Attributes
    ----------
    facts, columns
        Axes and sampling schemes of the map, and the columns read so far from its journal (the file of results).
    place
        Byte offset in the journal at which the next line will begin.
    begun_s, begun_weight
        Time of the first column (s, monotonic), and the computing cost of all columns until then: the remaining time is
        extrapolated from later work only, without compilation.
    """

    path: Path
    facts: dict[str, Any]
    clients: set[Client]
    columns: list[dict[str, Any]] = field(default_factory=list)
    place: int = 0
    state: str = ""
    begun_s: float | None = None
    begun_weight: float = 0.0

    @property
    def total(self) -> int:
        """Number of columns (one damping, scheme, encoder offset and repeat each) of the complete map."""
        return len(self.facts["schemes"]) * len(self.facts["dampings"]) * len(self.facts["stripes"])

    def take(self, grown: Mapping[str, Any], now_s: float) -> None:
        """Append new results of the map; `grown` has the columns read, the journal's next offset and the state."""
        self.columns += grown["columns"]
        self.place = grown["place"]
        self.state = "finished" if len(self.columns) >= self.total else grown["state"]
        if self.begun_s is None and self.columns:
            self.begun_s, self.begun_weight = now_s, self._weight()

    def progress_message(self, columns: list[dict[str, Any]], now_s: float, *, anew: bool) -> str:
        """Return a JSON message with results (`columns`) and the map's progress; `anew`: drop older results."""
        return json.dumps(
            {
                "say": "cells",
                "map": self.path.name,
                "anew": anew,
                "columns": columns,
                "state": self.state,
                "done": len(self.columns),
                "total": self.total,
                "left_s": self._left_s(now_s),
            }
        )

    def _weight(self) -> float:
        schemes = self.facts["schemes"]
        return float(sum(schemes[column["scheme"]]["weight"] for column in self.columns))

    def _left_s(self, now_s: float) -> float | None:
        """Return the remaining time (s) at the mean speed so far; None if the map does not run, or is too new."""
        came, each = (
            self._weight() - self.begun_weight,
            len(self.facts["dampings"]) * len(self.facts["stripes"]),
        )
        if self.state != "running" or self.begun_s is None or came <= 0.0:
            return None
        left = each * sum(scheme["weight"] for scheme in self.facts["schemes"]) - self._weight()
        return (now_s - self.begun_s) * float(left) / came


class MapService(Service):
    """Service that handles requests about maps (which walls are stable or passive)."""

    def __init__(self, shared: ServiceContext) -> None:
        self._shared = shared
        self._directory = shared.output.parent / MAPS
        self._watched: dict[str, Watched] = {}

    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return request class and handler of each request about maps of stable walls, by the request's name."""
        return {
            "maps": (AskMaps, self._list),
            "map-run": (RunMap, self._run),
            "map-end": (EndMap, self._end),
            "map-watch": (WatchMap, self._watch),
            "map-theory": (AskTheory, self._theory),
            "map-hit": (AskHit, self._hit),
        }

    async def _list(self, client: Client, request: AskMaps) -> object:
        return self._errand(client, request, "maps", directory=str(self._directory))

    async def _run(self, client: Client, request: RunMap) -> dict[str, Any]:
        self._shared.must_operate(client)
        refuse_reserved(request.changes)
        content = {**asdict(request), "output": str(self._directory)}
        job = await self._shared.jobs.start(JOB, content, is_detached=request.is_detached)
        return {"pid": job.pid}

    async def _end(self, client: Client, request: EndMap) -> None:
        self._shared.must_operate(client)
        job = self._shared.jobs.running
        if job is None or job.name != JOB:
            raise ConfigError(
                "no map started by this console is running", remedy="end other maps where they were started"
            )
        job.end()

    async def _theory(self, client: Client, request: AskTheory) -> object:
        return self._errand(client, request, "map theory", directory=str(self._named(request.map)))

    async def _hit(self, client: Client, request: AskHit) -> object:
        return self._errand(
            client,
            request,
            "map hit",
            directory=str(self._named(request.map)),
            key=request.key,
            stiffness=request.stiffness,
            output=str(self._shared.output),
        )

    async def _watch(self, client: Client, request: WatchMap) -> object:
        for watched in self._watched.values():
            watched.clients.discard(client)
        if not request.map:
            return None
        return self.answer_later(client, request, self._show(client, self._named(request.map)))

    async def _show(self, client: Client, path: Path) -> dict[str, Any]:
        watched = self._watched.get(path.name)
        if watched is not None:
            watched.clients.add(client)
            client.put(watched.progress_message(watched.columns, time.monotonic(), anew=True))
            return watched.facts
        facts, _ = await self._shared.errands.run("map", directory=str(path))
        if path.name in self._watched:
            # Another page requested the same map while this one waited.
            return await self._show(client, path)
        self._watched[path.name] = watched = Watched(path, facts, {client})
        self.run_beside(self._follow(watched))
        return watched.facts

    async def _follow(self, watched: Watched) -> None:
        """Send new results of a map to the pages that show it, until the map is finished or no page shows it."""
        try:
            while watched.state != "finished" and watched.clients:
                anew = not watched.columns
                grown, _ = await self._shared.errands.run(
                    "map growth", directory=str(watched.path), place=watched.place
                )
                now_s = time.monotonic()
                watched.take(grown, now_s)
                for client in watched.clients:
                    client.put(watched.progress_message(grown["columns"], now_s, anew=anew))
                await asyncio.sleep(POLL_S)
                watched.clients &= self._shared.clients
        except Exception as error:
            report = trouble(error if isinstance(error, RigError) else defect("the map", error))
            for client in watched.clients:
                client.put(report)
        finally:
            del self._watched[watched.path.name]

    def _named(self, name: str) -> Path:
        return directory_in(self._directory, name)

    def _errand(self, client: Client, request: Request, errand: str, **content: Any) -> object:
        async def done() -> Any:
            result, _ = await self._shared.errands.run(errand, compiling=client.compiles, **content)
            return result

        return self.answer_later(client, request, done())
