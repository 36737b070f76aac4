"""Triple buffer that passes messages (bytes) from other processes to a running loop; neither side waits for the other.

There are three slots, each with room for one message. The writer fills the first slot, the second contains the posted
message (the mail), the reader copies from the third. One 64-bit word assigns the slots; each change of owner is one
compare-and-exchange of this word::

    bits 0–1  the writer's slot       bits 4–5  the reader's slot
    bits 2–3  the mail's slot         bit  6    FRESH: the reader has not read the mail
    bits 8–62 number of the newest message posted

A slot has one owner at any moment, so the reader never sees a half-written message.

Layout from the address of the mailbox: this word and 56 bytes of padding, then three slots of `SLOT_BYTES`: number and
length (bytes) of the message as int64, `MOST_BYTES` bytes, padding. Writer and reader define the meaning of the bytes;
a parameter set of a law consists of float64 numbers (`set_bytes`).

The loop and the ring use it; `rig set` and the console reach it through the ring. Kernels here allocate nothing and
never wait.
"""

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

MOST_BYTES = 512  # longest message
SET_FLOATS = MOST_BYTES // 8  # most law parameters in one message
SLOTS = 3
HEAD_BYTES = 64  # a cache line for the word alone
SLOT_BYTES = 576  # two words, the bytes, padding to cache lines
MAILBOX_BYTES = HEAD_BYTES + SLOTS * SLOT_BYTES
ATTEMPTS = 4  # of `claim`
PATIENCE_S = 1.0  # how long a writer waits for another one, who needs microseconds

FRESH = 1 << 6
NUMBER = 8  # lowest bit of the message number
EMPTY = 0 | 1 << 2 | 2 << 4  # each slot where it begins, nothing posted

_WORD = 8  # bytes
_BYTES = 2 * _WORD  # offset of the message in a slot, after its number and length
_i64, _address, _bytes = types.int64, types.uintp, types.uint8[::1]
# A lock on a descriptor excludes other processes but not other threads of this one.
_writers = threading.Lock()


@kernel(_i64(_address, _i64), inline=True)
def slot_address(mailbox: int, slot: int) -> int:
    """Return the address of the first byte of slot `slot` (0 to 2) in the mailbox at address `mailbox`."""
    return mailbox + HEAD_BYTES + SLOT_BYTES * slot


@kernel(_i64(_i64), inline=True)
def writers_slot(state: int) -> int:
    """Return the number (0 to 2) of the slot that the writer may fill; `state` is the mailbox's first word."""
    return state & 3


@kernel(_i64(_i64), inline=True)
def readers_slot(state: int) -> int:
    """Return the number (0 to 2) of the slot from which the reader may copy; `state` is the mailbox's first word."""
    return state >> 4 & 3


@kernel(_i64(_i64), inline=True)
def state_after_publishing(state: int) -> int:
    """Return the mailbox's first word after the writer has posted its slot; `state` is the word before.

    The writer's slot becomes the mail, marked FRESH with the next number; the writer gets the old mail's slot.
    """
    mail = state >> 2 & 3
    return (state >> NUMBER) + 1 << NUMBER | FRESH | (state & 3 << 4) | writers_slot(state) << 2 | mail


@kernel(_i64(_i64), inline=True)
def state_after_claiming(state: int) -> int:
    """Return the mailbox's first word after the reader has taken the mail; `state` is the word before.

    The reader gets the mail's slot; the reader's old slot becomes the mail, without the mark FRESH.
    """
    mail = state >> 2 & 3
    return state >> NUMBER << NUMBER | mail << 4 | readers_slot(state) << 2 | writers_slot(state)


@kernel(_i64(_address, _bytes))
def fill(mailbox: int, message: Any) -> int:
    """Copy a message (a multiple of 8 bytes) into the writer's slot; return the number that `publish` will return."""
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
    """Post the message that `fill` wrote into the mailbox's writer slot; return the number of the message."""
    # The exchange fails at most once: only a claim of the reader changes the word in between, and the reader claims a
    # message once. A writer that is killed before it leaves its own slot half filled, which is never read.
    while True:
        state = load_word(mailbox)
        after = state_after_publishing(state)
        if compare_exchange_word(mailbox, state, after) != 0:
            return int(after >> NUMBER)


