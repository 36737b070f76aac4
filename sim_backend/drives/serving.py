"""Serve a simulated drive in real time: pass bytes between port and drive, and let simulated time follow the clock.

The drive is advanced to the present when a unit (line or frame) arrives, when the drive sends an unrequested frame, and
at least every `IDLE_NS` (ns). `process` uses it. It must not change what a drive sends, except by scripted faults.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from rig.devices.fault_script import Direction
from sim_backend.drives.bus import DriveModel, Frame, SimulatedAdapter
from sim_backend.drives.faults import HOST_BUS_OFF, STALE, DriveEvent, DriveScript
from sim_backend.drives.socket_can import BUS_OFF
from sim_backend.ends.channel import ScriptedLine

IDLE_NS = 5_000_000  # longest time without an advance of the drive
LONGEST_STEP_NS = 15_000_000  # a longer time between two advances counts as a pause of this process
_MS, _SECOND = 1_000_000, 1_000_000_000


class DriveLine(Protocol):
    """The drive's side of a serial line or CAN bus."""

    def read(self, deadline_ns: int) -> bytes:
        """Return the received bytes; wait for some until the deadline (CLOCK_MONOTONIC, ns)."""
        ...

    def write(self, frames: bytes) -> None:
        """Send bytes now, or as soon as the host accepts them."""
        ...

    def unplug(self) -> None:
        """Disconnect both ends for good: nothing is received any more, and written bytes are lost."""
        ...


class Serving:
    """A server of a simulated drive on a port, until `stop` is set.

    Parameters
    ----------
    drive, adapter, port
        Drive to serve, its protocol, and the port or bus.
    script
        Scripted faults of the run.
    stop
        Ends the run when it is set.
    clock
        Returns the time (ns) of the clock that the port's deadlines use.

    Attributes
    ----------
    held_up_ns
        Total time (ns) during which simulated time stood still because this process did not run.
    """

    def __init__(
        self,
        drive: DriveModel,
        adapter: SimulatedAdapter,
        port: DriveLine,
        script: DriveScript,
        stop: threading.Event,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._clock = clock
        self._drive = drive
        self._adapter = adapter
        self._port = port
        self._stop = stop
        self._splitter = adapter.splitter()
        self._faulty_line = ScriptedLine(script.frames) if script.frames else None
        self._fault_splitter = adapter.splitter()
        self._events = list(script.events)
        self._repeats_reply = self._host_is_off = False
        self._last_replies: deque[list[Frame]] = deque(maxlen=1)
        self._unit_count = 0  # lines or frames from the host
        self._unplugged = False
        self._first_byte_ns: int | None = None
        self._started_ns = self._seen_ns = clock()
        self._start_tick = drive.ticks
        self.held_up_ns = 0

    def run(self, duration_s: float | None = None) -> None:
        """Serve hosts while the drive's ticks pass, for `duration_s` seconds (None: no end) or until `stop` is set."""
        end_ns = None if duration_s is None else self._started_ns + round(duration_s * 1e9)
        while not self._stop.is_set():
            data = self._port.read(self._deadline_ns())
            self._advance_drive()
            self._apply_due_events()
            if data and self._first_byte_ns is None:
                self._first_byte_ns = self._seen_ns
            self._receive(data)
            if end_ns is not None and self._seen_ns >= end_ns:
                return

    def _deadline_ns(self) -> int:
        deadline = self._seen_ns + IDLE_NS
        due = self._drive.next_due
        if due is not None:
            # Rounded up: woken before the tick, the loop would find nothing due and spin.
            after_ns = -((self._start_tick - due) * _SECOND // self._drive.rate_hz)
            deadline = min(deadline, self._started_ns + self.held_up_ns + after_ns)
        if self._faulty_line is not None and (late := self._faulty_line.next_due()) is not None:
            deadline = min(deadline, (self._first_byte_ns or 0) + late * _MS)
        return deadline

    def _advance_drive(self) -> None:
        now = self._clock()
        # This process was kept from a processor: the simulated world stood still, so that no watchdog of the drive
        # expires because this computer was late.
        self.held_up_ns += max(0, now - self._seen_ns - LONGEST_STEP_NS)
        self._seen_ns = now
        passed_ns = now - self._started_ns - self.held_up_ns
        self._send_frames(self._drive.run(self._start_tick + passed_ns * self._drive.rate_hz // _SECOND))

    @property
    def _since_first_byte_ms(self) -> int:
        return 0 if self._first_byte_ns is None else (self._seen_ns - self._first_byte_ns) // _MS

    def _receive(self, data: bytes) -> None:
        faulty = self._faulty_line
        if faulty is None:
            units = self._splitter.split(data) if data else []
        else:
            for unit in self._fault_splitter.split(data):
                faulty.send_frame(Direction.TO_DEVICE, unit, self._since_first_byte_ms)
            units = self._splitter.split(faulty.receive(Direction.TO_DEVICE, self._since_first_byte_ms))
        for unit in units:
            self._apply_due_events()
            if self._host_is_off:
                continue
            self._unit_count += 1
            frame, line = self._adapter.open(unit)
            for reply in self._reply(frame) if frame is not None else ():
                line += self._adapter.close(reply)
            self._send(line)
        if faulty is not None:
            self._send([])
            if faulty.unplugged and not self._unplugged:
                self._unplugged = True
                self._port.unplug()

    def _reply(self, frame: Frame) -> list[Frame]:
        replies = self._drive.receive(frame)
        if self._repeats_reply and replies and self._last_replies:
            self._repeats_reply = False
            return self._last_replies[0]
        if replies:
            self._last_replies.append(replies)
        return replies

    def _apply_due_events(self) -> None:
        for event in self._events[:]:
            if self._is_due(event):
                self._events.remove(event)
                if event.name == STALE:
                    self._repeats_reply = True
                elif event.name == HOST_BUS_OFF:
                    self._send_frames([Frame(BUS_OFF, bytes(8), error=True)])
                    self._host_is_off = True
                else:
                    self._send_frames(self._drive.happen(event.name, event.value))

    def _is_due(self, event: DriveEvent) -> bool:
        if event.tick is not None:
            return self._first_byte_ns is not None and event.tick <= self._since_first_byte_ms
        return event.frame == self._unit_count

    def _send_frames(self, frames: list[Frame]) -> None:
        if frames:
            self._send([unit for frame in frames for unit in self._adapter.close(frame)])

    def _send(self, units: list[bytes]) -> None:
        if self._host_is_off:
            return
        if self._faulty_line is None:
            if units:
                self._port.write(b"".join(units))
            return
        for unit in units:
            self._faulty_line.send_frame(Direction.TO_HOST, unit, self._since_first_byte_ms)
        if out := self._faulty_line.receive(Direction.TO_HOST, self._since_first_byte_ms):
            self._port.write(out)
