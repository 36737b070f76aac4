"""A console and its pages, without a browser: access, messages, the operating page, and STOP."""

import asyncio
import itertools
import os
import socket
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame
from websockets.server import ServerProtocol

from rig.core.errors import ConfigError, RigError
from rig.core.sample import Phase, RowFlag
from rig.extras.console.access import SOCKETS
from rig.extras.console.bounds import MOST_AT_DOOR, MOST_HEAD_BYTES
from rig.extras.console.client import MOST_REPLIES, Client
from rig.extras.console.errands import Errands
from rig.extras.console.follow import Followed
from rig.extras.console.lease import Lease
from rig.extras.console.live import Live
from rig.realtime import control_words
from rig.realtime.ring import Ring
from tests.conformance.console import Page, Served, served
from tests.conformance.lsl_loop import INFO, HandTurnedLoop
from tests.conformance.tiers import first_by_default
from tests.extras.console.console_fakes import Here

UPGRADE = (
    b"GET /live HTTP/1.1\r\nHost: ADDRESS\r\nOrigin: http://ADDRESS\r\nConnection: Upgrade\r\n"
    b"Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    b"Sec-WebSocket-Protocol: rig, token.wrong\r\n\r\n"
)
Searched = Callable[[int], Awaitable[None]]


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> Searched:
    """A function that waits until the console has searched for loops a number of times, here without pauses."""
    begun, search = 0, Live.search

    async def counted(live: Live) -> None:
        nonlocal begun
        begun += 1
        await search(live)

    async def wait(times: int) -> None:
        enough = begun + times + 1  # the last of them is over when the next one begins
        while begun < enough:
            await asyncio.sleep(0.001)

    monkeypatch.setattr(Live, "search", counted)
    monkeypatch.setattr("rig.extras.console.live.SEARCH_S", 0.001)
    return wait


