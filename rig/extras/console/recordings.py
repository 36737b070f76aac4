"""Handle a page's requests about recordings: list and search, show, replay, export; no recording is deleted.

Downloads require the token: ``/recordings/NAME/cut``, ``picture`` and ``export``. For a recording of a device's map the
request also contains the name of the map; such a recording cannot be moved to the trash.
"""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import parse_qs, unquote

from annotated_types import Ge, Le

from rig.control import estimators
from rig.core.errors import ConfigError
from rig.experiments.mapping.interface import RECORDINGS
from rig.extras.console.client import Client
from rig.extras.console.maps import MAPS
from rig.extras.console.place import directory_in, file_in
from rig.extras.console.recording_errands import SUFFIXES
from rig.extras.console.requests import Name, Request
from rig.extras.console.service import Download, Handler, Service, ServiceContext
from rig.extras.console.trash import restore, throw_away
from rig.realtime.running import running

TRASH = "trash"  # directory inside that of the recordings


@dataclass(frozen=True, kw_only=True, slots=True)
class AskRecordings(Request):
    """Request recordings (or those in the trash) that match every word of `search`, newest first, from `first` on."""

    search: Name = ""
    first: Annotated[int, Ge(0), Le(2**31)] = 0
    trash: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class AskRecording(Request):
    """Request what a scope needs to draw one recording, and the estimators with which it can be replayed."""

    name: Name
    map: Name = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class CutRecording(Request):
    """Request that a time span of a recording (s since the first row) is saved as a new recording."""

    name: Name
    map: Name = ""
    first_s: float
    last_s: float


@dataclass(frozen=True, kw_only=True, slots=True)
class ThrowAway(Request):
    """Request that a recording and its pictures are moved to the trash."""

    name: Name


@dataclass(frozen=True, kw_only=True, slots=True)
class Restore(Request):
    """Request that a recording and its pictures are moved back from the trash."""

    name: Name


class Recordings(Service):
    """Service that handles a page's requests about recordings."""

    def __init__(self, shared: ServiceContext) -> None:
        self._shared = shared

    def handlers(self) -> Mapping[str, tuple[type[Request], Handler]]:
        """Return request class and handler of each request about recordings, by the request's name."""
        return {
            "recordings": (AskRecordings, self._list),
            "recording": (AskRecording, self._describe),
            "recording-cut": (CutRecording, self._cut),
            "throw-away": (ThrowAway, self._throw_away),
            "restore": (Restore, self._restore),
        }

    async def _list(self, client: Client, request: AskRecordings) -> object:
        directory = self._shared.output / TRASH if request.trash else self._shared.output

        async def listed() -> Any:
            found, _ = await self._shared.errands.run(
                "recordings", directory=str(directory), search=request.search, first=request.first
            )
            return {**found, "directory": str(directory)}

        return self.answer_later(client, request, listed())

    async def _describe(self, client: Client, request: AskRecording) -> object:
        path = self._file(request.name, request.map)

        async def described() -> Any:
            found, _ = await self._shared.errands.run("recording", path=str(path))
            return {**found, "map": request.map, "estimators": estimators.names()}

        return self.answer_later(client, request, described())

    async def _cut(self, client: Client, request: CutRecording) -> object:
        self._shared.must_operate(client)
        path = self._file(request.name, request.map)
        cut = self._shared.save_cut(path, request.first_s, request.last_s)
        return self.answer_later(client, request, cut)

    async def _throw_away(self, client: Client, request: ThrowAway) -> None:
        self._shared.must_operate(client)
        path = self._file(request.name)
        loops = await asyncio.to_thread(running, done=True)
        if any(loop.info.get("recording") == str(path.resolve()) for loop in loops):
            raise ConfigError(f"{request.name} is still being recorded", remedy="stop that run first")
        throw_away(path, self._shared.output / TRASH)

    async def _restore(self, client: Client, request: Restore) -> None:
        self._shared.must_operate(client)
        restore(_recording_in(self._shared.output / TRASH, request.name), self._shared.output)

    async def download(self, path: str) -> Download | None:
        """Return samples, picture or export of a recording for a path below ``/recordings``; None for another path."""
        parts, _, query = path.partition("?")
        match [unquote(part) for part in parts.split("/")]:
            case ["", "recordings", name, what]:
                asked = {key: values[0] for key, values in parse_qs(query).items()}
                found = self._file(name, asked.pop("map", ""))
                return await self._download(found, what, asked)
        return None

    async def _download(self, path: Path, what: str, asked: Mapping[str, str]) -> Download | None:
        run = self._shared.errands.run
        match what:
            case "cut":
                try:
                    first_s, last_s = float(asked["first"]), float(asked["last"])
                except (KeyError, ValueError):
                    raise ConfigError(
                        "the request has no valid time span", remedy="give first and last as times in s"
                    ) from None
                changes = {"controller.estimator": asked["estimator"]} if "estimator" in asked else None
                columns = asked.get("columns", "position").split(",")
                _, data = await run(
                    "cut", path=str(path), columns=columns, first_s=first_s, last_s=last_s, changes=changes
                )
                return Download("application/octet-stream", data)
            case "picture":
                return Download(*await run("picture", path=str(path), draw="draw" in asked))
            case "export":
                return Download(*await run("export", path=str(path), form=asked.get("form", "")))
        return None

    def _file(self, name: str, of_map: str = "") -> Path:
        if not of_map:
            return _recording_in(self._shared.output, name)
        return _recording_in(directory_in(self._shared.output.parent / MAPS, of_map) / RECORDINGS, name)


def _recording_in(directory: Path, name: str) -> Path:
    path = file_in(directory, name)
    if path.suffix not in SUFFIXES:
        raise ConfigError(
            f"{name!r} is not a recording", remedy=f"choose a file with {' or '.join(SUFFIXES)}"
        )
    return path
