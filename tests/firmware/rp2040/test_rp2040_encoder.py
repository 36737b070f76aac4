"""The encoder on the Pico (whole binary): counts are exact up to the specified maximum speed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import messages as m
from firmware_protocol.connection import State
from firmware_protocol.faults import Fault, Input
from tests.firmware.rp2040.session import WIDE_OPEN, Session

Powered = Callable[..., Session]

HIGHEST_SPEED = 4_000_000  # counts a second: what the port claims
NANOS = 1e9 / HIGHEST_SPEED
UNIT_NS = 62.5
RATE = 5_000


def streaming(session: Session) -> None:
    """Start a session with one STATE per tick and without a speed limit."""
    session.configure(position_rate=RATE, **WIDE_OPEN)
    session.arm()
    session.host.command(0)
    session.listen(0.002)
    session.host.states.clear()
    session.ticks()


def uneven(counts: int, seed: int) -> list[tuple[int, float]]:
    """Return edges at the highest mean speed, each up to 40 % early or late, as from a poor disc."""
    random = np.random.default_rng(seed)
    way = 1 if counts > 0 else -1
    return [(way, float(NANOS * share)) for share in random.uniform(0.6, 1.4, abs(counts))]


@pytest.mark.parametrize("way", [1, -1])
def test_every_sample_is_a_count_of_the_encoder_at_the_highest_speed(powered: Powered, way: int) -> None:
    session = powered()
    streaming(session)
    session.pico.move((way * 6_000, NANOS))
    session.listen(0.0018)
    session.host.command(0)
    session.listen(0.0022)
    states = session.host.states
    counts = np.array([state.count for state in states])
    assert len(np.unique(counts)) >= 8
    session.check_true(counts, np.array([state.sample_index for state in states]))
    assert session.host.states[-1].count == way * 6_000


def test_no_count_is_lost_on_reversals(powered: Powered) -> None:
    session = powered()
    streaming(session)
    motion: list[tuple[int, float]] = []
    for seed, counts in enumerate((2_000, -1_501, 1, -1, 2, -2, 3, -3, 700, -2_900, 5)):
        motion += uneven(counts, seed)
    motion += [(1, NANOS), (-1, NANOS)] * 1_000  # trembling on one edge
    session.pico.move(*motion)
    for _ in range(3):
        session.listen(0.002)
        session.host.command(0)
    state = session.host.next_state()
    assert state.fault == Fault.NONE
    assert state.count == session.pico.look()["truth"] == sum(counts for counts, _ in motion)


def test_both_channels_at_once_are_a_fault_of_the_encoder(powered: Powered) -> None:
    session = powered()
    streaming(session)
    session.pico.move((100, NANOS))
    session.pico.ask("jump")
    session.listen(0.002)
    state = session.host.states[-1]
    assert state.fault == Fault.ENCODER
    assert state.state == State.FAULT
    assert not session.pico.look()["enabled"]


@pytest.mark.parametrize("wires", [{"unplugged": True}, {"broken": [True, False]}, {"broken": [False, True]}])
def test_a_broken_line_of_two_pairs_is_a_fault_within_five_milliseconds(powered: Powered, wires: Any) -> None:
    session = powered(image="full")
    streaming(session)
    session.pico.move(*[(1, 50_000.0)] * 200)
    session.listen(0.005)
    assert session.host.states[-1].fault == Fault.NONE
    session.listen(0.010)
    session.pico.ask("wires", **wires)
    session.host.command(0)
    session.listen(0.005)
    assert session.host.states[-1].fault == Fault.ENCODER
    assert not session.pico.look()["enabled"]


def test_an_edge_is_dated_within_a_quarter_of_a_microsecond(powered: Powered) -> None:
    session = powered()
    streaming(session)
    dated: list[tuple[int, float]] = []
    for gap_ns in (300_000.0, 1_234_567.0, 5_000_000.0, 43_210.0):  # the fine count wraps in 4.1 ms
        came_ns = session.pico.move((1, gap_ns))
        count = len(dated) + 1
        while not session.host.states or session.host.states[-1].count < count:
            session.host.command(0)
            session.listen(0.0005)
        state = next(state for state in session.host.states if state.count == count)
        tick = session.ticks_of(np.array([state.sample_index]))
        age_ns = (state.device_time - state.edge_time) * UNIT_NS
        dated.append((count, tick.came[0] - age_ns - came_ns))
    late_ns = np.array([late for _, late in dated])
    # The pin shows the tick some cycles before the sample is dated: the same for all.
    assert np.ptp(late_ns) < 250.0, late_ns
    assert np.all(np.abs(late_ns) < 1_000.0), late_ns


EVERY = 400  # counts between two indices
# What PICO.md claims for the count at an index: no more counts a second than this.
INDEX_SPEED = 20_000


def test_the_count_at_an_index_is_exact_up_to_the_speed_that_is_claimed(powered: Powered) -> None:
    """The device checks the index between the ticks of its law; from above the index begins at the same count.

    At the highest speed the count of the index is late by the time between two checks: some ten microseconds.
    """
    session = powered(image="full")
    pico = session.pico
    pico.ask("marks", every=EVERY)

    def seen() -> tuple[int, int]:
        answer = session.host.ask(m.GetReference(session.host.nonce()))
        return answer.index_edges, answer.index_count

    edges, at = seen()[0], 0
    session.begin_law(20_000, 2_000, **WIDE_OPEN)
    session.supervise(0.005)
    for way in (500, -350, -450, 2 * EVERY):
        passed = [
            count
            for count in range(min(at, at + way), max(at, at + way) + 1)
            if count % EVERY == 0 and count != at
        ]
        pico.move((way, 1e9 / INDEX_SPEED))
        session.supervise(abs(way) / INDEX_SPEED + 0.001)
        at += way
        edges += len(passed)
        assert seen() == (edges, passed[-1 if way > 0 else 0])
    session.host.disarm()
    pico.move((EVERY, NANOS))
    session.listen(0.002)
    assert seen()[0] == edges + 1
    next_index = (at // EVERY + 1) * EVERY
    assert next_index <= seen()[1] <= next_index + 60e-6 * HIGHEST_SPEED
    assert session.host.next_state().fault == Fault.NONE


def test_a_limit_switch_is_shown_and_a_broken_wire_of_it_is_pressed(powered: Powered) -> None:
    session = powered(image="full")
    session.configure(**WIDE_OPEN)
    for pressed in (-1, 0, -1):
        session.pico.ask("marks", pressed=pressed)
        session.host.states.clear()
        session.listen(0.025)
        shown = session.host.states[-1].inputs & Input.LIMIT_SWITCH
        assert bool(shown) == (pressed == 0)