@kernel(_i64(_address))
def claim(mailbox: int) -> int:
    """Take the newest message of a mailbox for the reader; return its slot (0 to 2), or -1 without a new message."""
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
    """Copy the message in `slot` to the array `into`, as many bytes as fit; return the number of the message."""
    place = slot_address(mailbox, slot)
    target = into.ctypes.data
    for at in range(0, min(load_word(place + _WORD), len(into)), _WORD):
        store_word(target + at, load_word(place + _BYTES + at))
    return int(load_word(place))


@kernel(_i64(_address, _bytes))
def take(mailbox: int, into: Any) -> int:
    """Copy the newest message of a mailbox to the array `into`, without waiting, unless it was taken before.

    `into` consists of whole aligned 8-byte words; bytes after the end of the message are not changed, a longer message
    is cut off. Return the number of the message, from 1 on; 0 if there is no new message, and `into` is then unchanged.
    """
    slot = claim(mailbox)
    if slot < 0:
        return 0
    return int(copy_message(mailbox, slot, into))


@kernel(_i64(_address, _bytes))
def post_message(mailbox: int, message: Any) -> int:
    """Post a message (a multiple of 8 bytes) and return its sequence number (1, 2, …). Only one writer at a time."""
    fill(mailbox, message)
    return int(publish(mailbox))


def set_bytes(values: ArrayLike) -> bytes:
    """Return the mailbox message (float64 bytes) with law parameters; raise `ConfigError` for NaN or too many."""
    numbers = np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
    if len(numbers) > SET_FLOATS:
        raise ConfigError(
            f"the law has {len(numbers)} parameters; a running loop accepts at most {SET_FLOATS}",
            remedy="use a law with fewer parameters",
        )
    if np.isnan(numbers).any():
        place = int(np.isnan(numbers).argmax())
        raise ConfigError(
            f"parameter {place} (counted from 0) for the running law is NaN, not a number",
            remedy="give a finite number",
        )
    return numbers.tobytes()


def clear(mailbox: int) -> None:
    """Make zeroed memory at address `mailbox` an empty mailbox."""
    write_word(mailbox, EMPTY)


class Mailbox:
    """The writer's side of a mailbox: posts messages for a running loop.

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
        """Return the number of the newest message in this mailbox, from any process; 0 before the first message."""
        return int(read_word(self._address)) >> NUMBER

    def post(self, message: bytes) -> int:
        """Post a message of at most `MOST_BYTES` (512) bytes and return its number, 1 for the first of this mailbox.

        It replaces a message that the loop has not read yet. Raise `RigError` if another process does not release the
        lock of the mailbox.
        """
        with self.alone():
            return self.post_alone(message)

    def post_alone(self, message: bytes) -> int:
        """Post a message for the loop; return its number. Call it only while `Mailbox.alone` excludes other writers."""
        words = np.zeros(-(-len(message) // _WORD) * _WORD, np.uint8)
        words[: len(message)] = np.frombuffer(message, np.uint8)
        assert len(words) <= MOST_BYTES
        return int(post_message(self._address, words))

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Exclude all other writers of this mailbox, in this process and in other processes, within this context."""
        with _writers:
            if self._descriptor < 0:
                yield
                return
            _acquire_lock(self._descriptor)
            try:
                yield
            finally:
                locks.unlock(self._descriptor)


def _acquire_lock(descriptor: int) -> None:
    """Lock a mailbox's shared memory against other writers; raise `RigError` if it is not free within 1 s."""
    deadline = time.monotonic() + PATIENCE_S
    while not locks.lock(descriptor):
        if time.monotonic() > deadline:
            raise RigError(
                f"another process does not release the lock of this loop's parameters within {PATIENCE_S} s",
                remedy="end the other `rig set` command, and try again",
            )
        time.sleep(0.001)
