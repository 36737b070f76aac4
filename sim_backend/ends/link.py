"""Simulate the rig in this process and in virtual time: hours pass in seconds, and every run gives the same result.

The file implements ``sim://``. The link behaves like a serial port and its driver: a bounded input buffer, which loses
bytes that are not read, and EIO after an unplug. `rig.devices` loads it. It must not read a real clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.connection import State
from firmware_protocol.faults import Fault
from rig.core.errors import ConfigError, LinkLostError
from rig.core.model import RigModel
from rig.devices.device import DeviceUrl
from rig.devices.fault_script import DeviceFault, Direction, Faults
from rig.devices.port import LoopPort
from rig.realtime.callbacks import callback_plugs
from rig.realtime.clock import VirtualClock
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.make_device import make_device
from sim_backend.ends.channel import ScriptedLine
from sim_backend.ends.far_end import ARRIVED, CLOSED, DISCARDED, OUTPUT_BYTES, PROGRESS, TICKS, CompiledPort


def _parse_times(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


OPTIONS: dict[str, Callable[[str], Any]] = {
    "seed": int,
    "initial_position": float,
    "offset": float,
    "position_rate_default": int,
    "position_rate_maximum": int,
    "incremental": int,
    "clock_ppm": float,
    "firmware": int,
    "sync": _parse_times,
}
RATE_MINIMUM, RATE_MAXIMUM = 50, 50_000  # Hz
CLOCK_PPM_MAXIMUM = 1000.0
SYNC_PULSE_S = 1e-3  # length of a pulse on the sync input, unless the next one comes sooner
BUFFER_BYTES = 1 << 16  # unread input, as in a driver; further bytes are lost

_BILLION = 1_000_000_000
_UNITS, _UNITS_NS = 2, 125  # 2 units of device time are 125 ns
_URL = DeviceUrl("sim", "", {}, "sim://")
_NEVER = 1 << 62  # as a tick or a time (ns)


class LinkedDevice(Protocol):
    """A simulated device: `board.device.SimulatedDevice` or `board.firmware.FirmwareDevice`."""

    @property
    def time(self) -> int:
        """Return the device time of the last sample (1/16 µs since boot)."""
        ...

    @property
    def time_ns(self) -> int:
        """Return the device time of the last sample (ns since boot)."""
        ...

    @property
    def elapsed_ns(self) -> int:
        """Return the simulated time since the device was created, over all resets (ns)."""
        ...

    @property
    def next_tick_ns(self) -> int:
        """Return the simulated time at which the next sample is due (ns since the device was created, not reset)."""
        ...

    def run(self, until_ns: int, most: int) -> tuple[bytes, int]:
        """Simulate ticks until the device sends bytes, at most `most` and up to `until_ns`; return bytes and ticks."""
        ...

    def receive(self, data: bytes, *, received_at: int | None = None) -> bytes:
        """Process bytes from the host, which arrived at device time `received_at` (1/16 µs); return the replies."""
        ...

    def press_emergency_stop(self, pressed: bool = True) -> None:
        """Press the emergency stop of the simulated board, or release it."""
        ...

    def sync_input(self, high: bool, at: int | None = None) -> None:
        """Set the level of the sync input at device time `at` (1/16 µs since boot)."""
        ...

    def inject_fault(self, fault: Fault) -> None:
        """Make the device detect a fault, as if its hardware had found it."""
        ...

    def truth(self) -> NDArray[np.void]:
        """Return the plant's state in every tick of a session since boot, dtype `rig.core.sample.TRUTH`."""
        ...


def open_link(url: DeviceUrl, model: RigModel | None = None, faults: Faults | None = None) -> MemoryLink:
    """Return a link to a new simulated device, at rest and just powered up, for a URL such as ``sim://name?seed=3``.

    Options: `seed` of the sensor noise; `initial_position` of the handle (rad or m); `offset` of position zero within
    its encoder count (0 ≤ offset < 1), instead of the model's; `incremental` = 1 for an encoder that begins at 0 at any
    position of the handle; `position_rate_default` and `position_rate_maximum` (Hz); `clock_ppm`, by which the device's
    clock runs fast; `sync` = 0.5,0.75 for pulses on the sync input 0.5 s and 0.75 s after power-up; `firmware` = 1 for
    a device that can run the law: the firmware, compiled for this computer.

    Without the option `firmware` the device runs no law. It is the compiled firmware, whose ticks run no Python, or,
    without a C compiler (or with `firmware` = 0), the device in Python (`sim_backend.board.device`), which sends the
    same bytes and is slower. With scripted faults (`faults`) all bytes pass through Python. Raise `ConfigError` if the
    model is missing, an option is unknown or out of range, or the firmware cannot be compiled.
    """
    if model is None:
        raise ConfigError(
            f"{url.text}: the URL names no rig to simulate",
            remedy="name a rig, for example sim://koul-compliant",
        )
    options = _parse(url)
    if "offset" in options:
        model = replace(model, encoder=replace(model.encoder, offset=options.pop("offset")))
    clock_ppm = options.pop("clock_ppm", 0.0)
    sync_s = options.pop("sync", ())
    firmware = options.pop("firmware", None)
    incremental = options.pop("incremental", 0)
    device, messages = make_device(model, None if firmware is None else bool(firmware), **options)
    if incremental:
        device.hardware.slip, device.hardware.count = -device.hardware.count, 0
        device.reset()
    return MemoryLink(device, faults, url=url, clock_ppm=clock_ppm, sync_s=sync_s, messages=messages)


