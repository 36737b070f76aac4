"""Compiled functions that read and write a USB device by libusb transfers, without Python and without the GIL.

`usb_read`, `usb_write` and `usb_wait` have the arguments and results of `rig.realtime.system.descriptor_read`,
`descriptor_write` and `descriptor_wait`. libusb calls `mark_completed` at the end of a transfer, in the thread that
handles events. No call may wait without a bound.

The handle of these functions is the address of a block of int64 words: the fields of `Word`, then a slot (`Slot`) for
each transfer. `rig.devices._usb_queue` fills it with the addresses of libusb's functions, which come from
`rig.devices._usb_handle`; that file also checks the layout of `struct libusb_transfer`.
"""

from enum import IntEnum

from numba import types

from rig.realtime.atomics import load_word, stack_words, store_word
from rig.realtime.kernel import kernel
from rig.realtime.native import native_call
from rig.realtime.plugs import TRANSFER_SIGNATURE, WAIT_SIGNATURE
from rig.realtime.system import BILLION, EINTR, last_error, monotonic_now


class Word(IntEnum):
    """Indices of the fields at the beginning of the block of words that describes a USB link."""

    CONTEXT = 0  # libusb_context *
    SUBMIT = 1  # addresses of libusb_submit_transfer,
    CANCEL = 2  # libusb_cancel_transfer
    HANDLE_EVENTS = 3  # address of libusb_handle_events_timeout_completed
    POLLED = 4  # address of an array of struct pollfd: what libusb wants to be watched
    POLLED_COUNT = 5
    IN_COUNT = 6
    OUT_COUNT = 7
    IN_BYTES = 8  # size of an IN transfer: one packet
    OUT_BYTES = 9  # size of the buffer of an OUT transfer
    IN_HEAD = 10  # the IN transfer with the oldest unread bytes
    IN_TAKEN = 11  # bytes of it that have been read
    IN_ERROR = 12  # errno that ended the pipe, 0 while it lives
    OUT_ERROR = 13
    OUT_LIMIT = 14  # ns that the device may leave the pool exhausted


class Slot(IntEnum):
    """Indices of the fields that describe one USB transfer, in its slot of the block (64-bit words)."""

    TRANSFER = 0  # struct libusb_transfer *
    BUFFER = 1
    STATE = 2
    STARTED = 3  # CLOCK_MONOTONIC, ns


FREE, FLYING, DONE = 0, 1, 2
SLOTS_AT = 16  # words
SLOT_WORDS = 4

# Offsets in struct libusb_transfer, 64 bits, little-endian (rig.devices._usb_handle compares them with pyusb's).
STATUS_AT, LENGTH_AT, ACTUAL_AT, USER_DATA_AT = 16, 20, 24, 40

_i64, _ptr = types.int64, types.uintp
COMPLETED_SIGNATURE = types.void(_ptr)  # of libusb's callback at the end of a transfer
_call_one, _call_three = native_call(1), native_call(3)
_two_words = stack_words(2)
_memcpy = types.ExternalFunction("memcpy", _ptr(_ptr, _ptr, types.uint64))
_ppoll = types.ExternalFunction("ppoll", types.int32(_ptr, types.uint64, _ptr, _ptr))

_CONTEXT, _SUBMIT, _CANCEL, _HANDLE_EVENTS = (
    int(Word[n]) for n in ("CONTEXT", "SUBMIT", "CANCEL", "HANDLE_EVENTS")
)
_POLLED, _POLLED_COUNT, _IN_COUNT, _OUT_COUNT = (
    int(Word[n]) for n in ("POLLED", "POLLED_COUNT", "IN_COUNT", "OUT_COUNT")
)
_IN_BYTES, _OUT_BYTES, _IN_HEAD, _IN_TAKEN = (
    int(Word[n]) for n in ("IN_BYTES", "OUT_BYTES", "IN_HEAD", "IN_TAKEN")
)
_IN_ERROR, _OUT_ERROR, _OUT_LIMIT = (int(Word[n]) for n in ("IN_ERROR", "OUT_ERROR", "OUT_LIMIT"))
_TRANSFER, _BUFFER, _STATE, _STARTED = (int(Slot[n]) for n in ("TRANSFER", "BUFFER", "STATE", "STARTED"))