def status_of(console: Served, path: str = "/", **headers: str) -> int:
    request = urllib.request.Request(f"http://{console.address}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request) as response:
            policy = response.headers["Content-Security-Policy"]
            assert policy.startswith("default-src 'self';"), "no other host is asked for anything"
            return int(response.status)
    except urllib.error.HTTPError as error:
        return error.code


async def test_the_page_is_served_to_its_own_name_alone(tmp_path: Path) -> None:
    async with served(tmp_path, hosts=("tunnel:9000",)) as console:
        assert await asyncio.to_thread(status_of, console) == 200
        assert await asyncio.to_thread(status_of, console, "/main.js") == 200
        assert await asyncio.to_thread(status_of, console, "/", Host="evil.example") == 421
        assert await asyncio.to_thread(status_of, console, "/", Host=f"localhost:{console.port}") == 200
        assert await asyncio.to_thread(status_of, console, "/", Host="tunnel:9000") == 200
        for path in ("/../server.py", "/server.py", "//main.js", "/live", "/uPlot.LICENSE"):
            assert await asyncio.to_thread(status_of, console, path) >= 400


async def test_a_socket_of_another_site_is_refused(tmp_path: Path) -> None:
    async with served(tmp_path) as console:
        for path in SOCKETS:
            for origin in ("http://evil.example", f"https://{console.address}", "null"):
                with pytest.raises(InvalidStatus) as refused:
                    await console.socket(path, origin=origin)
                assert refused.value.response.status_code == 403
            with pytest.raises(InvalidStatus) as refused:
                await console.socket(path, host="evil.example")
            assert refused.value.response.status_code == 421


async def test_without_the_token_a_socket_is_closed(tmp_path: Path) -> None:
    wrong = ({"token": "wrong"}, {"token": ""}, {"client": ""}, {"client": "short"}, {"client": 65 * "a"})

    async with served(tmp_path) as console:
        for path, shown in itertools.product(SOCKETS, wrong):
            async with console.socket(path, **shown) as socket:
                with pytest.raises(ConnectionClosed) as closed:
                    await socket.recv()
                assert closed.value.rcvd is not None
                assert closed.value.rcvd.code == 1008


@asynccontextmanager
async def looking(
    place: Path, rows: int = 64, **options: Any
) -> AsyncIterator[tuple[HandTurnedLoop, Served, Page]]:
    """Serve a console with a page that looks at a loop of this process, which is in its trial."""
    loop = HandTurnedLoop(rows, shared=True, **options)
    loop.ring.put(control_words.PHASE, int(Phase.TRIAL))
    with loop.ring:
        async with served(place) as console, console.page() as page:
            await page.ask("look", pid=os.getpid())
            yield loop, console, page


async def test_a_running_loop_is_found_and_followed(tmp_path: Path) -> None:
    async with looking(tmp_path, 4096) as (loop, _, page):
        loop_message = await page.until(lambda page: page.newest("loop"))
        assert loop_message["experiment"] == INFO["experiment"]
        for _ in range(5):
            loop.leave(400, flags=int(RowFlag.INSIDE))
            await asyncio.sleep(0.005)
        await page.until(lambda page: sum(f["points"] * f["step"] for f in page.frames) >= 2000)
        state = await page.until(lambda page: (page.newest("state") or {}).get("loop"))
        assert (state["phase"], state["unseen"], state["ended"]) == ("trial", 0, None)
        loop.end(reason=1)
        await page.until(lambda page: (page.newest("state") or {})["loop"]["ended"])
        rows = sum(frame["points"] * frame["step"] for frame in page.frames if frame["kind"] == "live")
        assert rows == 2000, "each row once"


NONSENSE: tuple[Any, ...] = (
    ["x"],
    {"controller": ["x"]},
    *({"controller": {"position_rate": rate}} for rate in ("fast", 1e999, -1)),
)


async def test_a_loop_that_reports_nonsense_ends_no_console(tmp_path: Path, searched: Searched) -> None:
    async with served(tmp_path) as console, console.page() as page:
        for experiment in NONSENSE:
            with HandTurnedLoop(64, shared=True, info={"experiment": experiment}).ring as ring:
                assert "result" in await page.ask("look", pid=os.getpid())
                await searched(1)
                assert page.newest("loop") is None, experiment
                await page.ask("stop")
                assert ring.get(control_words.STOP) == -os.getpid()
                ring.put(control_words.LOOP_DONE, 1)


async def test_a_loop_that_cannot_be_read_costs_its_scope_and_no_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, searched: Searched
) -> None:
    polled = 0

    def broken(_: Followed) -> None:
        nonlocal polled
        polled += 1
        raise KeyError("a defect")

    async with looking(tmp_path) as (loop, _, page):
        monkeypatch.setattr(Followed, "poll", broken)
        trouble = await page.until(lambda page: page.newest("trouble"))
        assert "a defect" in trouble["message"]
        await searched(2)
        assert polled == 1, "it is not looked at again"
        assert (await page.ask("operate", take=True))["result"] == {"operates": True}
        await page.ask("stop")
        assert loop.ring.get(control_words.STOP) == -os.getpid()


@pytest.mark.parametrize(
    "where", ["rig.extras.console.live.Live._send_state", "rig.extras.console.view.View.frames"]
)
async def test_a_defect_in_the_view_is_reported_and_ends_no_server(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, lambda *_: {}["a defect"])
    monkeypatch.setattr("rig.extras.console.live.DEFECT_S", 0.1)
    async with looking(tmp_path) as (_, _, page):
        trouble = await page.until(lambda page: page.newest("trouble"))
        assert "a defect" in trouble["message"]
        assert "result" in await page.ask("operate", take=True)


async def test_a_console_that_cannot_watch_its_runs_ends_with_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def serve() -> None:
        async with served(tmp_path) as console, console.page() as page:
            monkeypatch.setattr(Lease, "expire", lambda _: {}["a defect"])
            with pytest.raises(ConnectionClosed):
                await page.until(lambda _: False)

    with pytest.raises(RigError, match="could no longer supervise its runs, and has ended them: KeyError"):
        await serve()


async def stop_by(hold: ClientConnection, ring: Ring) -> None:
    await hold.send('{"stop":true}')
    while ring.get(control_words.STOP) == 0:
        await asyncio.sleep(0.001)


async def test_stop_reaches_the_loop_by_either_socket(tmp_path: Path) -> None:
    async with served(tmp_path) as console:
        for by in ("hold", "live"):
            with HandTurnedLoop(64, shared=True).ring as ring:
                async with console.page() as page, console.hold("the-second-page") as hold:
                    await page.ask("look", pid=os.getpid())
                    await page.until(lambda page: page.newest("loop"))
                    if by == "live":
                        await page.ask("stop")
                        assert ring.get(control_words.STOP) != 0
                    else:  # of a page that does not operate
                        await stop_by(hold, ring)
                ring.put(control_words.LOOP_DONE, 1)


