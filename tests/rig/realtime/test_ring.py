"""Shared words and the ring: rows that one thread publishes without the GIL arrive whole and in order."""

import fcntl
import gc
import os
import threading
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba import types

from rig.core.errors import RigError
from rig.core.sample import ROW
from rig.realtime import control_words
from rig.realtime._anonymous_memory import LINK, NAME
from rig.realtime.atomics import exchange_word, load_word, read_word, store_word, write_word
from rig.realtime.kernel import kernel, prepare
from rig.realtime.mailbox import MAILBOX_BYTES
from rig.realtime.ring import INFO_BYTES, WORDS, Ring
from rig.realtime.ring import MAILBOX_BYTES as RING_MAILBOX_BYTES
from rig.realtime.system import monotonic_now, sleep_until

ROWS = types.Array(numba.from_dtype(ROW), 1, "C")
PATIENCE_NS = 20_000_000_000  # a broken publication must fail a test, not hang it
JOIN_S = 30.0


@kernel(types.int64(types.uintp, ROWS, types.int64))
def produce(control: Any, rows: Any, count: Any) -> Any:
    """Write rows in order as a loop does, waiting for room; return how often the ring was full."""
    full, deadline = 0, monotonic_now(0) + PATIENCE_NS
    for n in range(count):
        while n - load_word(control + 8 * control_words.TAIL) >= len(rows):
            full += 1
            if monotonic_now(0) > deadline:
                return -1
            sleep_until(monotonic_now(0) + 10_000)  # a busy machine may have one core for both
        row = rows[n % len(rows)]
        row["tick"] = n
        row["count"] = -3 * n
        row["position"] = 0.5 * n
        row["applied_at"] = n + 7
        store_word(control + 8 * control_words.HEAD, n + 1)
    return full


@kernel(types.int64(types.uintp))
def spin_until_stopped(control: Any) -> Any:
    """Poll the stop word without the GIL until it is set, and return it."""
    deadline = monotonic_now(0) + PATIENCE_NS
    turns = 0
    while load_word(control + 8 * control_words.STOP) == 0:
        turns += 1
        if turns % 1_000_000 == 0 and monotonic_now(0) > deadline:
            return -1
    return load_word(control + 8 * control_words.STOP)


@kernel(types.int64(types.uintp, types.int64, types.int64))
def trade_tokens(mailbox: Any, token: Any, times: Any) -> Any:
    for _ in range(times):
        token = exchange_word(mailbox, token)
    return token


def in_thread(function: Any, *arguments: Any) -> Any:
    prepare(function)
    results = []
    thread = threading.Thread(target=lambda: results.append(function(*arguments)), daemon=True)
    thread.start()
    return thread, results


def descriptors_of_rings() -> Any:
    found = 0
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            found += os.readlink(f"/proc/self/fd/{name}") == LINK
    return found


def path_of(ring: Any) -> Any:
    return f"/proc/self/fd/{ring.descriptor}"


def mappings_of_rings() -> Any:
    return Path("/proc/self/maps").read_text().count(f"memfd:{NAME}")


@pytest.mark.parametrize("shared", [False, True])
def test_a_new_ring_is_empty_and_says_its_layout(shared: bool) -> None:
    with Ring.allocate(10, shared=shared) as ring:
        assert ring.get(control_words.VERSION) == control_words.LAYOUT_VERSION
        assert ring.get(control_words.ROW_BYTES) == ROW.itemsize
        assert abs(ring.get(control_words.CREATED) - time.time_ns()) < 60e9
        assert ring.capacity == 10
        assert ring.get(control_words.CREATOR) == os.getpid()
        written = ("VERSION", "ROW_BYTES", "CREATED", "INFO", "CREATOR")
        named = {getattr(control_words, name) for name in written}
        assert not any(ring.get(word) for word in range(WORDS) if word not in named)
        assert not ring.rows.view(np.uint8).any()
        assert ring.info == {}
        assert MAILBOX_BYTES <= RING_MAILBOX_BYTES
        assert ring.buffer.ctypes.data % 64 == ring.mailbox % 64 == ring.rows.ctypes.data % 64 == 0


def test_a_ring_with_other_rows_has_another_version() -> None:
    """A console reads loops of other processes, which may run an older version of this package.

    If this fails, increment `LAYOUT_VERSION`, or the console confuses columns; then write both values here.
    """
    columns = sha256(repr(ROW.descr).encode()).hexdigest()[:12]
    assert (control_words.LAYOUT_VERSION, columns) == (4, "46f16a755a8a")


