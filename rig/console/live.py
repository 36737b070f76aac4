"""The live view: the loop that is looked at, its wall, its handle, and runs that a page starts."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rig import config
from rig.console import consent
from rig.console import requests as asked
from rig.console.client import Client, defect
from rig.console.follow import Followed, attached, newest
from rig.console.history import History
from rig.console.hits import digest_of, in_effect
from rig.console.jobs import Job
from rig.console.lease import LOOK_S
from rig.console.service import Handler, Service, Shared
from rig.console.terminal import Terminal
from rig.console.view import POINTS, Shown, packed
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.experiments import live
from rig.realtime.hand import SharedHand
from rig.realtime.memories import ask_to_stop
from rig.realtime.running import RunningLoop
from rig.recording.seal import SEALED_SUFFIX

PLAY = "play"  # the job whose hand is dragged
FRAME_S = 1.0 / 60.0
STATE_S = 0.1
SEARCH_S = 0.25
DEFECT_S = 10.0  # between two words on the same defect


class Live(Service):
    """See the module.

    Parameters
    ----------
    verified
        As `rig.console.server.Settings`.
    own
        Likewise.
    """

    def __init__(
        self, shared: Shared, hand: SharedHand, terminal: Terminal, *, verified: bool, own: bool
    ) -> None:
        self._shared, self._hand, self._terminal = shared, hand, terminal
        self._verified, self._own = verified, own
        self._history = History()
        self._followed: Followed | None = None
        self._pid: int | None = None  # whose loop is wanted while no job runs; None: whichever began last
        self._withheld = False  # whether that loop may be shown to nobody
        self._unreadable: tuple[int, float] | None = None  # a loop that a defect of ours cannot read
        self._defects: dict[str, float] = {}  # when which was told last
        self._regions = asyncio.Lock()

    def handlers(self) -> Mapping[str, tuple[type[asked.Request], Handler]]:
        """See `Service.handlers`."""
        return {
            "operate": (asked.Operate, self._operate),
            "stop": (asked.Stop, self._stop),
            "run": (asked.Run, self._run),
            "set": (asked.Set, self._set),
            "hand": (asked.Hand, self._move),
            "show": (asked.Show, self._show),
            "zoom": (asked.Zoom, self._zoom),
            "cut": (asked.Cut, self._cut),
            "look": (asked.Look, self._look),
            "regions": (asked.AskRegions, self._ask_regions),
            "experiment": (asked.AskExperiment, self._ask_experiment),
        }

    def greet(self, client: Client) -> None:
        """See `Service.greet`."""
        client.show(self._followed)
        self._tell_loop(client)

    # Requests.

    async def _operate(self, client: Client, request: asked.Operate) -> dict[str, Any]:
        if request.take:
            self._shared.lease.take(client.name)
        else:
            self._shared.lease.release(client.name)
        return {"operates": self._shared.lease.held().by == client.name}

    async def _stop(self, client: Client, request: asked.Stop) -> None:
        self.stop_all()

    def stop_all(self) -> None:
        """Set the stop word of every loop of this user, first of those that are at hand without a search."""
        if self._followed is not None and not self._followed.ended:
            self._followed.stop()
        self._shared.jobs.end()
        self._terminal.withdraw()
        for memory in ask_to_stop():
            memory.close()

    async def _run(self, client: Client, request: asked.Run) -> object:
        self._shared.must_operate(client)
        asked.refuse_reserved(request.changes)
        if not request.url.startswith("sim:"):
            return self.answer_later(client, request, self._run_agreed(client, request))
        return await self._start(request)

    async def _run_agreed(self, client: Client, request: asked.Run) -> dict[str, Any]:
        """Start what a person at the rig agrees to; meanwhile the page's other requests are answered."""
        experiment = await asyncio.to_thread(self._experiment, request.rig, request.changes)
        digest = digest_of(experiment)
        lines = consent.to_run(request, experiment, digest)
        await consent.insist(self._terminal, client, request.url, lines)
        self._shared.must_operate(client)  # still: a person takes their time
        return await self._start(request, digest)

    async def _start(self, request: asked.Run, digest: str | None = None) -> dict[str, Any]:
        content: dict[str, Any] = {
            "rig": request.rig, "url": request.url, "changes": request.changes, "output": str(self._shared.output),
            "duration_s": request.duration_s, "hand": str(self._hand.path), "verified": self._verified,
            "digest": digest,
        }  # fmt: skip
        goes_on = request.goes_on and request.job != PLAY
        job = await self._shared.jobs.start(request.job, content, goes_on=goes_on)
        self._pid = None
        return {"pid": job.pid}

    async def _set(self, client: Client, request: asked.Set) -> Any:
        self._shared.must_operate(client)
        followed = self._looked_at()
        return await asyncio.to_thread(live.change_wall, request.changes, followed.pid, patience_s=0.0)

    async def _move(self, client: Client, request: asked.Hand) -> None:
        self._shared.must_operate(client)
        job = self._shared.jobs.running
        if job is None or job.name != PLAY:  # a session moves the same hand from its own desk
            raise ConfigError("no handle is dragged now", remedy="start “Drag the handle” first")
        self._hand.move(request.position, request.press)

    async def _show(self, client: Client, request: asked.Show) -> None:
        shown = Shown(columns=request.columns, window_s=request.window_s, trigger=request.trigger)
        client.show(self._followed, shown, paused=request.paused)

    async def _zoom(self, client: Client, request: asked.Zoom) -> None:
        shown = Shown(columns=request.columns)
        history = self._history
        first, last = history.row_at(request.first_s), history.row_at(request.last_s)
        step = max(1, (last - first) // POINTS)
        client.put(
            packed(history.cut(shown.columns, first, last, step), shown.columns, kind="zoom", fresh=True)
        )

    async def _cut(self, client: Client, request: asked.Cut) -> object:
        """Cut what was recorded, at full rate, of which the history has a part or points."""
        self._shared.must_operate(client)
        followed = self._followed
        recorded = None if followed is None else followed.info.get("recording")
        if followed is None or not recorded:
            raise ConfigError("no loop that was recorded is looked at", remedy="start a run first")
        if not followed.ended:
            raise ConfigError(
                "a cut is taken from the recording, which is whole when the run has ended",
                remedy="stop it, or wait",
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

    async def _ask_regions(self, client: Client, request: asked.AskRegions) -> object:
        async def found() -> Any:
            content = {name: getattr(request, name) for name in ("rig", "changes", "damping", "delay_ticks")}
            async with self._regions:  # one after the other: pages ask while a slider moves
                result, _ = await self._shared.errands.run("regions", compiling=client.compiles, **content)
            return result

        asked.refuse_reserved(request.changes)
        return self.answer_later(client, request, found())

    async def _ask_experiment(self, client: Client, request: asked.AskExperiment) -> Any:
        return await asyncio.to_thread(
            lambda: config.as_mapping(self._experiment(request.rig, request.changes))
        )

    def _experiment(self, name: str, changes: Mapping[str, Any]) -> config.Experiment:
        asked.refuse_reserved(changes)
        return in_effect({"rig": name, "changes": changes})

    def _looked_at(self) -> Followed:
        if self._followed is None or self._followed.ended:
            raise ConfigError("no loop runs", remedy="start a run first")
        return self._followed

    # What goes on by itself.

    async def every_frame(self) -> None:
        """Take over rows and hand them on, sixty times a second."""
        due = 0.0
        while True:
            with self._surviving("the loop that is looked at"):
                self._take_rows()
            with self._surviving("what a page is shown"):
                self._tell_hand()
                if (now := time.monotonic()) >= due:
                    due = now + STATE_S
                    self._tell_state()
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
                self._tell_loop()
        except Exception:
            self._unreadable = (followed.pid, followed.since)
            self._withhold()
            raise

    async def every_search(self) -> None:
        """Look for another loop."""
        while True:
            with self._surviving("the search for loops"), suppress(OSError):
                await self.search()  # no descriptor left, which anybody may use up: it is tried again
            await asyncio.sleep(SEARCH_S)

    @contextmanager
    def _surviving(self, what: str) -> Iterator[None]:
        """Let a defect of ours cost what it spoils, told now and then, and not the server that hears STOP."""
        try:
            yield
        except Exception as error:
            now = time.monotonic()
            if now - self._defects.get(what, -math.inf) > DEFECT_S:
                self._defects[what] = now
                self._shared.tell_trouble(defect(what, error))

    async def search(self) -> None:
        """Look at the loop that is wanted, if it is another one; at none that nobody here may know."""
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
        self._withheld = bool(found.info.get("blinded"))  # a session of another terminal
        if self._withheld:
            self._withhold()
            return
        if self._unreadable == (found.pid, found.since) or (made := attached(found, self._history)) is None:
            return
        if self._followed is not None:
            self._followed.close()
        self._followed = made
        for client in self._shared.clients:
            client.show(made)
            self._tell_loop(client)

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

    async def every_beat(self) -> None:
        """End what moves while nobody operates: its operator has gone, or let go.

        A defect here ends what this console moves, whether it goes on without a page or not, and then the console:
        nobody would end it later.
        """
        told: Job | None = None  # since nobody operates
        try:
            while True:
                told = self._beat(told)
                await asyncio.sleep(LOOK_S)
        except Exception:
            self._shared.jobs.end()
            raise

    def _beat(self, told: Job | None) -> Job | None:
        self._shared.jobs.beat()
        self._shared.lease.expire()
        if self._shared.lease.held().by is not None:
            return None
        self._terminal.withdraw()
        job = self._shared.jobs.running
        if job is not None and job is not told and not job.goes_on:
            job.end()
            return job
        return told

    def _tell_state(self) -> None:
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

    def _tell_hand(self) -> None:
        motions = self._hand.motions()
        if motions and self._history.rows:
            told = [
                [self._history.seconds_of(one.device_time_ns), one.hand, one.handle, one.velocity]
                for one in motions
            ]
            for client in self._shared.clients:
                client.put_newest({"say": "hand", "motions": told})

    def _tell_loop(self, only: Client | None = None) -> None:
        if self._followed is not None:
            told = json.dumps({"say": "loop", **plain(self._followed.about())})
            for client in self._shared.clients if only is None else {only}:
                client.put(told)

    async def close(self) -> None:
        """See `Service.close`."""
        self._terminal.withdraw()
        if self._followed is not None:
            self._followed.close()
        await super().close()