def _parse(url: DeviceUrl) -> dict[str, Any]:
    url.allow((*OPTIONS, "hand"))
    options: dict[str, Any] = {}
    for name, text in url.options.items():
        if name == "hand":
            raise ConfigError(
                f"{url.text}: a hand cannot be driven in virtual time",
                remedy="run in real time, or leave out the option hand to use the scripted hand",
            )
        kind = OPTIONS[name]
        try:
            options[name] = kind(text)
        except ValueError:
            what = {int: "a whole number", _parse_times: "numbers with commas between them"}.get(
                kind, "a number"
            )
            raise ConfigError(
                f"{url.text}: the option {name} = {text!r} is not {what}", remedy=f"give {what}"
            ) from None
    _check(url, options)
    return options


def _check(url: DeviceUrl, options: Mapping[str, Any]) -> None:
    allowed: dict[str, Callable[[Any], bool]] = {
        "seed": lambda value: value >= 0,
        "initial_position": np.isfinite,
        "offset": lambda value: 0.0 <= value < 1.0,
        "position_rate_default": lambda value: RATE_MINIMUM <= value <= RATE_MAXIMUM,
        "position_rate_maximum": lambda value: RATE_MINIMUM <= value <= RATE_MAXIMUM,
        "clock_ppm": lambda value: abs(value) <= CLOCK_PPM_MAXIMUM,
        "incremental": lambda value: value in (0, 1),
        "firmware": lambda value: value in (0, 1),
        "sync": lambda times: all(0.0 < one < other < np.inf for one, other in pairwise((*times, 1e9))),
    }
    for name, value in options.items():
        if not allowed[name](value):
            raise ConfigError(
                f"{url.text}: the option {name} = {value} is out of range",
                remedy=f"allowed: offset 0 … 1, rates {RATE_MINIMUM} … {RATE_MAXIMUM} Hz, clock_ppm ±1000, "
                "firmware and incremental 0 or 1, seed 0 or more, times of sync (s) above 0 and rising",
            )


class _SyncEdge(NamedTuple):
    at_ns: int  # since the device was created
    is_rising: bool


def _sync_edges(starts_s: Sequence[float], origin_ns: int) -> deque[_SyncEdge]:
    """Return the edges of the sync input for pulses that start at `starts_s` (s after power-up, at `origin_ns`)."""
    edges: deque[_SyncEdge] = deque()
    for start, following in pairwise((*starts_s, np.inf)):
        end = start + min(SYNC_PULSE_S, 0.5 * (following - start))
        edges += [
            _SyncEdge(origin_ns + round(start * 1e9), True),
            _SyncEdge(origin_ns + round(end * 1e9), False),
        ]
    return edges


