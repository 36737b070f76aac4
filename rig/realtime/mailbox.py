"""Triple buffer that passes messages (bytes) to a running loop; neither side waits for the other.

There are three slots of one message each: the writer fills the first, the second is posted (the mail), the reader
copies from the third. One word assigns the slots; each change of owner is one compare-and-exchange of this word::

    bits 0–1  the writer's slot       bits 4–5  the reader's slot
    bits 2–3  the slot in the mail    bit  6    FRESH: the mail has not been read
    bits 8–62 number of the newest message posted

A slot has one owner at any moment, so a message is never torn.

Layout from the address of the mailbox: this word and 56 bytes of padding, then three slots of `SLOT_BYTES`: number and
length (bytes) of the message as int64, `MOST_BYTES` bytes, padding. Writer and reader define the meaning of the bytes;
a parameter set consists of float64 numbers (`set_bytes`).

The loop and the ring use it; `rig set` and the console reach it through the ring. Kernels here allocate nothing and
never wait.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike

from rig.core import locks
from rig.core.errors import ConfigError, RigError
from rig.realtime.atomics import compare_exchange_word, load_word, read_word, store_word, write_word
from rig.realtime.kernel import kernel

MOST_BYTES = 512
SET_FLOATS = MOST_BYTES // 8
SLOTS = 3
HEAD_BYTES = 64  # a cache line: the word shares it with nothing
SLOT_BYTES = 576  # two words, the bytes, padding to cache lines
MAILBOX_BYTES = HEAD_BYTES + SLOTS * SLOT_BYTES
ATTEMPTS = 4
PATIENCE_S = 1.0  # how long a writer waits for another one, who needs microseconds

FRESH = 1 << 6
NUMBER = 8  # shift
EMPTY = 0 | 1 << 2 | 2 << 4  # each slot where it begins, nothing posted

_WORD = 8
_BYTES = 2 * _WORD  # place of the bytes in a slot
_i64, _address, _bytes = types.int64, types.uintp, types.uint8[::1]
# A lock on a descriptor excludes other processes but not other threads of this one.
_writers = threading.Lock()


@kernel(_i64(_address, _i64), inline=True)
def slot_address(mailbox: int, slot: int) -> int:
    """Return the address of the first byte of a slot."""
    return mailbox + HEAD_BYTES + SLOT_BYTES * slot


@kernel(_i64(_i64), inline=True)
def writers_slot(state: int) -> int:
    """Return the slot that the writer may fill."""
    return state & 3


@kernel(_i64(_i64), inline=True)
def readers_slot(state: int) -> int:
    """Return the slot that the reader may copy from."""
    return state >> 4 & 3


@kernel(_i64(_i64), inline=True)
def state_after_publishing(state: int) -> int:
    """Return the word after the writer has posted its slot: fresh mail; the writer owns the old mail's slot."""
    mail = state >> 2 & 3
    return (state >> NUMBER) + 1 << NUMBER | FRESH | (state & 3 << 4) | writers_slot(state) << 2 | mail


@kernel(_i64(_i64), inline=True)
def state_after_claiming(state: int) -> int:
    """Return the word after the reader has taken the fresh mail: the old slot of the reader becomes the mail's slot."""
    mail = state >> 2 & 3
    return state >> NUMBER << NUMBER | mail << 4 | readers_slot(state) << 2 | writers_slot(state)


@kernel(_i64(_address, _bytes))
def fill(mailbox: int, message: Any) -> int:
    """Write a message of whole 8-byte words into the writer's slot; return the number that it gets when posted."""
    state = load_word(mailbox)
    number = (state >> NUMBER) + 1
    slot = slot_address(mailbox, writers_slot(state))
    source = message.ctypes.data
    store_word(slot, number)
    store_word(slot + _WORD, len(message))
    for at in range(0, len(message), _WORD):
        store_word(slot + _BYTES + at, load_word(source + at))
    return int(number)


@kernel(_i64(_address))
def publish(mailbox: int) -> int:
    """Post the message in the writer's slot; return its number."""
    # Twice at most: only the writer makes mail fresh and the reader moves fresh mail alone. A writer that is killed
    # before leaves its own slot half filled, which is never read: the word is the only shared state.
    while True:
        state = load_word(mailbox)
        after = state_after_publishing(state)
        if compare_exchange_word(mailbox, state, after) != 0:
            return int(after >> NUMBER)


