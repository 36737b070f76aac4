"""The simulated device, compiled: without Python in its tick where no C compiler makes the firmware.

It is `device.SimulatedDevice` with its memory, whose ticks and COMMANDs kernels take, through the functions by address
of `lockstep.Lockstep`. They run the functions of `ticks`, as Python does in the readable device, and the compiled codec
makes the frames. Python is asked where a fault is to be latched, and for all bytes but a whole COMMAND, the next one of
a session that runs.

It mirrors `sim_backend.firmware.FirmwareDevice`, which is the same for the firmware.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress
from typing import Annotated, Any, NamedTuple

import numpy as np
from numba import types

from firmware_protocol.connection import State
from rig.core.errors import ConfigError
from rig.core.model import RigModel
from rig.realtime.codec import (
    COMMAND,
    FRAME_BYTES,
    HEAD,
    RAW_BYTES,
    decode_command,
    decode_frame,
    encode_state,
    find_delimiter,
)
from rig.realtime.groups import Bytes, Int, Ints, group, group_at, group_bytes, type_of
from rig.realtime.kernel import kernel, prepare
from rig.realtime.native import address_of, native_call
from sim_backend.device import MODES, SimulatedDevice
from sim_backend.firmware import FirmwareDevice
from sim_backend.firmware_library import library
from sim_backend.hardware import World
from sim_backend.lockstep import (
    BYTE_COUNT,
    BYTES,
    COUNT,
    CUTS,
    MEASURED,
    RATE_CHANGED,
    RECEIVED_AT,
    SESSION,
    SWITCHED_ON,
    Lockstep,
    run_ticks,
)
from sim_backend.safety import flat
from sim_backend.ticks import OWN, Board, drive, is_too_old, obey, report, sample

OUTPUT_BYTES = 1 << 16  # that wait for the host; a STATE without room is lost

# Of `Ends.counters`: bytes that wait for the host; sequences of the next STATE and of the newest COMMAND (−1: none);
# frames taken since Python counted them; whether no frame has come in part.
SAID, NEXT_STATE, NEWEST_COMMAND, FRAMES, WHOLE = range(5)
COUNTERS = 5

_LATCH, _HEAR = range(2)  # what Python is asked
_ASK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_size_t)
_HALF = types.int32(types.uintp, types.uintp)  # half a tick: (device, words), both by address
_TAKE = types.int32(types.uintp, types.uintp, types.uintp)
_RUNNING, _LAST_MODE = int(State.RUNNING), max(MODES)
_NS, _UNITS = 125, 2  # of device time: 62.5 ns
_ask = native_call(1)
_move = types.ExternalFunction("memmove", types.uintp(types.uintp, types.uintp, types.uint64))


@group
class Ends(NamedTuple):
    """A device behind an address.

    Attributes
    ----------
    board
        Its memory.
    counters
        By the constants of this file.
    said
        Bytes that wait for the host.
    frame, raw, header, command
        Room for a frame, and for what is in it.
    python
        Address of the callback.
    """

    board: Annotated[Board, type_of(Board)]
    counters: Ints
    said: Bytes
    frame: Bytes
    raw: Bytes
    header: Ints
    command: Ints
    python: Int


_put, _at = group_at(Ends)


@kernel(types.void(types.int64, type_of(Ends)))
def put(address: int, ends: Ends) -> None:
    """Let an address stand for a device."""
    _put(address, ends)


@kernel(_HALF, no_refcount=True)
def lockstep_drive(device: int, words: int) -> int:
    """First half: the current for the coming tick."""
    ends = _at(device)
    current = drive(ends.board)
    if ends.board.words[OWN.found] != 0:
        _ask(ends.python, _LATCH)
    return np.int32(current)  # type: ignore[return-value]


@kernel(_HALF, no_refcount=True)
def lockstep_sample(device: int, words: int) -> int:
    """Second half, when the world has moved: the sample that is due. The bytes that wait for the host."""
    ends = _at(device)
    board, counters = ends.board, ends.counters
    sample(board)
    if board.words[OWN.found] != 0:
        _ask(ends.python, _LATCH)
    if report(board):
        sequence = counters[NEXT_STATE]
        counters[NEXT_STATE] = (sequence + 1) & 0xFFFF
        size = encode_state(board.words[SESSION], sequence, board.state, ends.frame)
        if size > 0 and counters[SAID] + size <= OUTPUT_BYTES:
            _move(ends.said.ctypes.data + counters[SAID], ends.frame.ctypes.data, size)
            counters[SAID] += size
    return np.int32(counters[SAID])  # type: ignore[return-value]


@kernel(types.boolean(type_of(Ends)))
def _obeyed(ends: Ends) -> bool:
    """Take what the host has sent if it is the one COMMAND that is expected, and nothing else."""
    board, counters, frame = ends.board, ends.counters, ends.frame
    words, command = board.words, ends.command
    size = words[BYTE_COUNT]
    if words[OWN.protocol_state] != _RUNNING or counters[WHOLE] == 0 or size > len(frame):
        return False
    _move(frame.ctypes.data, words[BYTES], size)
    if find_delimiter(frame, 0, size) != size - 1:
        return False
    length = decode_frame(frame, 0, size - 1, ends.raw)
    if length < 0 or decode_command(ends.raw, length, ends.header, command) != 0:
        return False
    sequence = ends.header[HEAD.sequence]
    if ends.header[HEAD.session] != words[SESSION] or sequence != (counters[NEWEST_COMMAND] + 1) & 0xFFFF:
        return False
    mode = command[COMMAND.mode]
    lifetime_us, answered = command[COMMAND.lifetime_us], command[COMMAND.state_sequence]
    if mode > _LAST_MODE or is_too_old(board, mode, lifetime_us, counters[NEXT_STATE], answered):
        return False
    counters[NEWEST_COMMAND] = sequence
    counters[FRAMES] += 1
    flags, current = command[COMMAND.flags], command[COMMAND.current]
    obey(board, sequence, mode, flags, current, lifetime_us)
    return True


@kernel(_HALF, no_refcount=True)
def lockstep_receive(device: int, words: int) -> int:
    """Between two ticks: take all bytes of the host. The bytes that wait for the host."""
    ends = _at(device)
    changes = ends.board.words
    changes[CUTS] = changes[RATE_CHANGED] = changes[SWITCHED_ON] = 0
    if not _obeyed(ends):
        _ask(ends.python, _HEAR)
    return np.int32(ends.counters[SAID])  # type: ignore[return-value]


@kernel(_TAKE, no_refcount=True)
def lockstep_take(device: int, address: int, room: int) -> int:
    """Move bytes that wait for the host to an address; how many."""
    ends = _at(device)
    counters, start = ends.counters, ends.said.ctypes.data
    size = min(np.int64(room), counters[SAID])
    counters[SAID] -= size
    _move(address, start, size)
    _move(start, start + size, counters[SAID])
    return np.int32(size)  # type: ignore[return-value]


class CompiledDevice(SimulatedDevice):
    """The simulated device for compiled ticks: `compiled` and `passed` as of `sim_backend.firmware.FirmwareDevice`.

    Parameters and attributes are those of `SimulatedDevice`.
    """

    def __init__(self, model: RigModel, **options: Any) -> None:
        super().__init__(model, **options)
        prepare(put, run_ticks)
        self._counters = flat(np.int64, COUNTERS)
        self._said = np.zeros(OUTPUT_BYTES, np.uint8)
        self._callback = _ASK(self._asked)
        self._failure: BaseException | None = None
        self._world: World | None = None  # while compiled ticks have it
        self._ends = Ends(  # kept, because only its address is elsewhere
            board=Board(**{name: np.asarray(view) for name, view in self.board._asdict().items()}),
            counters=np.asarray(self._counters),
            said=self._said,
            frame=np.zeros(FRAME_BYTES, np.uint8),
            raw=np.zeros(RAW_BYTES, np.uint8),
            header=np.zeros(len(HEAD), np.int64),
            command=np.zeros(len(COMMAND), np.int64),
            python=ctypes.cast(self._callback, ctypes.c_void_p).value or 0,
        )
        self._memory = np.zeros(-(-group_bytes(Ends) // 8), np.int64)
        put(self._memory.ctypes.data, self._ends)
        self._lockstep = Lockstep(
            drive=address_of(lockstep_drive, _HALF),
            sample=address_of(lockstep_sample, _HALF),
            receive=address_of(lockstep_receive, _HALF),
            take=address_of(lockstep_take, _TAKE),
            device=self._memory.ctypes.data,
            address=self._ends.board.words.ctypes.data,
            words=self._ends.board.words,
        )

    def compiled(self) -> tuple[Lockstep, World]:
        """Return what compiled ticks take of the device and its rig as they are now."""
        words, hardware = self.board.words, self.hardware
        words[COUNT], words[MEASURED] = hardware.count, hardware.measured  # also before the first tick
        self._lend()
        self._world = hardware.world(self._truth)
        return self._lockstep, self._world

    def passed(self, world: World) -> None:
        """Take note of what has happened to what `compiled` returned; a second time there is nothing."""
        if self._world is not None:
            self.hardware.passed(self._lockstep, world, self._truth)
            self._world = None
            self._take_back()

    def run(self, until_ns: int, most: int) -> tuple[bytes, int]:
        """Let ticks pass until there is something to say; see `SimulatedDevice.run`."""
        until = (_UNITS * (until_ns - self._epoch_ns) + 1) // _NS  # the last unit that is not later
        ticks, ran = 0, 1
        self._lend()
        while ran and ticks < most and not self._counters[SAID]:
            ran = self.hardware.run(self._lockstep, until, most - ticks, 1, self._truth)
            ticks += ran
        self._take_back()
        said = self._said[: self._counters[SAID]].tobytes()
        self._counters[SAID] = 0
        return said, ticks

    def _lend(self) -> None:
        if self._failure is not None:
            raise self._failure
        counters = self._counters
        counters[NEXT_STATE], counters[NEWEST_COMMAND], counters[WHOLE] = self.connection.lend_streams()

    def _take_back(self) -> None:
        counters = self._counters
        self.connection.take_streams(counters[NEXT_STATE], counters[NEWEST_COMMAND], counters[FRAMES])
        counters[FRAMES] = 0

    def _asked(self, what: int) -> int:
        """Do for compiled ticks what they leave to Python; what it raises they raise when they begin anew: soon."""
        try:
            if what == _LATCH:
                self._heed()
            else:
                self._hear()
        except BaseException as failure:
            self._failure = self._failure or failure
            self._counters[WHOLE] = 0  # the next COMMAND comes here too, and then they begin anew
        return 0

    def _hear(self) -> None:
        words, counters = self.board.words, self._counters
        words[SWITCHED_ON] = 1  # the world may have changed: whoever lets ticks pass takes it anew
        assert self._world is not None
        self.passed(self._world)
        data = ctypes.string_at(words[BYTES], words[BYTE_COUNT])
        answers = self.receive(data, received_at=words[RECEIVED_AT])
        end = min(counters[SAID] + len(answers), OUTPUT_BYTES)  # what has no room is lost, as at a port
        self._said[counters[SAID] : end] = np.frombuffer(answers, np.uint8)[: end - counters[SAID]]
        counters[SAID] = end


def device_for(
    model: RigModel, firmware: bool | None, **options: Any
) -> SimulatedDevice | CompiledDevice | FirmwareDevice:
    """Return the device that stands for a rig: the firmware (True), the readable one (False), or the best there is.

    That is the firmware without its laws where this machine can compile it, else the compiled device. `options` are
    those of `SimulatedDevice`. Raises `ConfigError` as the devices do, and for firmware that cannot be compiled.
    """
    if firmware:
        return FirmwareDevice(model, **options)
    if firmware is None:
        with suppress(ConfigError):
            return FirmwareDevice(model, law_maximum=0, library=library(), **options)
        return CompiledDevice(model, **options)
    return SimulatedDevice(model, **options)