def test_every_control_word_has_a_place_of_its_own() -> None:
    source = Path(control_words.__file__).read_text().partition("# word ")[2]
    places = {
        (name := line.partition(" = ")[0]): getattr(control_words, name)
        for line in source.splitlines()
        if line[:1].isupper()
    }
    assert all(getattr(control_words, name) == place for name, place in places.items())
    assert len(set(places.values())) == len(places) > 20
    assert all(0 <= place < WORDS for place in places.values())
    assert [places[name] for name in ("VERSION", "HEAD", "TAIL", "STOP")] == [0, 1, 2, 3]  # in all versions


def test_another_opening_of_shared_memory_sees_the_same_words_rows_and_info() -> None:
    info = {"url": "serial:///dev/ttyACM0", "experiment": {"wall": {"stiffness": 560.0}}, "name": "Prüfstand"}
    with Ring.allocate(100, info=info, shared=True) as ring:
        ring.rows["tick"][99] = 5
        with Ring.attach(path_of(ring)) as other:
            assert other.info == info
            assert other.capacity == 100
            assert other.rows["tick"][99] == 5
            other.put(control_words.STOP, 3)
            assert ring.get(control_words.STOP) == 3
        assert other.closed
        ring.put(control_words.STOP, 4)
        assert other.get(control_words.STOP) == 3  # what it was when that side closed


def test_shared_memory_is_gone_with_its_last_user() -> None:
    before = descriptors_of_rings(), mappings_of_rings()
    ring = Ring.allocate(1000, shared=True)
    rows = ring.rows
    assert mappings_of_rings() == before[1] + 1
    ring.close()
    ring.close()
    rows["tick"][999] = 3  # a thread that still looks: its memory is there
    assert rows["tick"][999] == 3
    del rows
    assert (descriptors_of_rings(), mappings_of_rings()) == before


def test_ring_without_close_leaves_nothing_either() -> None:
    gc.collect()  # rings of other tests
    before = descriptors_of_rings(), mappings_of_rings()
    Ring.allocate(10, shared=True)
    gc.collect()
    assert (descriptors_of_rings(), mappings_of_rings()) == before


@pytest.mark.parametrize("shared", [False, True])
def test_closed_ring_is_empty_and_isolated(shared: bool) -> None:
    ring = Ring.allocate(4, info={"a": 1}, shared=shared)
    ring.put(control_words.HEAD, 3)
    ring.close()
    assert (ring.get(control_words.HEAD), ring.capacity, ring.info, ring.closed) == (3, 0, {}, True)
    assert len(ring.last_rows(10)) == 0
    ring.put(control_words.STOP, 1)
    with pytest.raises(RigError, match="closed"):
        ring.post([1.0])


def test_too_much_info_is_one_clear_line() -> None:
    with pytest.raises(RigError, match=r"65\d+ bytes; at most 65536 fit"):
        Ring.allocate(1, info={"a": "x" * 65536})


