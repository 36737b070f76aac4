"""Shared memory of a running loop: control words, description of the run, mailbox for parameters, ring buffer of rows.

Layout (version 4), every part at a multiple of 64 bytes::

    control words   `WORDS` int64                                 `rig.realtime.control_words`
    info            2 × `INFO_BYTES`; one half is UTF-8 JSON, the other is free
    mailbox         `MAILBOX_BYTES` for `rig.realtime.mailbox`: parameter sets for the loop
    rows            `capacity` rows of `rig.core.sample.ROW`

All processes load and store words through `rig.realtime.atomics`. The info describes experiment, device and recording.
The word INFO contains the length of the JSON in bits 0–19, the used half in bit 20, and the number of changes from bit
32 on. The loop writes row ``HEAD % capacity`` and then publishes HEAD + 1; the recorder copies rows up to HEAD and
publishes TAIL.

Trials, the recorder, `rig set`, the console, LSL and the terminal of a session open the memory. This file must not
import numba before a loop is built. If the layout changes, change `LAYOUT_VERSION` too.
"""

from __future__ import annotations

import json
import mmap
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.core.errors import RigError
from rig.core.sample import ROW
from rig.realtime.control_words import (
    CLOCK,
    CONTROL_BYTES,
    CREATED,
    CREATOR,
    EXCHANGES,
    HEAD,
    INFO,
    LAYOUT_VERSION,
    ROW_BYTES,
    VERSION,
)
from rig.realtime.memories import place

if TYPE_CHECKING:
    from rig.realtime.mailbox import Mailbox

WORDS = CONTROL_BYTES // 8
INFO_BYTES = 65536  # of one half
MAILBOX_BYTES = 2048  # rig.realtime.mailbox needs less, and must not be loaded to find the rows

_INFO_AT = WORDS * 8
_MAILBOX_AT = _INFO_AT + 2 * INFO_BYTES
_ROWS_AT = _MAILBOX_AT + MAILBOX_BYTES
_INFO_LENGTH = 0xFFFFF  # mask of the length of the JSON in the word INFO
_INFO_HALF = 1 << 20  # bit of the used half
_INFO_CHANGES = 32  # lowest bit of the number of changes
_INFO_TRIES = 10  # of a reader that is overtaken by writers


