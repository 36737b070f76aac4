"""The server of the page: it accepts sockets and downloads, and starts the services that handle their requests.

It runs in a process of its own, because it would delay the ticks of a control loop. A page opens two sockets: ``/live``
for everything, and ``/hold`` for heartbeats and STOP alone, which therefore never wait for other messages. A
participant's screen opens ``/participant`` instead of ``/live``; it can send only the requests of `PARTICIPANTS`.
"""

import asyncio
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import asdict, dataclass, field
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path, PurePath
from socket import create_server
from typing import Any

from rig.config import presets
from rig.control import estimators
from rig.control.estimators import Choice, Setting
from rig.core.errors import ConfigError, RigError
from rig.core.sample import COLUMNS, UNITS, unit_of
from rig.core.scratch import scratch
from rig.extras.console import requests as asked
from rig.extras.console.access import HEADERS, SOCKETS, SUBPROTOCOL, Access
from rig.extras.console.bounds import MOST_A_SECOND, Allowance, Places, door, let_in
from rig.extras.console.client import Client, defect
from rig.extras.console.devices import Devices
from rig.extras.console.jobs import Job, Jobs
from rig.extras.console.lease import Lease
from rig.extras.console.live import Live
from rig.extras.console.maps import MapService
from rig.extras.console.recordings import Recordings
from rig.extras.console.runs import Runs
from rig.extras.console.service import LATER, Download, Service, ServiceContext
from rig.extras.console.sessions import PARTICIPANTS, Sessions
from rig.extras.console.sockets import (
    LOGGER,
    ConnectionClosed,
    Headers,
    HttpRequest,
    Response,
    ServerConnection,
    Subprotocol,
    serve,
)
from rig.extras.console.terminal import Terminal
from rig.realtime.hand import SharedHand

MOST_CLIENTS = 16  # pages, and as many participants' screens
# Accept one connection at a time, then serve open sockets: a flood of connections must not delay a STOP.
MOST_AT_ONCE = 1
MOST_WAITING = 128  # connections that the operating system queues meanwhile
# A worker that reconnects leaves its old socket open until a ping fails, hence more sockets than pages.
MOST_HOLDS = 4 * MOST_CLIENTS
POLICY_VIOLATION, TRY_AGAIN_LATER = 1008, 1013  # close codes of RFC 6455 and its registry
CLOSE_S = 1.0  # for a page to confirm that its socket is closed
# websockets counts a download as part of the handshake, and its content may have to be computed first.
DOWNLOAD_S = 600.0
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
UTF8 = "; charset=utf-8"


@dataclass(frozen=True, kw_only=True, slots=True)
class ConsoleSettings:
    """Settings of a console's server.

    Attributes
    ----------
    port, hosts
        Port on loopback (this computer only), 0: any free port; further names NAME:PORT by which a browser may reach
        it.
    output
        Directory of the recordings.
    verified
        True if the operator has checked the polarity of encoder and motor, with the handle at position zero.
    own, announce
        Show only runs that this console started; function that receives the URL once the server accepts connections.
    """

    port: int = 0
    hosts: Sequence[str] = ()
    output: Path = Path("recordings")
    verified: bool = False
    own: bool = False
    announce: Callable[[str], None] = field(default=lambda url: None)