EIO, ENODEV, EPIPE, EOVERFLOW, ETIMEDOUT, ECANCELED, EREMOTEIO = 5, 19, 32, 75, 110, 125, 121
EINVAL, EACCES, ENOENT, EBUSY, ENOMEM = 22, 13, 2, 16, 12
_INTERRUPTED = -10


# Errno by `enum libusb_transfer_status`, and by the negated `enum libusb_error`.
_OF_STATUS = (0, EIO, ETIMEDOUT, ECANCELED, EPIPE, ENODEV, EOVERFLOW)
_OF_CODE = (0, EIO, EINVAL, EACCES, ENODEV, ENOENT, EBUSY, ETIMEDOUT, EOVERFLOW, EPIPE, EIO, ENOMEM)


@kernel(_i64(_i64))
def errno_of_status(status: int) -> int:
    """Return the errno of an `enum libusb_transfer_status`; 0 for COMPLETED."""
    return _OF_STATUS[status] if 0 <= status < len(_OF_STATUS) else EIO


@kernel(_i64(_i64))
def errno_of_code(code: int) -> int:
    """Return the errno of an `enum libusb_error`, which is negative; 0 for success."""
    if code >= 0:
        return 0
    return _OF_CODE[-code] if -code < len(_OF_CODE) else EIO


@kernel(_i64(_i64, _i64))
def _word(block: int, index: int) -> int:
    return int(load_word(block + 8 * index))


@kernel(types.void(_i64, _i64, _i64))
def _put(block: int, index: int, value: int) -> None:
    store_word(block + 8 * index, value)


@kernel(_i64(_i64, _i64))
def _slot(block: int, index: int) -> int:
    """Return the address of the slot of transfer `index`; IN transfers come first, then OUT transfers."""
    return block + 8 * (SLOTS_AT + SLOT_WORDS * index)


@kernel(_i64(_i64))
def _actual(slot: int) -> int:
    """Return the number of bytes that the transfer of a slot has moved."""
    return int(load_word(_word(slot, _TRANSFER) + ACTUAL_AT)) & 0x7FFFFFFF


@kernel(_i64(_i64))
def _status(slot: int) -> int:
    """Return the errno with which the transfer of a slot ended; 0 without an error."""
    return int(errno_of_status(int(load_word(_word(slot, _TRANSFER) + STATUS_AT)) & 0xFFFFFFFF))


@kernel(_i64(_i64, _i64, _i64))
def _submit(block: int, slot: int, length: int) -> int:
    """Submit the USB transfer of a slot for `length` bytes; return 0 or a positive errno."""
    transfer = _word(slot, _TRANSFER)
    store_word(transfer + STATUS_AT, length << 32)  # status 0; the length is the upper half of this word
    _put(slot, _STARTED, monotonic_now(0))
    _put(slot, _STATE, FLYING)
    error = int(errno_of_code(_call_one(_word(block, _SUBMIT), transfer)))
    if error != 0:
        _put(slot, _STATE, FREE)
    return error


@kernel(_i64(_i64))
def _handle_events(block: int) -> int:
    """Process pending events of libusb without waiting; return 0 or a positive errno."""
    timeval = _two_words()
    store_word(timeval, 0)
    store_word(timeval + 8, 0)
    code = _call_three(_word(block, _HANDLE_EVENTS), _word(block, _CONTEXT), timeval, 0)
    return 0 if code == _INTERRUPTED else int(errno_of_code(code))