class Ring:
    """Shared memory of one loop, with array views of its parts; a context manager that closes the memory.

    `words` (int64) are the control words, `rows` (`rig.core.sample.ROW`) the ring buffer of samples. `Ring.allocate`
    creates a new memory, `Ring.attach` opens the memory of another process.

    Parameters
    ----------
    buffer
        The whole memory; its address is a multiple of 8.
    descriptor
        Descriptor of the shared memory, which `close` closes; -1 if the memory is not shared.
    """

    def __init__(self, buffer: NDArray[np.uint8], descriptor: int = -1) -> None:
        self.buffer = buffer
        self.descriptor = descriptor
        self.words: NDArray[np.int64] = buffer[:_INFO_AT].view(np.int64)
        rows = max(0, (len(buffer) - _ROWS_AT) // ROW.itemsize)
        self.rows: NDArray[np.void] = buffer[_ROWS_AT : _ROWS_AT + rows * ROW.itemsize].view(ROW)
        self._closed = False

    @classmethod
    def allocate(cls, capacity: int, *, info: Mapping[str, Any] | None = None, shared: bool = False) -> Ring:
        """Return the zeroed memory of a new loop.

        Raise `RigError` if the description is longer than `INFO_BYTES` (64 KiB), or not enough memory is available.

        Parameters
        ----------
        capacity
            Number of rows (samples) in the ring buffer.
        info
            Description of the run for other processes, of JSON types.
        shared
            True: other processes of this user can find and open the memory.
        """
        from rig.realtime.mailbox import clear  # noqa: PLC0415  (numba only when a loop is built)

        text = _json_of(info or {})
        size = _ROWS_AT + capacity * ROW.itemsize
        ring = cls(*_shared_memory(size)) if shared else cls(_plain_memory(size))
        _write_info(ring, text)
        ring.put(CREATED, time.time_ns())
        ring.put(CREATOR, os.getpid())
        ring.put(ROW_BYTES, ROW.itemsize)
        clear(ring.mailbox)
        # Last: a process that finds the block reads VERSION 0 until everything else is there.
        ring.put(VERSION, LAYOUT_VERSION)
        return ring

    @classmethod
    def attach(cls, path: str, *, writable: bool = True) -> Ring:
        """Open the memory of a loop in another process; read-only if `writable` is False.

        `path` is the attribute ``path`` or ``held`` of `rig.realtime.memories.LoopMemory`. Raise `OSError` if the
        process has ended, or belongs to another user, and `RigError` if the file is not the memory of a running loop,
        or is not complete yet.
        """
        descriptor = os.open(path, os.O_RDWR if writable else os.O_RDONLY)
        try:
            if not place.is_memory(path) or not place.is_sound(descriptor):
                raise RigError(
                    f"{path} is not the memory of a running loop",
                    remedy="list the running loops by rig stop --list",
                )
            size = os.fstat(descriptor).st_size
            if size < _INFO_AT:
                raise RigError(
                    f"{path} has {size} bytes, fewer than the memory of a running loop: it may be in creation",
                    remedy="try again",
                )
            ring = cls(_map(descriptor, size, writable=writable), descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        if ring.peek(VERSION) == 0:
            ring.close()
            raise RigError(
                f"the shared memory {path} of a control loop is still being created", remedy="try again"
            )
        return ring

    @property
    def capacity(self) -> int:
        """Return the number of rows (samples) that fit into the ring buffer."""
        return len(self.rows)

    @property
    def closed(self) -> bool:
        """Return True if the memory of this loop was closed."""
        return self._closed

    @property
    def mailbox(self) -> int:
        """Return the memory address of the loop's mailbox; raise `RigError` after `close`, when it may be unmapped."""
        if self._closed:
            raise RigError("the memory of this loop is closed: its run has ended", remedy="start another run")
        return int(self.buffer.ctypes.data) + _MAILBOX_AT

    @property
    def info(self) -> dict[str, Any]:
        """Return the description of the run as JSON types; empty if it is missing or has another memory layout."""
        return self.info_and_word()[0]

    def info_and_word(self) -> tuple[dict[str, Any], int]:
        """Return the description of the run, and a number that changes with it, by which `replace` detects changes."""
        word = self.peek(INFO)
        for _ in range(_INFO_TRIES):
            text = self._info_text(word)
            before, word = word, self.peek(INFO)
            if before == word:  # else it was written to twice meanwhile, perhaps where we read
                with suppress(ValueError):
                    value = json.loads(text)
                    return (value if isinstance(value, dict) else {}), word
                break
        return {}, word

    def get(self, word: int) -> int:
        """Return the control word with index `word` (`rig.realtime.control_words`), after `close` its last value."""
        from rig.realtime.atomics import read_word  # noqa: PLC0415

        return int(read_word(self.words.ctypes.data + 8 * word))

    def put(self, word: int, value: int) -> None:
        """Store `value` in the control word with index `word`; after `close`, other processes do not get the value."""
        from rig.realtime.atomics import write_word  # noqa: PLC0415

        write_word(self.words.ctypes.data + 8 * word, value)

    def peek(self, word: int) -> int:
        """Return the control word with index `word` without loading compiled code.

        The value itself is never half-written, but the load is not ordered with other memory: do not conclude from a
        value that rows or description have been written.
        """
        # `rig stop` must act at once: loading numba takes longer than the run may continue.
        return int(self.words[word])

    def clock_exchange(self) -> tuple[int, tuple[int, ...] | None]:
        """Return the number of clock exchanges, and the four time stamps (ns) of the last exchange or None.

        The stamps are: sent by the host, received by the device, sent by it, received by the host. They are None before
        the first exchange, and if the loop was just overwriting them.
        """
        done = self.get(EXCHANGES)
        place = CLOCK + 4 * ((done - 1) % 2)
        stamps = tuple(self.get(place + i) for i in range(4))
        return done, stamps if done > 0 and self.get(EXCHANGES) == done else None

    def writer(self) -> Mailbox:
        """Return the loop's mailbox, by which the caller can post parameter sets."""
        from rig.realtime.mailbox import Mailbox  # noqa: PLC0415

        return Mailbox(self.mailbox, descriptor=self.descriptor, keep=self.buffer)

    def post(self, values: ArrayLike) -> int:
        """Post a parameter set for the running law, return its number (1, 2, …); `ConfigError` for NaN or too many."""
        from rig.realtime.mailbox import set_bytes  # noqa: PLC0415

        return self.writer().post(set_bytes(values))

    def replace(self, values: ArrayLike, info: Callable[[int], Mapping[str, Any]], word: int) -> int:
        """Post a parameter set and a new description of the run, unless another writer has changed the description.

        Return the number of the set; 0 if another writer has changed the description, and nothing was posted.

        Parameters
        ----------
        values
            The parameter set.
        info
            Function that gets the number of the set and returns the complete new description; it is called at once or
            not at all.
        word
            Number that `info_and_word` returned together with the previous description.
        """
        from rig.realtime.mailbox import set_bytes  # noqa: PLC0415

        writer, message = self.writer(), set_bytes(values)
        with writer.alone():
            if self.get(INFO) != word:
                return 0
            # The info first: after a kill in between, info and set of the next `replace` agree again.
            _write_info(self, _json_of(info(writer.posted + 1)))
            return writer.post_alone(message)

    def _info_text(self, word: int) -> bytes:
        if self._closed or self.peek(VERSION) != LAYOUT_VERSION:
            return b"{}"
        place = _INFO_AT + (INFO_BYTES if word & _INFO_HALF else 0)
        return self.buffer[place : place + min(word & _INFO_LENGTH, INFO_BYTES)].tobytes()

    def last_rows(self, count: int) -> NDArray[np.void]:
        """Return a copy of the newest `count` rows of the ring buffer, oldest first, for the diagnosis of an error."""
        head = self.get(HEAD)
        first = max(0, head - min(count, self.capacity))
        return self.rows[np.arange(first, head) % max(1, self.capacity)].copy()

    def close(self) -> None:
        """Release the memory of this loop; a second call does nothing.

        The control words remain readable with their present values. The memory is freed when no array refers to it any
        more. A thread that has only an address into the memory must end before.
        """
        if self._closed:
            return
        self._closed = True
        # Dropping the references and not unmapping: a thread that still holds `rows` cannot crash.
        self.words = self.words.copy()
        self.rows = np.zeros(0, ROW)
        self.buffer = np.zeros(0, np.uint8)
        if self.descriptor >= 0:
            place.close(self.descriptor)
            self.descriptor = -1

    def __enter__(self) -> Ring:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __del__(self) -> None:
        with suppress(Exception):  # half made, or at the end of the interpreter
            self.close()


def _json_of(info: Mapping[str, Any]) -> bytes:
    text = json.dumps(dict(info)).encode()
    if len(text) > INFO_BYTES:
        raise RigError(
            f"the description of the run has {len(text)} bytes; at most {INFO_BYTES} fit into its memory",
            remedy="shorten the tables (lists of values) of the experiment file",
        )
    return text


def _write_info(ring: Ring, text: bytes) -> None:
    """Write a run's description (JSON) into the unused half of its memory, then publish it by the control word INFO."""
    # Two halves: a reader that has loaded INFO reads a half that no writer touches, unless two changes follow at once.
    word = ring.get(INFO)
    half = ~word & _INFO_HALF
    place = _INFO_AT + (INFO_BYTES if half else 0)
    ring.buffer[place : place + len(text)] = np.frombuffer(text, np.uint8)
    ring.put(INFO, (word >> _INFO_CHANGES) + 1 << _INFO_CHANGES | half | len(text))


def _plain_memory(size: int) -> NDArray[np.uint8]:
    """Return an array of `size` zero bytes of this process, whose address is a multiple of 64 (a cache line)."""
    memory = np.zeros(size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size]


def _shared_memory(size: int) -> tuple[NDArray[np.uint8], int]:
    """Return an array of `size` zero bytes that other processes can find and open, and the memory's descriptor."""
    try:
        descriptor = place.make(size)
        try:
            return _map(descriptor, size), descriptor
        except OSError:
            place.close(descriptor)
            raise
    except OSError as error:
        raise RigError(
            f"cannot allocate {size / 1e6:.0f} MB of shared memory: {error.strerror}",
            remedy="free some memory",
        ) from error


def _map(descriptor: int, size: int, *, writable: bool = True) -> NDArray[np.uint8]:
    """Return an open file as an array in shared memory; it is unmapped when no array refers to it any more."""
    access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
    return np.frombuffer(mmap.mmap(descriptor, size, access=access), np.uint8)
