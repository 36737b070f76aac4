"""The mailbox: under any interleaving of two processes, sets arrive whole and in order, and the newest arrives."""

import fcntl
import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import types

from rig.core.errors import ConfigError, RigError
from rig.realtime import mailbox
from rig.realtime.atomics import write_word
from rig.realtime.kernel import kernel
from rig.realtime.mailbox import (
    EMPTY,
    FRESH,
    MAILBOX_BYTES,
    NUMBER,
    SET_FLOATS,
    Mailbox,
    set_bytes,
    take,
)
from rig.realtime.ring import Ring
from rig.realtime.system import monotonic_now

PATIENCE_NS = 20_000_000_000
JOIN_S = 30.0


class Box:
    def __init__(self) -> None:
        self.memory = np.zeros(MAILBOX_BYTES // 8, np.int64)
        self.address = self.memory.ctypes.data
        mailbox.clear(self.address)

    @property
    def state(self) -> int:
        return int(self.memory[0])


def slots_of(state: int) -> tuple[int, int, int]:
    return state & 3, state >> 2 & 3, state >> 4 & 3


def take_numbers(address: int, into: np.ndarray) -> int:
    return int(take(address, into.view(np.uint8)))


# One side at a time -----------------------------------------------------------------------------------


def test_sets_are_numbered_from_one_and_each_is_taken_once() -> None:
    box, into = Box(), np.zeros(4)
    writer = Mailbox(box.address)
    assert take_numbers(box.address, into) == 0
    assert writer.posted == 0
    assert writer.post(set_bytes([1.0, 2.0, 3.0, 4.0])) == 1
    assert take_numbers(box.address, into) == 1
    assert into.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert take_numbers(box.address, into) == 0
    assert into.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert [writer.post(set_bytes([n])) for n in range(5)] == [2, 3, 4, 5, 6]
    assert writer.posted == 6
    assert take_numbers(box.address, into) == 6
    assert into.tolist() == [4.0, 2.0, 3.0, 4.0]  # what the set does not fill stays


@given(st.lists(st.floats(allow_nan=False), max_size=SET_FLOATS), st.integers(0, SET_FLOATS))
def test_floats_pass_bit_for_bit_within_the_readers_room(values: list[float], room: int) -> None:
    box = Box()
    memory = np.full(room + 2, -7.0)
    assert Mailbox(box.address).post(set_bytes(values)) == 1
    assert take_numbers(box.address, memory[1 : room + 1]) == 1
    count = min(len(values), room)
    assert memory[1 : count + 1].tobytes() == np.array(values[:count], np.float64).tobytes()
    assert (memory[[0, *range(count + 1, room + 2)]] == -7.0).all()


@pytest.mark.parametrize("values", [[float("nan")], [1.0, float("nan")], np.zeros(SET_FLOATS + 1)])
def test_set_with_nan_or_too_many_values_is_refused(values: list[float]) -> None:
    box = Box()
    with pytest.raises(ConfigError):
        Mailbox(box.address).post(set_bytes(values))
    assert box.state == EMPTY


# Two sides, every interleaving of a small case ------------------------------------------------------------

WIDTH = 2  # numbers in a set: enough to be torn
POSTS, TAKES, KILLS = 4, 4, 2


class World(NamedTuple):
    """State of a model of the mailbox: shared memory and both sides' program counters, one atomic action a step."""

    state: int
    slots: tuple[tuple[int, ...], ...]  # each: the number of the set, then the set
    place: int = 0  # of the writer
    seen: int = 0
    tries: int = 0
    posts: int = 0
    kills: int = 0
    read_place: int = 0
    read_seen: int = 0
    taken: tuple[int, ...] = ()
    last: int = 0  # newest set taken
    takes: int = 0
    at_start: int = 0  # newest set posted before this take began


def write_step(w: World) -> World:
    """Step the writer: load the state, store number and values, load again, swap."""
    if w.posts == POSTS:
        return w
    if w.place == 0:
        return w._replace(place=1, seen=w.state, tries=0)
    number = (w.seen >> NUMBER) + 1
    if w.place <= 1 + WIDTH:
        slot = w.seen & 3
        values = list(w.slots[slot])
        values[w.place - 1] = number
        return w._replace(slots=(*w.slots[:slot], tuple(values), *w.slots[slot + 1 :]), place=w.place + 1)
    if w.place == 2 + WIDTH:
        return w._replace(place=w.place + 1, seen=w.state)
    if w.state != w.seen:
        assert w.tries == 0, "the writer failed twice in one post"
        return w._replace(place=2 + WIDTH, tries=1)
    return w._replace(state=mailbox.state_after_publishing.py_func(w.state), place=0, posts=w.posts + 1)


def kill_step(w: World) -> World:
    """Kill the writer (kill -9); a new one starts from the beginning."""
    return w._replace(place=0, seen=0, tries=0, kills=w.kills + 1) if w.place and w.kills < KILLS else w


def read_step(w: World) -> World:  # noqa: PLR0911  (one for each step of the program)
    """Step the reader: load the state, swap, copy the set word by word."""
    if w.takes == TAKES:
        return w
    if w.read_place == 0:
        if not w.state & FRESH:
            assert w.last == w.state >> NUMBER, "the newest set has not arrived, and nothing is fresh"
            return w._replace(takes=w.takes + 1)
        return w._replace(read_place=1, read_seen=w.state, at_start=w.state >> NUMBER)
    if w.read_place == 1:
        if w.state != w.read_seen:
            return w._replace(read_place=0)
        return w._replace(state=mailbox.state_after_claiming.py_func(w.state), read_place=2, taken=())
    slot = w.read_seen >> 2 & 3
    taken = (*w.taken, w.slots[slot][len(w.taken)])
    if len(taken) <= WIDTH:
        return w._replace(taken=taken)
    assert len(set(taken)) == 1, f"torn: {taken}"
    assert taken[0] > w.last, "older than one already seen"
    assert taken[0] >= w.at_start, "older than what was posted before"
    return w._replace(read_place=0, taken=(), last=taken[0], takes=w.takes + 1)


def test_every_interleaving_of_four_posts_and_four_takes_with_writers_killed_anywhere() -> None:
    empty = (0,) * (1 + WIDTH)
    start = World(EMPTY, (empty, empty, empty))
    known, open_ends, finals = {start}, [start], set()
    while open_ends:
        world = open_ends.pop()
        assert sorted(slots_of(world.state)) == [0, 1, 2]
        after = {step(world) for step in (write_step, read_step, kill_step)} - {world}
        if not after:
            finals.add((world.posts, world.last, bool(world.state & FRESH)))
        for new in after - known:
            known.add(new)
            open_ends.append(new)
    assert len(known) > 10_000  # the search did search
    assert {posts for posts, _, _ in finals} == {POSTS}
    # The newest was taken, or it lies there fresh for the next take: nothing that was last is ever lost.
    assert all(last == POSTS or fresh for _, last, fresh in finals)
    assert {last for _, last, _ in finals} == set(range(POSTS + 1))


# Two sides, the machine code -------------------------------------------------------------------------------


def test_a_slow_reader_keeps_its_set_and_what_a_killed_writer_had_filled_is_never_taken() -> None:
    box, into = Box(), np.zeros(2)
    writer = Mailbox(box.address)
    writer.post(set_bytes([1.0, 1.5]))
    slot = mailbox.claim(box.address)
    for number in (2.0, 3.0, 4.0):
        writer.post(set_bytes([number, number]))
    mailbox.fill(box.address, np.array([9.0, 9.5]).view(np.uint8))  # and no `publish`
    assert mailbox.copy_message(box.address, slot, into.view(np.uint8)) == 1
    assert into.tolist() == [1.0, 1.5]
    assert take_numbers(box.address, into) == 4
    assert into.tolist() == [4.0, 4.0]
    assert writer.post(set_bytes([5.0])) == 5
    assert sorted(slots_of(box.state)) == [0, 1, 2]


@kernel(types.int64(types.uintp, types.uint8[::1], types.float64[::1], types.int64, types.uintp))
def read_until(address: Any, message: Any, into: Any, newest: Any, found: Any) -> Any:  # type: ignore[no-untyped-def]
    """Read sets until the newest arrives; store the numbers of sets, torn sets and old sets at `found`."""
    last, deadline = 0, monotonic_now(0) + PATIENCE_NS
    sets = torn = old = 0
    while last < newest and monotonic_now(0) < deadline:
        number = take(address, message)
        if number == 0:
            continue
        sets += 1
        old += number <= last
        last = number
        for i in range(len(into)):
            torn += into[i] != number + i / 128
    write_word(found, sets)
    write_word(found + 8, torn)
    write_word(found + 16, old)
    return last


@kernel(types.int64(types.uintp, types.uint8[::1], types.float64[::1], types.int64))
def write_many(address: Any, message: Any, values: Any, times: Any) -> Any:  # type: ignore[no-untyped-def]
    number = 0
    for n in range(times):
        for i in range(len(values)):
            values[i] = n + 1 + i / 128
        number = mailbox.post_message(address, message)
    return number


def test_two_threads_hammer_the_mailbox_without_the_gil() -> None:
    box, times = Box(), 20_000
    into, values, found = np.zeros(SET_FLOATS), np.zeros(SET_FLOATS), np.zeros(3, np.int64)
    results: list[int] = []
    reader = threading.Thread(
        target=lambda: results.append(
            read_until(box.address, into.view(np.uint8), into, times, found.ctypes.data)
        ),
        daemon=True,
    )
    reader.start()
    assert write_many(box.address, values.view(np.uint8), values, times) == times
    reader.join(JOIN_S)
    sets, torn, old = found.tolist()
    assert results == [times]  # the last one arrived
    assert (torn, old) == (0, 0)
    assert 1 <= sets <= times
    assert into.tolist() == [times + i / 128 for i in range(SET_FLOATS)]


def test_many_writers_in_threads_get_numbers_of_their_own() -> None:
    box, into = Box(), np.zeros(2)

    def write(who: int) -> list[int]:
        writer = Mailbox(box.address)
        return [writer.post(set_bytes([float(who), float(n)])) for n in range(500)]

    with ThreadPoolExecutor(4) as threads:
        numbers = list(threads.map(write, range(4)))
    assert sorted(itertools.chain(*numbers)) == list(range(1, 2001))
    assert all(mine == sorted(mine) for mine in numbers)
    assert take_numbers(box.address, into) == 2000
    assert into[1] == 499.0


# Writers in several processes: the lock ---------------------------------------------------------------------


def test_a_writer_of_another_process_is_waited_for_but_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second opening of the memory stands for another process, because locks belong to openings."""
    monkeypatch.setattr(mailbox, "PATIENCE_S", 0.05)
    with Ring.allocate(1, shared=True) as ring, Ring.attach(f"/proc/self/fd/{ring.descriptor}") as other:
        fcntl.flock(other.descriptor, fcntl.LOCK_EX)
        with pytest.raises(RigError, match="does not release the lock"):
            ring.post([1.0])
        assert Mailbox(ring.mailbox).posted == 0
        fcntl.flock(other.descriptor, fcntl.LOCK_UN)
        assert ring.post([1.0]) == 1
        assert other.post([2.0]) == 2
        into = np.zeros(1)
        assert take_numbers(ring.mailbox, into) == 2
        assert into[0] == 2.0