class Console:
    """Services that handle the requests to a running server (one for each view of the page), and shared state."""

    def __init__(self, settings: ConsoleSettings, hand: SharedHand, terminal: Terminal) -> None:
        self._shared = ServiceContext(set(), Lease(), Jobs(self._handle_job_message), settings.output)
        self.live = Live(self._shared, hand, terminal, own=settings.own)
        self.runs = Runs(self._shared, self.live, hand, terminal, verified=settings.verified)
        self._sessions = Sessions(self._shared, hand, terminal, verified=settings.verified)
        self.services: tuple[Service, ...] = (
            self.live,
            self.runs,
            self._sessions,
            MapService(self._shared),
            Recordings(self._shared),
            Devices(self._shared),
        )
        self._handlers = {do: found for service in self.services for do, found in service.handlers().items()}
        self._kinds = {do: kind for do, (kind, _) in self._handlers.items()}
        self._participants_kinds = {do: self._kinds[do] for do in PARTICIPANTS}
        self._holds = Places[ServerConnection](MOST_HOLDS, lambda socket: socket.transport.abort())

    access: Access

    async def attend(self, socket: ServerConnection) -> None:
        """Serve one socket of a page until it closes."""
        assert socket.request is not None
        path = socket.request.path.partition("?")[0]
        with suppress(ConnectionClosed):
            name = self.access.guest(socket.request)
            if name is None:
                await socket.close(POLICY_VIOLATION, "the token is missing or wrong")
                return
            if path == "/hold":
                await self._hold(socket, name)
            else:
                await self._live(socket, Client(socket, name, participant=path == "/participant"))

    async def _hold(self, socket: ServerConnection, name: str) -> None:
        allowance = Allowance()
        try:
            self._holds.hear(socket)
            async for text in socket:
                self._holds.hear(socket)
                # A STOP is carried out even if the socket exceeds its rate limit.
                if asked.json_of(text).get("stop") is True:
                    self.live.stop_all()
                    await socket.send(json.dumps({"stopped": time.monotonic()}))
                else:
                    self._shared.lease.beat(name)
                if not allowance.take():
                    await socket.close(POLICY_VIOLATION, f"more than {MOST_A_SECOND:g} messages a second")
        finally:
            self._holds.leave(socket)

    async def _live(self, socket: ServerConnection, client: Client) -> None:
        pages = self._shared.participants if client.participant else self._shared.clients
        if len(pages) >= MOST_CLIENTS:
            await socket.close(
                TRY_AGAIN_LATER, f"{MOST_CLIENTS} pages are open, the most that are allowed; close one"
            )
            return
        pages.add(client)
        self._greet(client)
        sender = asyncio.create_task(client.send())
        try:
            async for text in socket:
                if not client.allowance.take():
                    await socket.close(POLICY_VIOLATION, f"more than {MOST_A_SECOND:g} messages a second")
                    return
                await self._answer(client, text)
        finally:
            pages.discard(client)
            sender.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sender

    def _greet(self, client: Client) -> None:
        if client.participant:
            self._sessions.greet(client)
            return
        client.put(json.dumps({"say": "hello", "participants": self.access.participants, **_facts()}))
        for service in self.services:
            service.greet(client)

    async def _answer(self, client: Client, text: str | bytes) -> None:
        number = asked.number_of(text)
        try:
            request = asked.request_of(text, self._participants_kinds if client.participant else self._kinds)
            result = await self._handlers[request.do][1](client, request)
        except RigError as error:
            client.reply(number, error=error)
        except Exception as error:
            # A bug in a handler fails this request only; the socket stays open.
            client.reply(number, error=defect(str(asked.json_of(text).get("do")), error))
        else:
            if number and result is not LATER:
                client.reply(number, result)

    def _handle_job_message(self, job: Job, message: Mapping[str, Any]) -> None:
        kept = [service.handle_job_message(job, message) for service in self.services]
        if any(kept):
            return
        envelope = {"say": "job", "job": job.name, "pid": job.pid, "told": message}
        for client in self._shared.clients:
            if message["say"] == "progress":
                client.put_newest({**envelope, "say": "progress"})
            else:
                client.put(json.dumps(envelope))

    async def download(self, path: str) -> Download | None:
        """Return the file for the path of a URL, from the first service that has one; None if no service has."""
        for service in self.services:
            if (found := await service.download(path)) is not None:
                return found
        return None

    async def close(self) -> None:
        """End the running job, and cancel the tasks of all services."""
        await self._shared.jobs.close()
        for service in self.services:
            await service.close()
        await self._shared.errands.close()


def _facts() -> dict[str, Any]:
    return {
        "columns": [
            {
                "name": column.name,
                "meaning": column.description,
                "unit": {motion: unit_of(column.unit, motion) for motion in ("rotary", "linear")},
            }
            for column in COLUMNS
        ],
        "units": {name: UNITS[name] for name in ("stiffness", "damping", "position")},
        "rigs": list(presets.names()),
        "estimators": [_estimator(name) for name in estimators.names()],
    }


def _estimator(name: str) -> dict[str, Any]:
    if problem := estimators.broken(name):
        return {"name": name, "settings": [], "problem": problem}
    settings = estimators.get(name).settings
    return {"name": name, "settings": [_setting(one) for one in settings], "problem": ""}


def _setting(setting: Setting | Choice) -> dict[str, Any]:
    whole = isinstance(setting, Setting) and isinstance(setting.default, int)
    return {**asdict(setting), "whole": whole}