def test_other_memory_and_vanished_memory_are_refused_without_harm(tmp_path: Path) -> None:
    before = descriptors_of_rings()
    plain = os.memfd_create("something-else", os.MFD_CLOEXEC)
    small = os.memfd_create(NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    fcntl.fcntl(small, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
    growing = os.memfd_create(NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(growing, 10**6)
    half = os.memfd_create(NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(half, 10**6)
    fcntl.fcntl(half, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
    try:
        for descriptor, why in (
            (plain, "not the memory"),
            (small, "fewer than the memory"),
            (growing, "not the memory"),  # its owner could shrink it while it is mapped
            (half, "still being created"),
        ):
            with pytest.raises(RigError, match=why):
                Ring.attach(f"/proc/self/fd/{descriptor}")
    finally:
        for descriptor in (plain, small, growing, half):
            os.close(descriptor)
    with pytest.raises(FileNotFoundError):
        Ring.attach(f"/proc/self/fd/{half}")
    assert descriptors_of_rings() == before


def test_damaged_info_is_no_info() -> None:
    ring = Ring.allocate(1, info={"a": 1})
    half = ring.get(control_words.INFO) & 1 << 20
    place = WORDS * 8 + (INFO_BYTES if half else 0)
    for text in (b"{", b"\xff\xfe", b"[1]", b""):
        ring.buffer[place : place + len(text)] = np.frombuffer(text, np.uint8)
        ring.put(control_words.INFO, half | len(text))
        assert ring.info == {}
    ring.put(control_words.INFO, -5)
    assert ring.info == {}


def test_info_changes_only_from_its_newest_version() -> None:
    with Ring.allocate(1, info={"n": 0}, shared=True) as ring, Ring.attach(path_of(ring)) as other:
        for n in range(1, 5):
            (seen, word), (_, stale) = ring.info_and_word(), other.info_and_word()
            assert seen == {"n": n - 1}
            assert ring.replace([n], lambda number: {"n": number}, word) == n
            assert other.info == {"n": n}
            assert other.replace([99.0], lambda number: {"n": 99}, stale) == 0
            assert other.info == {"n": n}


def test_info_is_never_seen_half_written() -> None:
    """A writer changes the info as fast as it can; each reading is one whole mapping, none older than the last."""
    ring = Ring.allocate(1, info={"n": 0, "text": ""})
    done = threading.Event()

    def write() -> None:
        n = 0
        while not done.is_set():
            n += 1
            ring.replace([n], lambda n: {"n": n, "text": str(n) * (n % 50)}, ring.info_and_word()[1])

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    newest, seen, deadline = 0, 0, time.monotonic() + JOIN_S
    while seen < 300 and time.monotonic() < deadline:
        info = ring.info
        if not info:  # changed during ten attempts: empty, not invented
            continue
        assert info["text"] == str(info["n"]) * (info["n"] % 50)
        assert info["n"] >= newest
        seen += info["n"] > newest
        newest = info["n"]
        time.sleep(0)
    done.set()
    thread.join(JOIN_S)
    assert seen > 0


@pytest.mark.parametrize("value", [0, 1, -1, 2**63 - 1, -(2**63)])
def test_a_word_holds_any_64_bit_value(value: Any) -> None:
    word = np.zeros(3, np.int64)
    write_word(word.ctypes.data + 8, value)
    assert read_word(word.ctypes.data + 8) == value
    assert word.tolist() == [0, value, 0]


def test_a_reader_sees_every_row_whole_and_in_order_while_the_loop_writes() -> None:
    """The ring has 64 rows, so it wraps hundreds of times under both threads."""
    ring, count = Ring.allocate(64), 50_000
    thread, full = in_thread(produce, ring.words.ctypes.data, ring.rows, count)
    tail = 0
    while tail < count:
        head = ring.get(control_words.HEAD)
        if head == tail:
            if not thread.is_alive() and ring.get(control_words.HEAD) == tail:
                break
            time.sleep(0)
            continue
        assert tail < head <= tail + ring.capacity
        n = np.arange(tail, head)
        seen = ring.rows[n % ring.capacity]
        assert (seen["tick"] == n).all()
        assert (seen["count"] == -3 * n).all()
        assert (seen["position"] == 0.5 * n).all()
        assert (seen["applied_at"] == n + 7).all()
        tail = head
        ring.put(control_words.TAIL, tail)
    thread.join(JOIN_S)
    assert tail == count
    assert full[0] > 0  # the producer did meet a full ring


def test_a_store_into_the_stop_word_ends_a_loop_that_never_takes_the_gil() -> None:
    """A compiler could move a plain load out of the loop, which then would never stop."""
    ring = Ring.allocate(1)
    thread, result = in_thread(spin_until_stopped, ring.words.ctypes.data)
    thread.join(0.02)
    assert thread.is_alive()
    ring.put(control_words.STOP, 5)
    thread.join(JOIN_S)
    assert result == [5]


def test_exchanged_words_are_neither_lost_nor_doubled() -> None:
    mailbox, times = np.array([100], np.int64), 200_000
    traders = [in_thread(trade_tokens, mailbox.ctypes.data, token, times) for token in (1, 2, 3)]
    for thread, _ in traders:
        thread.join(JOIN_S)
    held = [result[0] for _, result in traders]
    assert sorted([*held, int(mailbox[0])]) == [1, 2, 3, 100]


@pytest.mark.parametrize(
    ("written", "asked", "expected"),
    [
        (0, 5, []),
        (3, 5, [0, 1, 2]),
        (3, 2, [1, 2]),
        (11, 3, [8, 9, 10]),
        (11, 100, [3, 4, 5, 6, 7, 8, 9, 10]),
        (11, 0, []),
    ],
)
def test_last_rows_are_a_copy_oldest_first(written: int, asked: int, expected: Any) -> None:
    ring = Ring.allocate(8)
    for n in range(written):
        ring.rows["tick"][n % 8] = n
    ring.put(control_words.HEAD, written)
    rows = ring.last_rows(asked)
    ring.rows["tick"] = -1
    assert rows["tick"].tolist() == expected
