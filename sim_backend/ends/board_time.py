"""Run a compiled device in real time: the timer and the main loop of a board, in compiled code without Python's lock.

The file simulates a board behind a USB serial port. The board continues to run when a host exits, even by kill -9, and
its watchdog detects that only by the missing messages. The reply to STATE k acts from sample k + 1 on. `pty` uses it.
"""

import threading
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numba import types

from rig.devices.port import PORT_TYPE, LoopPort
from rig.realtime.groups import group_at, group_bytes, type_of
from rig.realtime.kernel import kernel, prepare
from rig.realtime.native import native_call
from sim_backend.board.hardware import NO_END, Hardware, World
from sim_backend.board.lockstep import (
    BYTE_COUNT,
    BYTES,
    CUTS,
    DUE,
    RATE_CHANGED,
    RECEIVED_AT,
    SWITCHED_ON,
    TIME,
    Lockstep,
    Supplies,
    Wires,
    cut,
    run_ticks,
)
from sim_backend.mechanics.operator import OperatorScript
from sim_backend.mechanics.plant import PLANT_TYPE, PlantArguments

SLICE_NS = 10_000_000  # time of one compiled call: a signal or stop request acts after it
# After a longer pause (a suspended process) the grid restarts: the simulated world stood still too.
LONGEST_PAUSE_NS = 1_000_000_000
LATE_NS = 50_000  # lateness beyond that of an ordinary wake-up
# Faster ticks run several at once: a process that is woken more often does little else.
SHORTEST_STEP_NS = 250_000
PENDING_BYTES = 1 << 16  # unread output: BATCH messages of 100 ms and more
OUTPUT_BYTES = 1 << 16  # largest output of a device in one tick
RECEIVED_BYTES = 1 << 12  # largest read from the host
BURST_BYTES = 1 << 12  # output after which a run of ticks ends to write it

# Indices into `grid`, which one call leaves to the next: clock at device time 0 (ns), half of the longest time that one
# pass makes up (ns), time of the last pass (ns), most ticks before Python is called, bytes that wait for the host, 1 if
# the host hung up, 1 if a late tick has waited for the host.
BOOT_NS, STEP_NS, PASSED_NS, MOST, PENDING, HUNG_UP, WAITED = range(7)
GRID = 7

AGAIN, ASK, GONE = range(3)  # result of a call: time is up; Python must act; the host hung up

_UNITS, _UNITS_NS = 2, 125  # 2 units of device time are 125 ns
_receive = native_call(2)
_take = native_call(3)
_INTS, _BYTES = types.int64[::1], types.uint8[::1]
_put, _at = group_at(LoopPort)


@kernel(types.void(types.int64, PORT_TYPE))
def _keep(line: int, port: LoopPort) -> None:
    # To unpack its five functions at each call costs Python most of a tick.
    _put(line, port)


@kernel(types.void(PORT_TYPE, _INTS, _BYTES))
def _flush(port: LoopPort, grid: Any, output: Any) -> None:
    """Write waiting bytes of `output` to the port and keep the rest; a broken port is reported by the next read."""
    sent = port.write(port.handle, np.int64(output.ctypes.data), grid[PENDING])
    if sent > 0:
        for i in range(sent, grid[PENDING]):
            output[i - sent] = output[i]
        grid[PENDING] -= sent


@kernel(types.void(type_of(Lockstep), PORT_TYPE, _INTS, _BYTES))
def _send_output(software: Lockstep, port: LoopPort, grid: Any, output: Any) -> None:
    """Send the device's new output. If the buffer `output` is full, discard all of it, so that no frame is cut."""
    behind = np.int64(output.ctypes.data) + grid[PENDING]
    count = _take(software.take, software.device, behind, OUTPUT_BYTES)
    if grid[HUNG_UP] == 0 and grid[PENDING] + count <= PENDING_BYTES:
        grid[PENDING] += count
    if grid[PENDING] != 0:
        _flush(port, grid, output)