@kernel(_i64(_i64))
def _settle_out(block: int) -> int:
    """Mark completed OUT transfers as free; return 0, or the errno of the first OUT transfer that failed."""
    first = _word(block, _IN_COUNT)
    for index in range(first, first + _word(block, _OUT_COUNT)):
        slot = _slot(block, index)
        if _word(slot, _STATE) != DONE:
            continue
        _put(slot, _STATE, FREE)
        error = _status(slot)
        wanted = (load_word(_word(slot, _TRANSFER) + STATUS_AT) >> 32) & 0x7FFFFFFF
        if error == 0 and _actual(slot) < wanted:
            error = EREMOTEIO
        if error != 0 and _word(block, _OUT_ERROR) == 0:
            _put(block, _OUT_ERROR, error)
    return _word(block, _OUT_ERROR)


@kernel(types.void(_i64))
def _pass_head(block: int) -> None:
    """Submit the oldest IN transfer again after its bytes were read; the next IN transfer becomes the oldest."""
    head = _word(block, _IN_HEAD)
    slot = _slot(block, head)
    error = _status(slot)
    _put(slot, _STATE, FREE)
    if error == 0 and _word(block, _IN_ERROR) == 0:
        error = _submit(block, slot, _word(block, _IN_BYTES))
    if error != 0 and _word(block, _IN_ERROR) == 0:
        _put(block, _IN_ERROR, error)
    _put(block, _IN_HEAD, (head + 1) % _word(block, _IN_COUNT))
    _put(block, _IN_TAKEN, 0)


@kernel(_i64(_i64))
def _look(block: int) -> int:
    """Return the number of unread bytes in the oldest IN transfer; 0 without any, or a negative errno."""
    # Bytes that arrived before an error are delivered before it.
    for _ in range(_word(block, _IN_COUNT)):
        slot = _slot(block, _word(block, _IN_HEAD))
        if _word(slot, _STATE) != DONE:
            break
        left = _actual(slot) - _word(block, _IN_TAKEN)
        if left > 0:
            return left
        _pass_head(block)  # an empty packet, or an error without bytes
        if _word(block, _IN_ERROR) != 0:
            break
    error = _word(block, _IN_ERROR)
    if error == 0:
        error = _settle_out(block)
    return -error


@kernel(TRANSFER_SIGNATURE)
def usb_read(block: int, address: int, size: int) -> int:
    """Read up to `size` bytes to memory at `address` without waiting; return their number or a negative errno."""
    total = 0
    fresh = False
    while total < size:
        left = _look(block)
        if left < 0:
            return total if total > 0 else left
        if left == 0:
            if total > 0 or fresh:
                break
            fresh = True
            error = _handle_events(block)
            if error != 0:
                return -error
            continue
        taken = _word(block, _IN_TAKEN)
        slot = _slot(block, _word(block, _IN_HEAD))
        count = min(left, size - total)
        _memcpy(address + total, _word(slot, _BUFFER) + taken, count)
        total += count
        _put(block, _IN_TAKEN, taken + count)
        if count == left:
            _pass_head(block)
    return total


@kernel(_i64(_i64))
def _free_out(block: int) -> int:
    """Return the address of the slot of a free OUT transfer; 0 if all are in transit."""
    first = _word(block, _IN_COUNT)
    for index in range(first, first + _word(block, _OUT_COUNT)):
        slot = _slot(block, index)
        if _word(slot, _STATE) == FREE:
            return slot
    return 0


@kernel(_i64(_i64))
def _oldest_out(block: int) -> int:
    """Return the time (ns) at which the oldest OUT transfer was submitted; call it when no transfer is free."""
    first = _word(block, _IN_COUNT)
    oldest = _word(_slot(block, first), _STARTED)
    for index in range(first + 1, first + _word(block, _OUT_COUNT)):
        oldest = min(oldest, _word(_slot(block, index), _STARTED))
    return oldest


