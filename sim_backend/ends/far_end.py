"""Provide the device's side of a link in virtual time: compiled `read`, `write` and `wait` for the control loop.

A tick of the loop then runs no Python. Exceptions, for which it calls `serve`: a buffer is used up, the device was
armed or changed its rate, or Python code has used the device since the last tick.
"""

import ctypes
import errno
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple
from weakref import WeakMethod

import numpy as np
from numba import types

from rig.devices.port import LoopPort
from rig.realtime.atomics import load_word, store_word
from rig.realtime.clock import Clock
from rig.realtime.groups import Bytes, Int, Ints, group, group_at, group_bytes, type_of
from rig.realtime.kernel import kernel, prepare
from rig.realtime.native import native_call
from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE
from sim_backend.board.firmware import FirmwareDevice
from sim_backend.board.hardware import World
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
from sim_backend.mechanics.plant import PlantArguments

# Indices into `FarEnd.progress`: 1 if Python used the device last; 1 if the link is closed; bytes that wait for the
# host; bytes lost for lack of room; executed ticks; most ticks before Python is called.
STALE, CLOSED, ARRIVED, DISCARDED, TICKS, MOST = range(6)
PROGRESS = 6

LONGEST_RUN = 10_000  # ticks after which a change that Python makes to the device meanwhile is seen
OUTPUT_BYTES = 1 << 16  # largest output of a device in one tick
_BROKEN = -errno.EIO
_SERVE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_size_t)
_UNITS, _UNITS_NS = 2, 125  # 2 units of device time are 125 ns
_serve = native_call(1)
_receive = native_call(2)
_take = native_call(3)
_move = types.ExternalFunction("memmove", types.uintp(types.uintp, types.uintp, types.uint64))


@group
class FarEnd(NamedTuple):
    """A compiled device with its rig and the line to the host.

    Attributes
    ----------
    software, plant, script, wires, supplies
        Device, rig, motion of the hand, signals and buffers for `sim_backend.board.lockstep.run_ticks`.
    progress
        State of the line (integers), at the indices from `STALE` to `MOST` in this file.
    arrived
        Buffer of bytes for the host: `capacity` bytes, and `OUTPUT_BYTES` behind them for new output.
    capacity
        Largest number of unread bytes; further bytes are lost.
    clock
        Address of the virtual time (ns).
    origin_ns
        Virtual time at which the device booted (ns).
    serve
        Address of the Python callback that refills buffers.
    """

    software: Annotated[Lockstep, type_of(Lockstep)]
    plant: Annotated[PlantArguments, type_of(PlantArguments)]
    script: Annotated[OperatorScript, type_of(OperatorScript)]
    wires: Annotated[Wires, type_of(Wires)]
    supplies: Annotated[Supplies, type_of(Supplies)]
    progress: Ints
    arrived: Bytes
    capacity: Int
    clock: Int
    origin_ns: Int
    serve: Int


FAR_END_TYPE = type_of(FarEnd)
_put, _at = group_at(FarEnd)


@kernel(types.void(types.int64, FAR_END_TYPE))
def put(handle: int, end: FarEnd) -> None:
    """Store a compiled device with its line in the memory at the address `handle`."""
    _put(handle, end)


@kernel(types.int64(types.int64), no_refcount=True)
def _ready(handle: int) -> int:
    """Reload the compiled device at the address `handle` if Python code has used the device; return 0 or -errno."""
    end = _at(handle)
    if end.progress[CLOSED] != 0:
        return _BROKEN
    return int(_serve(end.serve, 0)) if end.progress[STALE] != 0 else 0


@kernel(types.void(FAR_END_TYPE))
def _take_output(end: FarEnd) -> None:
    """Append the device's output to the bytes for the host; bytes beyond `capacity` are lost, as in a driver."""
    progress, arrived = end.progress, end.arrived
    software = end.software
    room = OUTPUT_BYTES
    progress[ARRIVED] += _take(software.take, software.device, arrived.ctypes.data + progress[ARRIVED], room)
    if progress[ARRIVED] > end.capacity:
        progress[DISCARDED] += progress[ARRIVED] - end.capacity
        progress[ARRIVED] = end.capacity


@kernel(types.int64(types.int64, types.int64), no_refcount=True)
def _pass(handle: int, deadline_ns: int) -> int:
    """Run ticks until the device sends bytes, or up to `deadline_ns` on the clock; return 0, or a negative errno."""
    while True:
        end = _at(handle)
        words, progress = end.software.words, end.progress
        until = (_UNITS * (deadline_ns - end.origin_ns) + 1) // _UNITS_NS  # rounded down to a unit
        before = progress[ARRIVED] + progress[DISCARDED]
        ticks = run_ticks(
            end.software, end.plant, end.script, end.wires, end.supplies, until, progress[MOST], 1
        )
        progress[TICKS] += ticks
        progress[MOST] -= ticks
        _take_output(end)
        if progress[ARRIVED] + progress[DISCARDED] != before or words[DUE] > until:
            return 0
        failed = _serve(end.serve, 0)
        if failed != 0:
            return int(failed)