@kernel(_i64(_address))
def claim(mailbox: int) -> int:
    """Take the mail if it is fresh; return the reader's slot, or -1 if there is no new message."""
    # A bounded number of attempts, since the loop must not spin: after these a newer message is being posted.
    for _ in range(ATTEMPTS):
        state = load_word(mailbox)
        if state & FRESH == 0:
            return -1
        after = state_after_claiming(state)
        if compare_exchange_word(mailbox, state, after) != 0:
            return int(readers_slot(after))
    return -1


@kernel(_i64(_address, _i64, _bytes))
def copy_message(mailbox: int, slot: int, into: Any) -> int:
    """Copy the message of a slot into `into`, as many bytes as fit; return the number of the message."""
    place = slot_address(mailbox, slot)
    target = into.ctypes.data
    for at in range(0, min(load_word(place + _WORD), len(into)), _WORD):
        store_word(target + at, load_word(place + _BYTES + at))
    return int(load_word(place))


@kernel(_i64(_address, _bytes))
def take(mailbox: int, into: Any) -> int:
    """Copy the newest message, unless it was taken before. The loop calls it; it never waits.

    Parameters
    ----------
    mailbox
        Address of the mailbox (`rig.realtime.ring.Ring.mailbox`).
    into
        Destination, whole aligned 8-byte words. Bytes after the end of the message are not changed; a longer message
        is cut off.

    Returns
    -------
    int
        Number of the message, from 1 on; 0 if there is no new message, and `into` is then unchanged.
    """
    slot = claim(mailbox)
    if slot < 0:
        return 0
    return int(copy_message(mailbox, slot, into))


@kernel(_i64(_address, _bytes))
def post_message(mailbox: int, message: Any) -> int:
    """Write a message by `fill` and post it by `publish`; return its number. Only one writer at a time may call it."""
    fill(mailbox, message)
    return int(publish(mailbox))


def set_bytes(values: ArrayLike) -> bytes:
    """Return the message with a parameter set for a running loop.

    Raises `ConfigError` for more than `SET_FLOATS` numbers, or if a number is NaN.
    """
    numbers = np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
    if len(numbers) > SET_FLOATS:
        raise ConfigError(
            f"{len(numbers)} parameters for a running loop; it accepts at most {SET_FLOATS}",
            remedy="use a law with fewer parameters",
        )
    if np.isnan(numbers).any():
        place = int(np.isnan(numbers).argmax())
        raise ConfigError(
            f"parameter {place} for a running loop is NaN, not a number", remedy="give a finite number"
        )
    return numbers.tobytes()


def clear(mailbox: int) -> None:
    """Initialise zeroed memory as an empty mailbox."""
    write_word(mailbox, EMPTY)


class Mailbox:
    """A mailbox for its writers.

    Parameters
    ----------
    address
        Address of the mailbox.
    descriptor
        Descriptor of the shared memory; a lock on it excludes writers of other processes. -1 for memory of this process
        only.
    keep
        Owner of the memory, which must live as long as this object.
    """

    def __init__(self, address: int, *, descriptor: int = -1, keep: object = None) -> None:
        self._address = address
        self._descriptor = descriptor
        self._keep = keep

    @property
    def posted(self) -> int:
        """Return the number of the newest message posted by any process; 0 before the first."""
        return int(read_word(self._address)) >> NUMBER

    def post(self, message: bytes) -> int:
        """Post a message of at most `MOST_BYTES` bytes; it replaces a message that the loop has not taken yet.

        Returns
        -------
        int
            Number of the message, 1 for the first message of this mailbox.

        Raises
        ------
        RigError
            Another process holds the lock of the mailbox and does not release it.
        """
        with self.alone():
            return self.post_alone(message)

    def post_alone(self, message: bytes) -> int:
        """Post a message and return its number; the caller must be within the context `alone`."""
        words = np.zeros(-(-len(message) // _WORD) * _WORD, np.uint8)
        words[: len(message)] = np.frombuffer(message, np.uint8)
        assert len(words) <= MOST_BYTES
        return int(post_message(self._address, words))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Exclude other writers of this process and of other processes within this context."""
        with _writers:
            if self._descriptor < 0:
                yield
                return
            _lock(self._descriptor)
            try:
                yield
            finally:
                locks.unlock(self._descriptor)


def _lock(descriptor: int) -> None:
    """Lock the descriptor; raise `RigError` if another writer does not release the lock within `PATIENCE_S`."""
    deadline = time.monotonic() + PATIENCE_S
    while not locks.lock(descriptor):
        if time.monotonic() > deadline:
            raise RigError(
                "another process holds the lock of this loop's parameters and does not release it",
                remedy="end the other `rig set`, and try again",
            )
        time.sleep(0.001)