@kernel(types.boolean(type_of(Lockstep), PLANT_TYPE, PORT_TYPE, _INTS, _BYTES, _BYTES))
def _pass_input(
    software: Lockstep, plant: PlantArguments, port: LoopPort, grid: Any, output: Any, received: Any
) -> bool:
    """Pass bytes from the host to the device and send its replies; return False if the port is broken."""
    words, address = software.words, np.int64(received.ctypes.data)
    count = port.read(port.handle, address, RECEIVED_BYTES)
    if count <= 0:
        return bool(count == 0)
    now = (port.now(port.clock_handle) - grid[BOOT_NS]) * _UNITS // _UNITS_NS
    words[RECEIVED_AT] = min(max(words[TIME], now), words[DUE])
    words[BYTES], words[BYTE_COUNT] = address, count
    _receive(software.receive, software.device, software.address)
    if words[CUTS] != 0:
        cut(plant)
    _send_output(software, port, grid, output)
    return True


@kernel(
    types.int64(
        *(type_of(Lockstep), PLANT_TYPE, type_of(OperatorScript), type_of(Wires), type_of(Supplies)),
        *(types.int64, _INTS, _BYTES, _BYTES, types.int64),
    )
)
def keep_time(
    software: Lockstep,
    plant: PlantArguments,
    script: OperatorScript,
    wires: Wires,
    supplies: Supplies,
    line: int,
    grid: Any,
    output: Any,
    received: Any,
    end_ns: int,
) -> int:
    """Run ticks and pass bytes until `end_ns` on the port's clock, or until Python code must act; return the reason.

    The reason is `AGAIN` (time is up), `ASK` (a buffer is used up, or the device was armed or changed its rate) or
    `GONE` (the host hung up). `line` is the address where `_keep` stored the port. `grid` contains what must survive
    between two calls, at the indices `BOOT_NS` to `WAITED`. `output` has `PENDING_BYTES` for bytes that wait to be sent
    to the host and `OUTPUT_BYTES` behind them for new output; `received` has `RECEIVED_BYTES` for bytes from the host.
    """
    words, port = software.words, _at(line)
    while True:
        # Deadlines follow from the device's own clock, so lateness never adds up.
        step_ns = grid[STEP_NS]
        due_ns = grid[BOOT_NS] + words[DUE] * _UNITS_NS // _UNITS
        deadline_ns = max(due_ns, grid[PASSED_NS] + step_ns)
        until_ns = min(deadline_ns, end_ns)
        if grid[HUNG_UP] != 0:  # the port would not wait
            port.sleep(port.clock_handle, until_ns)
            until_ns = 0
        ready = port.wait(port.handle, until_ns)
        if ready >= 0:
            grid[HUNG_UP] = 0
        now_ns = port.now(port.clock_handle)
        late_ns = now_ns - deadline_ns
        if (
            ready > 0
            and not 0 <= late_ns <= LATE_NS
            and not _pass_input(software, plant, port, grid, output, received)
        ):
            ready = -1
        if ready < 0 and grid[HUNG_UP] == 0:
            grid[HUNG_UP] = 1
            return GONE
        if words[RATE_CHANGED] != 0 or words[SWITCHED_ON] != 0:
            return ASK
        # A board's timer is never late, a process is. After a pause of this computer the host may reply first, and
        # bytes that came before the late tick are passed on before it, so that the watchdog is fed first.
        if late_ns > LATE_NS and grid[WAITED] == 0:  # wait once for the host, which was paused too
            grid[WAITED], grid[PASSED_NS] = 1, now_ns - step_ns + step_ns // 4
        elif late_ns >= 0:
            grid[WAITED] = 0
            if now_ns - due_ns > LONGEST_PAUSE_NS:
                grid[BOOT_NS] += now_ns - due_ns
                due_ns = now_ns
            # No tick is left out. Late ones run at twice the pace and no faster, so that a host that was not paused can
            # reply to each and is not considered silent.
            since_boot_ns = min(now_ns, due_ns + 2 * step_ns - 1) - grid[BOOT_NS]
            until = (_UNITS * since_boot_ns + 1) // _UNITS_NS  # rounded down to a unit
            while words[DUE] <= until and grid[MOST] > 0:
                ticks = run_ticks(software, plant, script, wires, supplies, until, grid[MOST], BURST_BYTES)
                grid[MOST] = grid[MOST] - ticks if ticks != 0 else 0
                _send_output(software, port, grid, output)
            grid[PASSED_NS] = now_ns
            if grid[MOST] <= 0:
                return ASK
        if now_ns >= end_ns:
            return AGAIN