async def test_stop_reaches_loops_that_no_page_shows(tmp_path: Path) -> None:
    async with served(tmp_path, own=True) as console:
        with HandTurnedLoop(64, shared=True).ring as ring:
            async with console.hold() as hold:
                await stop_by(hold, ring)


@pytest.mark.parametrize(
    "say", first_by_default([UPGRADE, b"", b"GET / HTTP/1.1\r\n"]), ids=["no token", "nothing", "half"]
)
async def test_a_client_without_token_holds_no_place_and_keeps_no_page_out(
    say: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.extras.console.bounds.DOOR_S", 60.0)

    async with (
        served(tmp_path) as console,
        console.page("a-page-of-before") as before,
        console.hold("a-page-of-before") as hold,
    ):
        knocking = [await knock(console, say) for _ in range(2 * MOST_AT_DOOR)]
        async with asyncio.timeout(10.0):
            for reader, _ in knocking[:MOST_AT_DOOR]:  # the newest have the places
                await left(reader)
        async with console.page("a-page-that-comes") as page:
            assert "result" in await page.ask("operate", take=True)
        assert "result" in await before.ask("stop")
        await hold.send('{"stop":true}')
        assert "stopped" in await hold.recv()
        monkeypatch.setattr("rig.extras.console.bounds.DOOR_S", 0.01)
        late = [await knock(console, say) for _ in range(4)]
        async with asyncio.timeout(10.0):
            for reader, _ in late:  # nor do those keep theirs
                await left(reader)
        for _, writer in knocking + late:
            writer.close()


MASKED = b"\x80\x00\x00\x00\x00"  # an empty frame's length and mask
FRAMES = {
    "continuations": b"\x01" + MASKED + 4000 * (b"\x00" + MASKED),
    "pings": 4000 * (b"\x89" + MASKED),
    "messages": 4000 * (b"\x81" + MASKED),
}


@pytest.mark.parametrize(
    "say",
    [
        *(UPGRADE + frames for frames in FRAMES.values()),
        b"GET /" + 40_000 * b"a",
        UPGRADE[:-2] + 2000 * b"A-Header: of a long head\r\n",
        UPGRADE[:-2] + 100 * (b"A-Header: " + 200 * b"a" + b"\r\n") + b"\r\n",
        UPGRADE + b"\r\n\r\n",
        40_000 * b"\r\n",
    ],
    ids=[*FRAMES, "an endless line", "an endless head", "a long head", "two ends", "empty lines"],
)
@pytest.mark.parametrize("piece", first_by_default([1 << 20, 700]), ids=["at once", "in pieces"])
async def test_before_the_token_the_server_parses_one_bounded_head_and_no_frame(
    say: bytes, piece: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server cuts off any other connection at once, without a reply or a closing handshake."""
    parsed: dict[ServerProtocol, int] = {}
    frames: list[Frame] = []
    receive, take = ServerProtocol.receive_data, ServerProtocol.recv_frame

    def count(protocol: ServerProtocol, data: bytes) -> None:
        parsed[protocol] = parsed.get(protocol, 0) + len(data)
        receive(protocol, data)

    def keep(protocol: ServerProtocol, frame: Frame) -> None:
        frames.append(frame)
        take(protocol, frame)

    monkeypatch.setattr(ServerProtocol, "receive_data", count)
    monkeypatch.setattr(ServerProtocol, "recv_frame", keep)

    async with served(tmp_path) as console:
        reader, writer = await knock(console, b"")
        data_sent = say.replace(b"ADDRESS", console.address.encode())
        with suppress(ConnectionError):
            for first in range(0, len(data_sent), piece):
                writer.write(data_sent[first : first + piece])
                await writer.drain()
                await asyncio.sleep(0)
        await left(reader)
        writer.close()
    assert not frames
    assert sum(parsed.values()) <= MOST_HEAD_BYTES


@pytest.mark.parametrize(
    ("path", "twice", "status"),
    [
        ("/", b"Host: ADDRESS", 421),
        ("/live", b"Origin: http://ADDRESS", 403),
        ("/download", b"Authorization: Bearer TOKEN", 404),
    ],
)
async def test_a_header_that_is_sent_twice_is_as_a_missing_one(
    path: str, twice: bytes, status: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with served(tmp_path) as console:
        head = UPGRADE.partition(b"\r\n")[2].replace(twice + b"\r\n", b"")
        text = f"GET {path} HTTP/1.1\r\n".encode() + 2 * (twice + b"\r\n") + head
        reader, writer = await knock(console, text.replace(b"TOKEN", console.token.encode()))
        assert (await reader.readline()).split()[1] == str(status).encode()
        writer.close()
    assert not caplog.messages


async def knock(console: Served, say: bytes) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = await asyncio.open_connection("127.0.0.1", console.port)
    writer.write(say.replace(b"ADDRESS", console.address.encode()))
    return reader, writer


async def left(reader: asyncio.StreamReader) -> None:
    with suppress(ConnectionResetError):
        await reader.read()


async def test_of_too_many_holds_the_silent_one_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.extras.console.server.MOST_HOLDS", 2)

    async with (
        served(tmp_path) as console,
        console.hold("the-first-page") as one,
        console.hold("the-second-page") as two,
    ):
        await one.send('{"stop":true}')
        assert "stopped" in await one.recv()
        async with console.hold("the-third-page") as three:
            await three.send('{"stop":true}')
            assert "stopped" in await three.recv()
            with pytest.raises(ConnectionClosed):
                await two.recv()
            await one.send('{"stop":true}')
            assert "stopped" in await one.recv()


async def flood(socket: ClientConnection, messages: list[str]) -> None:
    for message in messages:
        await socket.send(message)
    while True:
        await socket.recv()


async def test_a_flood_or_a_long_message_is_cut_off_and_stops_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.extras.console.server.CLOSE_S", 0.05)

    async with served(tmp_path) as console:
        with HandTurnedLoop(64, shared=True).ring as ring:
            for open_socket, sent in (
                (console.hold, 1000 * ['{"beat":true}']),
                (console.socket, 1000 * ['{"do":""}']),
                (console.socket, ["x" * (1 << 17)]),
            ):
                async with open_socket() as socket:
                    with pytest.raises(ConnectionClosed):
                        await flood(socket, sent)
            async with console.hold() as hold:
                await stop_by(hold, ring)


async def test_a_participants_screen_receives_what_it_shows_and_nothing_else(tmp_path: Path) -> None:
    """The received bytes must not contain the wall of a running loop, which other pages may show."""
    async with looking(tmp_path, 4096) as (loop, console, page):
        hello = await page.until(lambda page: page.newest("hello"))
        await page.until(lambda page: page.newest("loop"))
        async with console.screen(hello["participants"]) as screen:
            for do, content in (
                ("stop", {}), ("session_key", {"key": "1"}), ("session_line", {"text": "x"}),
            ):  # fmt: skip
                assert "result" in await screen.ask(do, **content)
            for do in ("operate", "run", "experiment", "recordings", "session", "show", "set"):
                assert "unknown request" in (await screen.ask(do))["error"]["error"]
            for _ in range(5):
                loop.leave(400)
                await asyncio.sleep(0.01)
            await page.until(lambda page: sum(f["points"] * f["step"] for f in page.frames) >= 2000 - 2)
            assert {one["say"] for one in screen.messages} == {"participant", "answer"}
            assert screen.frames == []
            assert screen.newest("participant") == {"say": "participant", "runs": False}
        for path in ("/live", "/live?x", "/participant", "/participant?x"):
            token = console.token if path.startswith("/participant") else hello["participants"]
            async with console.socket(path, token=token) as socket:  # neither opens what is the other's
                with pytest.raises(ConnectionClosed):
                    await socket.recv()


async def test_one_page_operates_and_the_others_look_on(tmp_path: Path) -> None:
    async with (
        served(tmp_path) as console,
        console.page("page-number-one") as one,
        console.page("page-number-two") as two,
    ):
        assert (await one.ask("operate", take=True))["result"] == {"operates": True}
        assert (await two.ask("operate", take=True))["result"] == {"operates": False}
        refused = await one.ask("hand", position=0.1)
        assert "no run with a dragged handle" in refused["error"]["error"], (
            "a session's hand uses the same file"
        )
        refused = await two.ask("hand", position=0.1)
        assert "another page operates" in refused["error"]["error"]
        refused = await two.ask("run", job="hit")
        assert "another page operates" in refused["error"]["error"]
        await one.ask("operate", take=False)
        assert (await two.ask("operate", take=True))["result"] == {"operates": True}


async def test_a_real_rig_is_armed_by_no_page_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Errands, "run", Here.run)
    async with served(tmp_path) as console, console.page() as page:
        refused = await page.ask("run", job="hit", url="serial:///dev/ttyACM0")
        assert "does not run in a terminal" in refused["error"]["error"]
        assert "rig console" in refused["error"]["remedy"]


async def test_a_defect_costs_a_reply_and_no_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(*_: object, **content: object) -> None:
        raise KeyError("a defect")

    monkeypatch.setattr(Lease, "take", lambda *_: 1 / 0)
    monkeypatch.setattr(Errands, "run", broken)

    async with served(tmp_path) as console, console.page() as page:
        for do, content, reason in (("operate", {"take": True}, "ZeroDivision"), ("maps", {}, "a defect")):
            answer = await page.ask(do, **content)  # at once, and later
            assert reason in answer["error"]["error"]
            assert "report it" in answer["error"]["remedy"]


async def test_a_page_that_reads_nothing_delays_no_other(tmp_path: Path) -> None:
    async with (
        looking(tmp_path, 1 << 12) as (loop, console, page),
        console.socket(client="a-stalled-page") as stalled,
    ):
        await page.until(lambda page: page.newest("loop"))
        for _ in range(10):
            loop.leave(300)
            await asyncio.sleep(0.01)
        await page.until(lambda page: sum(f["points"] * f["step"] for f in page.frames) >= 3000 - 2)
        assert (page.newest("state") or {})["loop"]["unseen"] == 0
        stalled.transport.abort()  # it would not hear that its closing is agreed to


async def test_a_page_that_reads_nothing_has_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clients: list[Client] = []
    monkeypatch.setattr(Live, "greet", lambda _, client: clients.append(client))

    async with served(tmp_path) as console:
        async with console.page():
            (client,) = clients
            for _ in range(MOST_REPLIES + 100):  # before anything can leave
                client.put("x" * 10_000)
            assert len(client._replies) <= MOST_REPLIES
        async with console.page("a-page-that-reads") as page:
            # Not "state": the next one of the live view would replace it, on a busy machine before it is sent.
            clients[1].put_newest({"say": "a test", "velocity": float("nan")})
            message = await page.until(lambda page: page.newest("a test"))
            assert message["velocity"] is None, "what a browser reads"


@pytest.mark.parametrize("do", ["experiment", "regions", "run"])
async def test_no_page_chooses_a_program(do: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Errands, "run", Here.run)
    more: dict[str, Any] = {"regions": {"damping": 0.1}, "run": {"job": "hit"}}.get(do, {})
    async with served(tmp_path) as console, console.page() as page:
        answer = await page.ask(do, changes={"wall.law": "rm"}, **more)
        assert "wall.law cannot be changed from a page" in answer["error"]["error"]


async def test_a_page_receives_the_limits_at_the_delay_of_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Errands, "run", Here.run)
    async with served(tmp_path) as console, console.page() as page:
        near, far = [
            (await page.ask("regions", damping=0.2, delay_ticks=ticks))["result"]["stable"]
            for ticks in (1, 4)
        ]
    assert near > far > 0.0, "delay takes stiffness away"


async def test_a_blinded_session_of_another_terminal_shows_nothing_and_is_stopped(tmp_path: Path) -> None:
    async with looking(tmp_path, info={**INFO, "blinded": True}) as (loop, _, page):
        loop.leave(50)
        state = await page.until(
            lambda page: (page.newest("state") or {}).get("blinded") and page.newest("state")
        )
        assert state["loop"] is None
        assert page.newest("loop") is None
        assert not [frame for frame in page.frames if frame["points"]]
        await page.ask("stop")
        assert loop.ring.get(control_words.STOP) == -os.getpid()


async def test_a_port_that_is_taken_is_an_error_that_names_it(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=str(port)):
            await served(tmp_path, port=port).__aenter__()