@kernel(TRANSFER_SIGNATURE)
def usb_write(block: int, address: int, size: int) -> int:
    """Queue up to `size` bytes of memory at `address` for sending, without waiting; return their number.

    Return 0 if no transfer is free, or a negative errno: -ETIMEDOUT if the device has accepted nothing for OUT_LIMIT
    (ns).
    """
    error = _settle_out(block)
    if error != 0:
        return -error
    if size <= 0:
        return 0
    # A pool: a COMMAND never waits for the one before, and all STOP frames at the end of a run are sent.
    slot = _free_out(block)
    if slot == 0:
        error = _handle_events(block)
        if error == 0:
            error = _settle_out(block)
        if error != 0:
            return -error
        slot = _free_out(block)
        if slot == 0:
            late_ns = monotonic_now(0) - _oldest_out(block) - _word(block, _OUT_LIMIT)
            return -ETIMEDOUT if late_ns > 0 else 0
    count = min(size, _word(block, _OUT_BYTES))
    _memcpy(_word(slot, _BUFFER), address, count)
    error = _submit(block, slot, count)
    if error != 0:
        _put(block, _OUT_ERROR, error)
        return -error
    return count


@kernel(_i64(_i64, _i64))
def _sleep_until_event(block: int, deadline_ns: int) -> int:
    """Wait for an event of libusb until `deadline_ns` (ns); return 1, 0 if the deadline is in the past, or -errno."""
    timespec = _two_words()
    remaining = deadline_ns - monotonic_now(0)
    if remaining <= 0:
        return 0
    store_word(timespec, remaining // BILLION)
    store_word(timespec + 8, remaining % BILLION)
    # ppoll(2) on libusb's descriptors waits to the nanosecond; libusb's own wait counts in milliseconds.
    ready = _ppoll(_word(block, _POLLED), _word(block, _POLLED_COUNT), timespec, 0)
    if ready < 0:
        error = last_error()
        return 1 if error == EINTR else -error
    return 1


@kernel(WAIT_SIGNATURE)
def usb_wait(block: int, deadline_ns: int) -> int:
    """Wait for received bytes until `deadline_ns` (CLOCK_MONOTONIC, ns); return 1 (bytes), 0 (deadline) or -errno."""
    while True:
        ready = _look(block)
        if ready == 0:
            error = _handle_events(block)
            ready = -error if error != 0 else _look(block)
        if ready != 0:
            return min(ready, 1)
        woken = _sleep_until_event(block, deadline_ns)
        if woken <= 0:
            return woken


@kernel(_i64(_i64))
def start(block: int) -> int:
    """Submit all IN transfers of a USB link, so that it receives; return 0 or a negative errno."""
    # Several, so that no packet waits for the host. One packet each: a full packet ends its transfer as a short one
    # does, so that a frame never waits for its successor and the device need not send empty packets.
    for index in range(_word(block, _IN_COUNT)):
        error = _submit(block, _slot(block, index), _word(block, _IN_BYTES))
        if error != 0:
            _put(block, _IN_ERROR, error)
            return -error
    return 0


@kernel(_i64(_i64))
def _count_flying(block: int) -> int:
    count = 0
    for index in range(_word(block, _IN_COUNT) + _word(block, _OUT_COUNT)):
        count += _word(_slot(block, index), _STATE) == FLYING
    return count


@kernel(_i64(_i64, _i64, _i64))
def flush(block: int, deadline_ns: int, cancel: int) -> int:
    """Wait until `deadline_ns` (ns) for all OUT transfers to end; return the number of those still in transit.

    With `cancel` 1, cancel all IN and OUT transfers first, and wait for all of them.
    """
    if cancel != 0:
        for index in range(_word(block, _IN_COUNT) + _word(block, _OUT_COUNT)):
            slot = _slot(block, index)
            if _word(slot, _STATE) == FLYING:
                _call_one(_word(block, _CANCEL), _word(slot, _TRANSFER))
    while True:
        _handle_events(block)
        left = _count_flying(block)
        if cancel == 0:
            left = 0
            for index in range(_word(block, _OUT_COUNT)):
                left += _word(_slot(block, _word(block, _IN_COUNT) + index), _STATE) == FLYING
        if left == 0 or _sleep_until_event(block, deadline_ns) <= 0:
            return left


@kernel(COMPLETED_SIGNATURE)
def mark_completed(transfer: int) -> None:
    """Store DONE in the word to which a transfer's `user_data` points; libusb calls it when the transfer ends."""
    store_word(load_word(transfer + USER_DATA_AT), DONE)