@kernel(types.int64(FAR_END_TYPE), inline=True)
def _next_ns(end: FarEnd) -> int:
    return int(end.origin_ns + end.software.words[DUE] * _UNITS_NS // _UNITS)


@kernel(types.int64(types.int64), no_refcount=True)
def _catch_up(handle: int) -> int:
    """Advance the device to the virtual time, which a sleeping host has moved; return 0, or a negative errno."""
    end = _at(handle)
    now_ns = load_word(end.clock)
    # A host that sleeps on the link's clock finds the device as late as a slow host would.
    while _next_ns(end) <= now_ns:
        failed = _pass(handle, now_ns)
        if failed != 0:
            return int(failed)
        end = _at(handle)
    return 0


@kernel(WAIT_SIGNATURE, no_refcount=True)
def wait(handle: int, deadline_ns: int) -> int:
    """Let virtual time pass until bytes have arrived (return 1) or to the deadline (0), or return a negative errno."""
    failed = _ready(handle)
    if failed == 0:
        failed = _catch_up(handle)
    while failed == 0:
        end = _at(handle)
        if end.progress[ARRIVED] != 0:
            return 1
        if _next_ns(end) > deadline_ns:
            store_word(end.clock, max(load_word(end.clock), deadline_ns))
            return 0
        failed = _pass(handle, deadline_ns)
        end = _at(handle)
        passed_ns = end.origin_ns + end.software.words[TIME] * _UNITS_NS // _UNITS
        store_word(end.clock, max(load_word(end.clock), passed_ns))
    return int(failed)


@kernel(TRANSFER_SIGNATURE, no_refcount=True)
def read(handle: int, address: int, size: int) -> int:
    """Move at most `size` waiting bytes to the memory at `address`; return their number, or a negative errno."""
    failed = _ready(handle)
    if failed != 0:
        return int(failed)
    end = _at(handle)
    progress, start = end.progress, end.arrived.ctypes.data
    count = min(size, progress[ARRIVED])
    progress[ARRIVED] -= count
    _move(address, start, count)
    _move(start, start + count, progress[ARRIVED])
    return int(count)


@kernel(TRANSFER_SIGNATURE, no_refcount=True)
def write(handle: int, address: int, size: int) -> int:
    """Pass `size` bytes at the memory `address` from the host to the device; return `size`, or a negative errno."""
    failed = _ready(handle)
    if failed == 0:
        failed = _catch_up(handle)
    if failed != 0:
        return int(failed)
    end = _at(handle)
    software = end.software
    words = software.words
    now = (load_word(end.clock) - end.origin_ns) * _UNITS // _UNITS_NS
    words[RECEIVED_AT] = max(words[TIME], now)
    words[BYTES], words[BYTE_COUNT] = address, size
    waiting = _receive(software.receive, software.device, software.address)
    if words[CUTS] != 0:
        cut(end.plant)
    if waiting != 0:
        _take_output(end)
    if words[RATE_CHANGED] != 0 or words[SWITCHED_ON] != 0:
        failed = _serve(end.serve, 0)
    return int(failed) if failed != 0 else size


class CompiledPort:
    """A port of a compiled device in virtual time; it moves the device's state between Python and compiled code.

    Parameters
    ----------
    device
        Compiled device. Python code may use it while the loop does not run, after a call of `take_back`.
    clock
        Virtual clock.
    origin_ns
        Returns the virtual time at which the device booted (ns).
    progress, arrived
        Arrays of `FarEnd`, which the link uses too.
    capacity
        Largest number of unread bytes.

    Attributes
    ----------
    failure
        First exception that a Python callback raised inside the loop, or None.
    """

    def __init__(
        self,
        device: FirmwareDevice,
        clock: Clock,
        origin_ns: Callable[[], int],
        *,
        progress: Any,
        arrived: Any,
        capacity: int,
    ) -> None:
        prepare(put, wait, read, write)
        self._device = device
        self._clock = clock
        self._origin_ns = origin_ns
        self._progress, self._arrived, self._capacity = progress, arrived, capacity
        self.failure: BaseException | None = None
        # A callback that held this object would keep a run's memory until Python looks for cycles, many runs later.
        serve = WeakMethod(self._serve)
        self._callback = _SERVE(lambda none: found(none) if (found := serve()) is not None else _BROKEN)
        address = ctypes.cast(self._callback, ctypes.c_void_p).value
        assert address is not None
        self._address = address
        self._memory = np.zeros(-(-group_bytes(FarEnd) // 8), np.int64)
        self._end = self._put()
        self._progress[STALE] = 1

    def port(self) -> LoopPort:
        """Return the compiled functions `read`, `write` and `wait` for the control loop."""
        self.take_back()
        handle = int(self._memory.ctypes.data)
        return LoopPort.on(self._clock, read=read, write=write, wait=wait, handle=handle)

    def take_back(self) -> None:
        """Copy the state after the last tick to the Python device; the loop updates itself before its next tick."""
        if self._progress[STALE] == 0:
            self._note()
            self._progress[STALE] = 1

    def _note(self) -> None:
        end = self._end
        self._device.passed(World(end.plant, end.script, end.wires, end.supplies))

    def _put(self) -> FarEnd:
        device = self._device
        software, (plant, script, wires, supplies) = device.compiled()
        self._progress[MOST] = min(device.hardware.most_ticks, LONGEST_RUN)
        end = FarEnd(
            software=software,
            plant=plant,
            script=script,
            wires=wires,
            supplies=supplies,
            progress=self._progress,
            arrived=self._arrived,
            capacity=self._capacity,
            clock=self._clock.handle,
            origin_ns=self._origin_ns(),
            serve=self._address,
        )
        put(int(self._memory.ctypes.data), end)
        return end

    def _serve(self, _: int) -> int:
        try:
            if self._progress[STALE] == 0:
                self._note()
            self._end = self._put()
            self._progress[STALE] = 0
            return 0
        # No exception can pass through a C callback: the loop ends with EIO, and the link raises this one.
        except BaseException as failure:
            self.failure = self.failure or failure
            return _BROKEN