class MemoryLink:
    """A link (`rig.devices.device.Link`) to a simulated device in this process.

    Parameters
    ----------
    device
        Simulated device.
    faults
        Scripted faults of line and device; None for a line without faults.
    url
        URL that was opened, for messages.
    clock_ppm
        By how much the device's clock and plant run faster than the clock of the link (1e-6).
    sync_s
        Start times of pulses on the device's sync input (s of device time from now on), in ascending order.
    messages
        Restrictions of the device, each with its remedy.

    Attributes
    ----------
    device
        Simulated device, for tests that inspect it or act on it from outside.
    line
        Line with scripted faults and its counters, or None.
    discarded
        Number of bytes that arrived while the buffer was full.
    """

    bytes_per_second: float | None = None
    messages: Sequence[str] = ()

    def __init__(
        self,
        device: LinkedDevice,
        faults: Faults | None = None,
        *,
        url: DeviceUrl = _URL,
        clock_ppm: float = 0.0,
        sync_s: Sequence[float] = (),
        messages: Sequence[str] = (),
    ) -> None:
        self.url = url
        self.messages = messages
        self.clock = VirtualClock()
        self._device = device
        self.line = None if faults is None else ScriptedLine(faults.frames)
        self._events = sorted(faults.device if faults else (), key=lambda fault: fault.tick)
        self._start_ns = device.elapsed_ns
        self._sync_edges = _sync_edges(sync_s, self._start_ns)
        self._pace = _BILLION + round(clock_ppm * 1000)  # device nanoseconds in a second of the link
        self._progress = np.zeros(PROGRESS, np.int64)
        self._arrived = np.zeros(BUFFER_BYTES + OUTPUT_BYTES, np.uint8)
        self._failure: BaseException | None = None
        self._closed = False
        self._port: LoopPort | None = None
        self._compiled = self._compile(device)

    def _compile(self, device: LinkedDevice) -> CompiledPort | None:
        """Return a compiled port, or None if Python must run each tick.

        Python is needed for scripted faults, sync pulses, a clock error, and the device in Python.
        """
        scripted = self.line is not None or self._events or self._sync_edges or self._pace != _BILLION
        if scripted or not isinstance(device, FirmwareDevice):
            return None
        start_ns = self._start_ns
        return CompiledPort(
            device,
            self.clock,
            lambda: device.elapsed_ns - device.time_ns - start_ns,
            progress=self._progress,
            arrived=self._arrived,
            capacity=BUFFER_BYTES,
        )

    @property
    def device(self) -> Any:
        """Return the simulated device in its state after the last tick."""
        self._take_back()
        return self._device

    @property
    def frames(self) -> dict[Direction, int]:
        """Return the number of frames sent in each direction; empty on a link without scripted faults."""
        return {} if self.line is None else self.line.frames

    @property
    def struck(self) -> int:
        """Return the number of scripted faults that have acted on frames."""
        return 0 if self.line is None else self.line.acted.total()

    @property
    def current(self) -> int:
        """Return the active motor current of the device, after all limits (quanta)."""
        return int(self.device.current)

    @property
    def armed(self) -> bool:
        """Return True if the device is armed and accepts commands."""
        return self.device.state in (State.ARMED, State.RUNNING)

    def _take_back(self) -> None:
        if self._compiled is not None:
            self._compiled.take_back()

    @property
    def discarded(self) -> int:
        """Return the number of bytes that were lost because the host did not read them in time."""
        return self._progress.item(DISCARDED)

    # ------------------------------------------------------------------ Link

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that have arrived from the device; wait at most `timeout_s` (virtual) for the first."""
        self._take_back()
        self._wait(self.clock.now_ns() + round(max(0.0, timeout_s) * 1e9))
        return self._take_arrived(BUFFER_BYTES)

    def write(self, data: bytes) -> None:
        """Send all of `data` to the device; without scripted faults the bytes arrive at once."""
        self._take_back()
        self._check_open()
        self._catch_up()
        if self.line is not None:
            self.line.send(Direction.TO_DEVICE, data, self._progress.item(TICKS))
            self._check_open()
            data = self.line.receive(Direction.TO_DEVICE, self._progress.item(TICKS))
        self._to_host(self._device.receive(data, received_at=self._device_time()))

    def port(self) -> LoopPort:
        """Return `read`, `write` and `wait` for the control loop: compiled functions, or callbacks to this object."""
        if self._compiled is not None and self.line is None:
            return self._compiled.port()
        if self._port is None:
            self._port = self._make_port()
        return self._port

    def failure(self) -> BaseException | None:
        """Return the exception that the simulation raised inside the loop; None without one or after an unplug."""
        return self._failure or (None if self._compiled is None else self._compiled.failure)

    def truth(self) -> NDArray[np.void]:
        """Return the plant's true state in every tick of a session (`rig.core.sample.TRUTH`)."""
        self._take_back()
        return self._device.truth()

    def close(self) -> None:
        """Close the link. The device keeps its state, and its watchdog continues while time passes (`elapse`)."""
        self._closed = True
        self._progress[CLOSED] = 1

    # ------------------------------------------------------------------ virtual time

    def elapse(self, duration_s: float) -> None:
        """Let virtual time pass without action of the host, as if it hangs or was killed; also on a closed link."""
        self._take_back()
        self.clock.sleep_until(self.clock.now_ns() + round(duration_s * 1e9))
        self._catch_up()

    def _next_tick_ns(self) -> int:
        return self._link_time(self._device.next_tick_ns)

    def _link_time(self, device_ns: int) -> int:
        """Return a time on the device's scale (`elapsed_ns`) as time on the link's clock (ns), rounded up."""
        # Rounded up: rounded down, the device would be asked to run before its tick is due and never get there.
        return -((self._start_ns - device_ns) * _BILLION // self._pace)

    def _device_time(self) -> int:
        """Return the present device time (1/16 µs), which may lie between two samples."""
        device = self._device
        elapsed_ns = self._start_ns + self.clock.now_ns() * self._pace // _BILLION
        since_boot_ns = elapsed_ns - (device.elapsed_ns - device.time_ns)
        return max(device.time, since_boot_ns * _UNITS // _UNITS_NS)

    def _catch_up(self) -> None:
        now_ns = self.clock.now_ns()
        while self._next_tick_ns() <= now_ns:
            self._run(now_ns)

    def _wait(self, deadline_ns: int) -> bool:
        """Let virtual time pass until bytes have arrived (return True) or to the deadline (ns; return False)."""
        self._check_open()
        self._catch_up()
        # Time moves only while the host waits, and stops when the device sends: it never passes sample k before the
        # COMMAND that answers it has been delivered.
        while not self._progress[ARRIVED]:
            if self._next_tick_ns() > deadline_ns:
                self.clock.sleep_until(deadline_ns)
                return False
            self.clock.sleep_until(self._run(deadline_ns))
            self._check_open()
        return True

    def _run(self, deadline_ns: int) -> int:
        """Run ticks until the device sends bytes, or up to `deadline_ns`; `deadline_ns` is not before the next tick.

        Return the time of the last tick on the link's clock (ns).
        """
        device = self._device
        most = self._apply_events()
        until_ns = self._start_ns + deadline_ns * self._pace // _BILLION
        output, ticks = device.run(min(until_ns, self._apply_sync_edges()), most)
        self._progress[TICKS] += ticks
        if self.line is None:
            self._buffer_for_host(output)
        else:
            late = self.line.receive(Direction.TO_DEVICE, self._progress.item(TICKS))
            if late:
                output += device.receive(late)
            self._to_host(output)
        return self._link_time(device.elapsed_ns)

    def _apply_events(self) -> int:
        """Apply the scripted events of the device that are due; return the ticks to the next event, at least 1."""
        passed = self._progress.item(TICKS)
        while self._events and self._events[0].tick <= passed:
            event = self._events.pop(0)
            if not isinstance(event, DeviceFault):
                event.act(self._device)
            elif event.fault is Fault.EMERGENCY_STOP:
                self._device.press_emergency_stop()
            else:
                self._device.inject_fault(event.fault)
        due = passed + _NEVER if self.line is None else self.line.next_due() or passed + _NEVER
        if self._events:
            due = min(due, self._events[0].tick)
        return max(1, due - passed)

    def _apply_sync_edges(self) -> int:
        """Apply the sync input's edges up to the next sample; return the time before the next edge (ns)."""
        device = self._device
        while self._sync_edges and self._sync_edges[0].at_ns <= device.next_tick_ns:
            edge = self._sync_edges.popleft()
            since_boot_ns = edge.at_ns - (device.elapsed_ns - device.time_ns)
            device.sync_input(edge.is_rising, max(device.time, since_boot_ns * _UNITS // _UNITS_NS))
        return self._sync_edges[0].at_ns - 1 if self._sync_edges else _NEVER

    def _to_host(self, data: bytes) -> None:
        if self.line is not None:
            self.line.send(Direction.TO_HOST, data, self._progress.item(TICKS))
            data = self.line.receive(Direction.TO_HOST, self._progress.item(TICKS))
        self._buffer_for_host(data)

    def _buffer_for_host(self, data: bytes) -> None:
        if not data:
            return
        waiting = self._progress.item(ARRIVED)
        kept = data[: BUFFER_BYTES - waiting]
        self._arrived[waiting : waiting + len(kept)] = np.frombuffer(kept, np.uint8)
        self._progress[ARRIVED] += len(kept)
        self._progress[DISCARDED] += len(data) - len(kept)

    def _take_arrived(self, most: int) -> bytes:
        waiting = self._progress.item(ARRIVED)
        size = min(most, waiting)
        data = self._arrived[:size].tobytes()
        self._arrived[: waiting - size] = self._arrived[size:waiting].copy()
        self._progress[ARRIVED] -= size
        return data

    def _check_open(self) -> None:
        if self._closed or (self.line is not None and self.line.unplugged):
            raise LinkLostError(
                f"the link to {self.url.text} was {'closed' if self._closed else 'unplugged'}",
                remedy="open the device again; the device has set its effort to zero meanwhile",
            )

    # ------------------------------------------------------------------ the compiled loop

    def _make_port(self) -> LoopPort:
        plugs = callback_plugs(
            read=self._read_now, write=self.write, wait=self._wait, failed=self._note_failure
        )
        return LoopPort.on(self.clock, **plugs._asdict())

    def _note_failure(self, failure: BaseException) -> None:
        if not isinstance(failure, LinkLostError):
            self._failure = self._failure or failure

    def _read_now(self, most: int) -> bytes:
        self._check_open()
        return self._take_arrived(most)
