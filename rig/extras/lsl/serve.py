"""Follow running control loops, one after another, and stream their samples and markers, until interrupted.

`rig serve lsl` runs it in a process of its own. It must not write to the memory of a loop.
"""

import json
import os
import select
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from rig.core.errors import ConfigError, RigError
from rig.core.sample import Motion
from rig.extras.lsl import library
from rig.extras.lsl.follow import Follower, Marker, decimation, without_secrets
from rig.extras.lsl.session import NAME
from rig.extras.lsl.streams import MarkerStream, SampleStream
from rig.realtime import running
from rig.realtime.ring import Ring

POLL_S = 0.02  # a chunk's length
LOOK_S, LOOK_EVERYWHERE_S = 0.02, 0.25  # between two looks for the next loop, of a process or of any
# Time at the end in which liblsl sends what it has queued, before the outlets close.
LINGER_S = 0.5
DEATH_S = 1.0  # time without a row after which the process is checked


@dataclass(slots=True)
class Streamed:
    """What was streamed: numbers of loops, samples, markers, lost rows; last sample rate (Hz); LSL's clock offset."""

    name: str
    loops: int = 0
    samples: int = 0
    markers: int = 0
    lost: int = 0
    rate: float | None = None
    offset_s: float = 0.0
    offset_uncertainty_s: float = 0.0


class Markers:
    """Reader of markers that another program writes as lines of JSON: ``{"at": host time in ns, "marker": {...}}``.

    A marker without `at` has the time at which it was read.

    Attributes
    ----------
    malformed
        Number of lines of another form, which are ignored.
    over
        True if the input has ended.
    """

    def __init__(self, descriptor: int) -> None:
        self.malformed = 0
        self.over = False
        self._descriptor = descriptor
        self._rest = b""

    def take(self) -> list[Marker]:
        """Return the markers received since the last call, without waiting."""
        while not self.over and select.select([self._descriptor], [], [], 0.0)[0]:
            data = os.read(self._descriptor, 65536)
            self._rest += data
            self.over = not data
        *lines, self._rest = self._rest.split(b"\n")
        return [marker for line in lines if (marker := self._marker(line)) is not None]

    def _marker(self, line: bytes) -> Marker | None:
        try:
            request = json.loads(line)
            return Marker(int(request.get("at") or time.monotonic_ns()), dict(request["marker"]))
        except (ValueError, TypeError, KeyError, AttributeError):
            self.malformed += 1
            return None


def serve(
    pid: int | None = None,
    *,
    rate: float | None = None,
    name: str = NAME,
    blind: bool = False,
    once: bool = False,
    markers: int | None = None,
    expected: tuple[Motion, float] | None = None,
    report: Callable[[Mapping[str, Any]], None] | None = None,
) -> Streamed:
    """Stream the loops that run in real time, until Ctrl-C or until the process or the markers' input ends.

    Return the counts, also after a KeyboardInterrupt. Raises `ConfigError` if pylsl or liblsl is missing, a rate is not
    above 0, or the process does not exist.

    Parameters
    ----------
    pid
        Process whose loops are followed; streaming ends with the process. None: the loops of any process of this user,
        one at a time.
    rate
        Largest number of samples a second: the position rate over a whole number. None: every row.
    name
        First word of the streams' names.
    blind
        Leave everything about the wall out of the markers.
    once
        End when the first loop ends.
    markers
        Descriptor from which further markers are read (`Markers`); streaming ends with this input.
    expected
        Motion and position rate (Hz) of the loops to come, so that the stream of samples is open before the first of
        them. Otherwise it opens with the first loop, and a receiver misses the samples until it finds the stream.
    report
        Called with a mapping when a stream opens, and when a loop begins or ends.
    """
    if rate is not None and not rate > 0.0:
        raise ConfigError(
            f"a rate of {rate} samples per second is not possible",
            remedy="give a rate above 0, or omit it to send every row",
        )
    if expected is not None and not expected[1] > 0.0:
        raise ConfigError(
            f"a position rate of {expected[1]} Hz is not possible", remedy="give a rate above 0"
        )
    if pid is not None and not _alive(pid):
        raise ConfigError(
            f"no running process {pid} of this user", remedy="list running loops with rig stop --list"
        )
    pylsl = library.load()
    server = _Server(pylsl, rate, name, blind, report or (lambda _: None))
    if expected is not None:
        server.open_samples(*expected)
    source = None if markers is None else Markers(markers)
    with suppress(KeyboardInterrupt):
        server.run(pid, source, once=once)
        time.sleep(LINGER_S)
    return server.served