class TickedDevice(Protocol):
    """A simulated device whose ticks run in compiled code (`sim_backend.board.lockstep`)."""

    hardware: Hardware

    @property
    def time_ns(self) -> int:
        """Return the device time of the last sample (ns since boot)."""
        ...

    @property
    def elapsed_ns(self) -> int:
        """Return the simulated time since the device was created, over all resets (ns)."""
        ...

    @property
    def rate(self) -> int:
        """Return the tick rate of the device (Hz)."""
        ...

    def compiled(self) -> tuple[Lockstep, World]:
        """Return device and rig in their present state as arguments of the compiled function `lockstep.run_ticks`."""
        ...

    def passed(self, world: World) -> None:
        """Take over the results of compiled ticks, which have changed `world` (from `compiled`)."""
        ...


class BoardTime:
    """Loop that runs a compiled device behind a port, in real time, until `stop` is set.

    Parameters
    ----------
    device
        Device to run.
    port
        Device side of a line. A negative result of its `wait` or `read` means that the host hung up.
    stop
        Ends the run when it is set.
    hung_up
        Called when the host hung up.
    most
        Largest number of ticks between two updates of `device` (`TickedDevice.passed`).
    """

    def __init__(
        self,
        device: TickedDevice,
        port: LoopPort,
        stop: threading.Event,
        *,
        hung_up: Callable[[], None] = lambda: None,
        most: int = NO_END,
    ) -> None:
        prepare(_keep, keep_time, port.read, port.write, port.wait, port.now, port.sleep)
        self.device = device
        self._port = port
        self._line = np.zeros(-(-group_bytes(LoopPort) // 8), np.int64)
        _keep(int(self._line.ctypes.data), port)
        self._stop = stop
        self._hung_up = hung_up
        self._most = most
        self._grid = np.zeros(GRID, np.int64)
        self._output = np.zeros(PENDING_BYTES + OUTPUT_BYTES, np.uint8)
        self._received = np.zeros(RECEIVED_BYTES, np.uint8)
        self._boot_ns = 0

    def run(self, duration_s: float | None) -> None:
        """Run the device in real time for `duration_s` seconds (None: without end), or until `stop` is set."""
        port, grid, line = self._port, self._grid, int(self._line.ctypes.data)
        now_ns = port.now(port.clock_handle)
        end_ns = NO_END if duration_s is None else now_ns + round(duration_s * 1e9)
        self._boot_ns = 0
        grid[BOOT_NS] = grid[PASSED_NS] = now_ns - self.device.elapsed_ns
        why = ASK
        while now_ns < end_ns and not self._stop.is_set():
            if why == ASK:
                software, world = self._renew_supplies()
            why = keep_time(
                software, *world, line, grid, self._output, self._received, min(now_ns + SLICE_NS, end_ns)
            )
            if why == ASK:
                self.device.passed(world)
            elif why == GONE:  # discard its unread bytes: the next host begins with an empty line
                grid[PENDING] = 0
                self._hung_up()
            now_ns = port.now(port.clock_handle)
        if why != ASK:
            self.device.passed(world)

    def _renew_supplies(self) -> tuple[Lockstep, World]:
        """Refill the buffers that ticks use up; return the arguments of `lockstep.run_ticks` for the next ticks."""
        device, grid = self.device, self._grid
        software, world = device.compiled()
        boot_ns = device.elapsed_ns - device.time_ns  # simulated time at the last reset
        grid[BOOT_NS] += boot_ns - self._boot_ns
        self._boot_ns = boot_ns
        period_ns = 1_000_000_000 // device.rate
        grid[STEP_NS] = period_ns // 2 if period_ns >= SHORTEST_STEP_NS else SHORTEST_STEP_NS
        grid[MOST] = min(device.hardware.most_ticks, self._most)
        return software, world