async def run(settings: ConsoleSettings, terminal: Terminal, ended: asyncio.Event) -> None:
    """Serve the page until the event `ended` is set.

    Raise `ConfigError` if the port is in use, `RigError` for a bug of the server, after it has ended all runs.
    """
    static = _page()
    async with AsyncExitStack() as stack:
        place = stack.enter_context(scratch("console"))
        hand = stack.enter_context(SharedHand.create(place / "hand"))
        console = Console(settings, hand, terminal)

        async def respond(socket: ServerConnection, request: HttpRequest) -> Response | None:
            return await _respond(console, static, socket, request)

        try:
            listening = stack.enter_context(create_server(("127.0.0.1", settings.port)))
        except OSError as error:
            raise ConfigError(
                f"cannot listen on port {settings.port}: {error.strerror}",
                remedy="give another port, or omit it for any free one",
            ) from error
        served = serve(
            console.attend,
            sock=listening,
            backlog=MOST_AT_ONCE,
            process_request=respond,
            max_size=asked.MOST_BYTES,
            compression=None,
            logger=LOGGER,
            subprotocols=[Subprotocol(SUBPROTOCOL)],
            server_header=None,
            # For connections with a valid token; `bounds.Knocking` aborts all others earlier.
            open_timeout=DOWNLOAD_S,
            close_timeout=CLOSE_S,
            ping_interval=5.0,
            ping_timeout=10.0,
            max_queue=64,
            create_connection=door(),
        )
        await stack.enter_async_context(served)
        # asyncio uses `backlog` as accepts per turn and as queue length: set the queue length again.
        listening.listen(MOST_WAITING)
        # Runs before the server waits for its sockets to close, so that moving rigs stop first.
        stack.push_async_callback(console.close)
        console.access = Access(listening.getsockname()[1], settings.hosts)
        settings.announce(console.access.url)
        tasks = [
            asyncio.create_task(task())
            for task in (console.live.every_frame, console.live.every_search, console.runs.every_beat)
        ]
        done, _ = await asyncio.wait(
            [*tasks, asyncio.create_task(ended.wait())], return_when=asyncio.FIRST_COMPLETED
        )
        for task in tasks:
            task.cancel()
        for one in done:
            if (failed := one.exception()) is not None:
                raise defect(
                    "the console could no longer supervise its runs, and has ended them", failed
                ) from failed


def _page() -> dict[str, tuple[str, bytes]]:
    place = files("rig.extras.console") / "page"
    found = {
        f"/{one.name}": (TYPES[PurePath(one.name).suffix] + UTF8, one.read_bytes())
        for one in place.iterdir()
        if PurePath(one.name).suffix in TYPES
    }
    return {**found, "/": found["/index.html"]}


async def _respond(
    console: Console, static: Mapping[str, tuple[str, bytes]], socket: ServerConnection, request: HttpRequest
) -> Response | None:
    access, headers = console.access, request.headers
    if not access.host_allowed(headers):
        return _response(
            HTTPStatus.MISDIRECTED_REQUEST,
            "this host name is not allowed; open the printed URL, or start rig console --allow-host NAME:PORT",
        )
    path = request.path.partition("?")[0]
    if path in SOCKETS:
        if not access.origin_allowed(headers):
            return _response(HTTPStatus.FORBIDDEN, "sockets are only accepted from pages of this server")
        if access.guest(request) is not None:
            let_in(socket)
        # Open the socket even without a valid token, then close it with a reason: a browser hides why opening failed.
        return None
    found = Download(*static[path]) if path in static else None
    if found is None and access.bearer_right(headers):
        let_in(socket)
        try:
            found = await console.download(request.path)
        except RigError as error:
            return _response(HTTPStatus.BAD_REQUEST, str(error))
    if found is None:
        return _response(HTTPStatus.NOT_FOUND, "no such page or file")
    return _response(HTTPStatus.OK, found.body, found.kind)


def _response(status: HTTPStatus, body: str | bytes, kind: str = "text/plain" + UTF8) -> Response:
    data = body.encode() if isinstance(body, str) else body
    headers = Headers(
        {**HEADERS, "Content-Type": kind, "Content-Length": str(len(data)), "Connection": "close"}
    )
    return Response(status.value, status.phrase, headers, data)