class _Server:
    """Owner of the LSL outlets (network streams): it follows loops, sends their data, and counts what it has sent."""

    def __init__(
        self,
        pylsl: Any,
        rate: float | None,
        name: str,
        blind: bool,
        report: Callable[[Mapping[str, Any]], None],
    ) -> None:
        self._pylsl, self._rate, self._name, self._blind, self._report = pylsl, rate, name, blind, report
        self._offset = library.clock_offset(pylsl)
        # Compile what reads a ring now, not while a loop runs.
        with Ring.allocate(1) as ring:
            Follower(ring).poll()
        self.served = Streamed(
            name, offset_s=self._offset.offset_s, offset_uncertainty_s=self._offset.uncertainty_s
        )
        self._markers = MarkerStream(pylsl, name, self._offset)
        self._samples: SampleStream | None = None
        self._context: dict[str, Any] = {}  # added to every marker: the session's trial
        report({"stream": f"{name} markers", **asdict(self._offset)})

    def run(self, pid: int | None, source: Markers | None, *, once: bool) -> None:
        """Follow loops until process `pid` or the input of markers has ended, or, with `once`, one loop has ended."""
        while True:
            self._pass_on(source)
            over = source is not None and source.over
            found = _next_loop(pid)
            if found is not None:
                owner, ring = found
                with ring:
                    self._follow(owner, ring, source)
                if once:
                    return
            elif over or (pid is not None and not _alive(pid)):
                return
            else:
                time.sleep(LOOK_EVERYWHERE_S if pid is None else LOOK_S)

    def _follow(self, owner: int, ring: Ring, source: Markers | None) -> None:
        follower = Follower(ring, rate=self._rate, blind=self._blind)
        rig = (follower.info.get("experiment") or {}).get("rig") or {}
        self.open_samples("linear" if rig.get("motion") == "linear" else "rotary", follower.position_rate)
        self._report({"loop": owner, "position_rate": follower.position_rate, "rate": follower.rate})
        try:
            self._follow_to_end(owner, follower, source)
        finally:
            self.served.loops += 1
            self.served.lost += follower.lost
            self._report({"ended": owner, "rows": follower.rows, "lost": follower.lost})

    def _follow_to_end(self, owner: int, follower: Follower, source: Markers | None) -> None:
        last_line_s = time.monotonic()
        while not follower.ended:
            self._pass_on(source)
            before = follower.rows
            self._send(follower)
            now = time.monotonic()
            if follower.rows > before:
                last_line_s = now
            elif not follower.ended and now - last_line_s > DEATH_S and not _alive(owner):
                return  # the process died without ending its loop
            if not follower.ended:
                time.sleep(POLL_S)

    def _send(self, follower: Follower) -> None:
        chunk = follower.poll()
        assert self._samples is not None
        self._samples.push(chunk.rows, chunk.times_ns)
        self.served.samples += len(chunk.rows)
        self._mark([Marker(one.time_ns, {**one.content, **self._context}) for one in chunk.markers])

    def open_samples(self, motion: Motion, position_rate: float) -> None:
        """Open the outlet of samples; keep the open outlet if its rate and units are the same."""
        rate = position_rate / decimation(position_rate, self._rate)
        known = self._samples
        if known is not None and (known.rate, known.motion) == (rate, motion):
            known.begin()
            return
        self._samples = SampleStream(self._pylsl, self._name, motion, rate, position_rate, self._offset)
        self.served.rate = rate
        self._report({"stream": f"{self._name} samples", "rate": rate})

    def _pass_on(self, source: Markers | None) -> None:
        """Send the markers of another program; a `trial` in a marker is added to all markers that follow."""
        for marker in source.take() if source is not None else ():
            if "trial" in marker.content:
                self._context = {"trial": marker.content["trial"]}
            content = without_secrets(marker.content) if self._blind else marker.content
            self._mark([Marker(marker.time_ns, {**self._context, **content})])

    def _mark(self, markers: list[Marker]) -> None:
        self._markers.push(markers)
        self.served.markers += len(markers)


def _next_loop(pid: int | None) -> tuple[int, Ring] | None:
    if pid is not None:
        ring = running.memory_of(pid)
        return None if ring is None else (pid, ring)
    for loop in reversed(running.running()):
        with suppress(OSError, RigError):
            return loop.pid, Ring.attach(loop.path, writable=False)
    return None


def _alive(pid: int) -> bool:
    """Return True if a process of this user is running; a zombie has no files and counts as ended."""
    try:
        return bool(os.listdir(f"/proc/{pid}/fd"))
    except OSError:
        return False
