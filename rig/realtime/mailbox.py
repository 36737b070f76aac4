"""How bytes reach a running loop: a triple buffer that neither side ever waits for.

Three slots hold one message each: the writer fills one, one is posted (the mail), the reader copies from one. One word
assigns them, and every change of owner is one compare-and-exchange of it::

    bits 0–1  the writer's slot       bits 4–5  the reader's slot
    bits 2–3  the slot in the mail    bit  6    FRESH: the mail has not been read
    bits 8–62 number of the newest message posted

A slot has one owner at any moment, so a message is never torn.

Layout from the address of the mailbox: that word and 56 bytes of padding, then three slots of `SLOT_BYTES`: number
and length (bytes) as int64, `MOST_BYTES` bytes, padding. What the bytes mean is between writer and reader; a set of
parameters is float64s (`set_bytes`).

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
    """Return the address at which a slot begins."""
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
    """State after the writer's slot has been posted: the mail is fresh, and what lay there is the writer's."""
    mail = state >> 2 & 3
    return (state >> NUMBER) + 1 << NUMBER | FRESH | (state & 3 << 4) | writers_slot(state) << 2 | mail


@kernel(_i64(_i64), inline=True)
def state_after_claiming(state: int) -> int:
    """State after the reader has taken the fresh mail and left its own slot there."""
    mail = state >> 2 & 3
    return state >> NUMBER << NUMBER | mail << 4 | readers_slot(state) << 2 | writers_slot(state)


@kernel(_i64(_address, _bytes))
def fill(mailbox: int, message: Any) -> int:
    """Write a message of whole words into the writer's slot; returns the number that it will have."""
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
    """Post the writer's slot; returns its number."""
    # Twice at most: only the writer makes mail fresh and the reader moves fresh mail alone. A writer that is killed
    # before leaves its own slot half filled, which is never read: the word is the only shared state.
    while True:
        state = load_word(mailbox)
        after = state_after_publishing(state)
        if compare_exchange_word(mailbox, state, after) != 0:
            return int(after >> NUMBER)


@kernel(_i64(_address))
def claim(mailbox: int) -> int:
    """Take the mail if it is fresh; returns the reader's slot, or -1 when there is nothing new."""
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
    """Copy the bytes of a slot, as many as there are and fit; returns the number of the message."""
    place = slot_address(mailbox, slot)
    target = into.ctypes.data
    for at in range(0, min(load_word(place + _WORD), len(into)), _WORD):
        store_word(target + at, load_word(place + _BYTES + at))
    return int(load_word(place))


@kernel(_i64(_address, _bytes))
def take(mailbox: int, into: Any) -> int:
    """Take the newest message, if there is one that was not taken before. For the loop: it never waits.

    Parameters
    ----------
    mailbox
        Address (`rig.realtime.ring.Ring.mailbox`).
    into
        Where the bytes go, whole words that begin at one; what the message does not fill stays as it is, what does not
        fit is left out.

    Returns
    -------
    int
        Number of the message, from 1 on; 0 when nothing is new, and `into` is as it was.
    """
    slot = claim(mailbox)
    if slot < 0:
        return 0
    return int(copy_message(mailbox, slot, into))


@kernel(_i64(_address, _bytes))
def post_message(mailbox: int, message: Any) -> int:
    """`fill` and `publish`: one writer at a time."""
    fill(mailbox, message)
    return int(publish(mailbox))


def set_bytes(values: ArrayLike) -> bytes:
    """Return the bytes of a set of parameters for a loop.

    Raises `ConfigError` for more than `SET_FLOATS` numbers, or one that is NaN.
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
            f"parameter {place} for a running loop is not a number", remedy="give finite values"
        )
    return numbers.tobytes()


def clear(mailbox: int) -> None:
    """Make an empty mailbox of zeroed memory."""
    write_word(mailbox, EMPTY)


class Mailbox:
    """The writer's side.

    Parameters
    ----------
    address
        Address of the mailbox.
    descriptor
        Descriptor of the shared memory with the mailbox, which separates the writers of several processes; -1 for
        memory of this process only.
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
        """Post a message of `MOST_BYTES` at most for the loop; it replaces one that was not taken yet.

        Returns
        -------
        int
            Its number: 1 for the first message ever posted here, and so on.

        Raises
        ------
        RigError
            Another process holds the mailbox, stopped in the middle.
        """
        with self.alone():
            return self.post_alone(message)

    def post_alone(self, message: bytes) -> int:
        """Post a message as `post` does; the caller must hold `alone`."""
        words = np.zeros(-(-len(message) // _WORD) * _WORD, np.uint8)
        words[: len(message)] = np.frombuffer(message, np.uint8)
        assert len(words) <= MOST_BYTES
        return int(post_message(self._address, words))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other writers away, of this process and of others, for as long as the block takes."""
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
    """Wait for the other writers, which may be paused in the middle but not forever."""
    deadline = time.monotonic() + PATIENCE_S
    while not locks.lock(descriptor):
        if time.monotonic() > deadline:
            raise RigError(
                "another process holds the lock of this loop's parameters and does not release it",
                remedy="end the other `rig set`, and try again",
            )
        time.sleep(0.001)
