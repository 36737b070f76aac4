"""The live view: choose the control loop that the pages follow, and send its rows and state to the pages' scopes.

The server uses it. A bug here must not stop the server, which must receive a STOP (`Live._surviving`).
"""

import asyncio
import json
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.extras.console import requests as asked
from rig.extras.console.client import Client, defect
from rig.extras.console.follow import Followed, attach, newest
from rig.extras.console.history import History
from rig.extras.console.service import Handler, Service, ServiceContext
from rig.extras.console.terminal import Terminal
from rig.extras.console.view import POINTS, ViewRequest, pack
from rig.realtime.hand import SharedHand
from rig.realtime.memories import ask_to_stop
from rig.realtime.running import RunningLoop
from rig.recording.seal import SEALED_SUFFIX

FRAME_S = 1.0 / 60.0
STATE_S = 0.1
SEARCH_S = 0.25
DEFECT_S = 10.0  # between two reports of the same bug


class Live(Service):
    """Service that handles requests about the live view; it owns the control loop whose samples the pages show.

    If `own`, follow only runs that this console started.
    """

    def __init__(self, shared: ServiceContext, hand: SharedHand, terminal: Terminal, *, own: bool) -> None:
        self._shared, self._hand, self._terminal, self._own = shared, hand, terminal, own
        self._history = History()
        self._followed: Followed | None = None
        self._pid: int | None = None  # process chosen by a page; None: the loop that started last
        self._withheld = False  # True: no page may show the loop
        self._unreadable: tuple[int, float] | None = None  # a loop that raised an error
        self._defects: dict[str, float] = {}  # time of the last report (s)

    def handlers(self) -> Mapping[str, tuple[type[asked.Request], Handler]]:
        """Return request class and handler of each request of the live view, by the request's name."""
        return {
            "stop": (asked.Stop, self._stop),
            "show": (asked.Show, self._show),
            "zoom": (asked.Zoom, self._zoom),
            "cut": (asked.Cut, self._cut),
            "look": (asked.Look, self._look),
        }

    def greet(self, client: Client) -> None:
        """Send facts about the followed control loop to a newly connected page."""
        client.show(self._followed)
        self._send_loop(client)

    # Requests.

    async def _stop(self, client: Client, request: asked.Stop) -> None:
        self.stop_all()

    def stop_all(self) -> None:
        """Request a stop of every control loop of this user: zero effort within a tick."""
        # The followed loop and the job first, because finding all other loops takes time.
        if self._followed is not None and not self._followed.ended:
            self._followed.stop()
        self._shared.jobs.end()
        self._terminal.withdraw()
        for memory in ask_to_stop():
            memory.close()

    async def _show(self, client: Client, request: asked.Show) -> None:
        shown = ViewRequest(columns=request.columns, window_s=request.window_s, trigger=request.trigger)
        client.show(self._followed, shown, paused=request.paused)

    async def _zoom(self, client: Client, request: asked.Zoom) -> None:
        shown = ViewRequest(columns=request.columns)
        history = self._history
        first, last = history.row_at(request.first_s), history.row_at(request.last_s)
        step = max(1, (last - first) // POINTS)
        client.put(
            pack(history.cut(shown.columns, first, last, step), shown.columns, kind="zoom", fresh=True)
        )

    async def _cut(self, client: Client, request: asked.Cut) -> object:
        """Save a time span of the recording file, because the memory of the scope lacks older rows at full rate."""
        self._shared.must_operate(client)
        followed = self._followed
        recorded = None if followed is None else followed.info.get("recording")
        if followed is None or not recorded:
            raise ConfigError("the page shows no run with a recording", remedy="run a hit first")
        if not followed.ended:
            raise ConfigError(
                "the run has not ended: only a part of a complete recording can be saved",
                remedy="stop the run, or wait for its end",
            )
        path = Path(str(recorded))
        sealed = path.with_suffix(SEALED_SUFFIX)
        cut = self._shared.save_cut(
            sealed if sealed.exists() else path, request.first_s, request.last_s, self._history.start_ns
        )
        return self.answer_later(client, request, cut)

    async def _look(self, client: Client, request: asked.Look) -> None:
        self._pid = request.pid or None
        await self.search()

    def looked_at(self) -> Followed:
        """Return the control loop that is followed; raise `ConfigError` if no loop runs."""
        if self._followed is None or self._followed.ended:
            raise ConfigError("no control loop is running", remedy="start a run first")
        return self._followed

    def look_at_newest(self) -> None:
        """Forget the page's choice of a control loop, so that the loop that started last is followed."""
        self._pid = None

    # Periodic tasks.

    async def every_frame(self) -> None:
        """Read new rows and wake the pages' senders sixty times a second; runs as a task until cancelled."""
        due = 0.0
        while True:
            with self._surviving("reading the followed loop"):
                self._take_rows()
            with self._surviving("updating the pages"):
                self._send_hand()
                if (now := time.monotonic()) >= due:
                    due = now + STATE_S
                    self._send_state()
            for client in self._shared.clients:
                client.wake()
            await asyncio.sleep(FRAME_S)

    def _take_rows(self) -> None:
        followed = self._followed
        if followed is None or followed.ended:
            return
        try:
            followed.poll()
            if followed.changed():
                self._send_loop()
        except Exception:
            # Not searched for again, or the same defect would come back four times a second.
            self._unreadable = (followed.pid, followed.since)
            self._withhold()
            raise

    async def every_search(self) -> None:
        """Search for a control loop to follow every `SEARCH_S` (s); runs as a task until cancelled."""
        while True:
            with self._surviving("searching for loops"), suppress(OSError):
                # Without free file descriptors, perhaps because of another program, try again later.
                await self.search()
            await asyncio.sleep(SEARCH_S)

    @contextmanager
    def _surviving(self, what: str) -> Iterator[None]:
        """Report an exception to the pages, at most once per `DEFECT_S` (s), without raising it."""
        try:
            yield
        # The server must survive any bug in the live view, because it must receive a STOP.
        except Exception as error:
            now = time.monotonic()
            if now - self._defects.get(what, -math.inf) > DEFECT_S:
                self._defects[what] = now
                self._shared.report_trouble(defect(what, error))

    async def search(self) -> None:
        """Follow the running job's control loop, else the one that a page chose; none while the operator is blinded."""
        if self._shared.blinded:
            self._withhold()
            return
        pid = self._pid
        if self._shared.jobs.running is not None:
            pid = self._shared.jobs.running.pid
        elif self._own:
            return
        found = await asyncio.to_thread(newest, pid)
        if found is None:
            self._withheld = False
        if found is None or self._shared.blinded or self._is_looked_at(found):
            return
        self._withheld = bool(found.info.get("blinded"))  # a session at another terminal
        if self._withheld:
            self._withhold()
            return
        if self._unreadable == (found.pid, found.since) or (made := attach(found, self._history)) is None:
            return
        if self._followed is not None:
            self._followed.close()
        self._followed = made
        for client in self._shared.clients:
            client.show(made)
            self._send_loop(client)

    def _withhold(self) -> None:
        if self._followed is not None:
            self._followed.close()
            self._followed = None
            self._history.clear()
            for client in self._shared.clients:
                client.show(None)

    def _is_looked_at(self, loop: RunningLoop) -> bool:
        followed = self._followed
        return followed is not None and (followed.pid, followed.since) == (loop.pid, loop.since)

    def _send_state(self) -> None:
        held = self._shared.lease.held()
        followed = self._followed
        state = None if followed is None else followed.state()
        job = self._shared.jobs.running
        for client in self._shared.clients:
            client.put_newest(
                {
                    "say": "state",
                    "operates": held.by == client.name,
                    "operated": held.by is not None,
                    "overdue": held.overdue,
                    "loop": state,
                    "job": None if job is None else job.name,
                    "blinded": self._shared.blinded or self._withheld,
                    "pages": len(self._shared.clients),
                }
            )

    def _send_hand(self) -> None:
        motions = self._hand.motions()
        if motions and self._history.rows:
            rows = [
                [self._history.seconds_of(one.device_time_ns), one.hand, one.handle, one.velocity]
                for one in motions
            ]
            for client in self._shared.clients:
                client.put_newest({"say": "hand", "motions": rows})

    def _send_loop(self, only: Client | None = None) -> None:
        if self._followed is not None:
            message = json.dumps({"say": "loop", **plain(self._followed.about())})
            for client in self._shared.clients if only is None else {only}:
                client.put(message)

    async def close(self) -> None:
        """Release the followed control loop, and cancel the tasks of this service."""
        self._terminal.withdraw()
        if self._followed is not None:
            self._followed.close()
        await super().close()
