"""A transaction advances by replies to its request, repeats it after a timeout, and then fails."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import messages as m
from firmware_protocol.faults import Status
from firmware_protocol.packing import type_id_of
from firmware_protocol.transaction import (
    BEGIN,
    CHUNK,
    CHUNK_BYTES,
    COMMIT,
    DONE,
    ENDLESS,
    MOST_TRIES,
    REFUSED,
    RETRY_AFTER_S,
    UNANSWERED,
    Transaction,
    after_answer,
    after_time,
)

NONCE, MS = 7, 1_000_000
STEPS = st.sampled_from([BEGIN, CHUNK, COMMIT, type_id_of(m.Arm)])
STATUSES = st.sampled_from([int(Status.OK), int(Status.OK), int(Status.INSIDE_WALL), 99])


def answered(t: Transaction, status: int = Status.OK) -> Transaction:
    return after_answer(t, t.nonce, t.step, int(status), t.offset)


def times_sent(most_tries: int, *times_ms: int) -> list[int]:
    """Return the times (ms) at which a request without a reply is sent, of those at which it is checked."""
    t, sent = Transaction(NONCE, 0, BEGIN), []
    for time_ms in times_ms:
        before, t = t, after_time(t, time_ms * MS, most_tries)
        if t.tries > before.tries:
            sent.append(time_ms)
    return sent


@pytest.mark.parametrize("length", [0, 1, CHUNK_BYTES, CHUNK_BYTES + 1, 5 * CHUNK_BYTES])
def test_update_begins_sends_every_byte_once_and_commits(length: int) -> None:
    t, steps, brought = Transaction(NONCE, length, BEGIN), [], 0
    while t.step != DONE:
        steps.append(t.step)
        if t.step == CHUNK:
            assert t.offset == brought
            brought = min(brought + CHUNK_BYTES, length)
        t = answered(t)
    assert brought == length
    assert steps == [BEGIN, *[CHUNK] * -(-length // CHUNK_BYTES), COMMIT]


def test_any_other_transaction_is_one_request() -> None:
    assert answered(Transaction(NONCE, 0, type_id_of(m.Arm))).step == DONE


def test_request_without_a_reply_is_repeated_after_20_40_and_80_ms_and_then_given_up() -> None:
    assert times_sent(MOST_TRIES, *range(1000)) == [0, 20, 60, 140]
    t = Transaction(NONCE, 0, BEGIN)
    for time_ms in range(round(1e3 * (sum(RETRY_AFTER_S) + RETRY_AFTER_S[-1]))):
        t = after_time(t, time_ms * MS, MOST_TRIES)
        assert t.step == BEGIN
    assert after_time(t, 220 * MS, MOST_TRIES).step == UNANSWERED
    assert times_sent(ENDLESS, *range(400)) == [0, 20, 60, 140, 220, 300, 380]


def test_an_answer_makes_the_next_request_due_at_once() -> None:
    t = after_time(Transaction(NONCE, 10, BEGIN), 5 * MS, MOST_TRIES)
    t = answered(t)
    assert (t.step, t.tries) == (CHUNK, 0)
    assert after_time(t, 5 * MS, MOST_TRIES).tries == 1


@given(STEPS, st.integers(0, 200), STATUSES, st.integers(6, 8), STEPS, st.integers(0, 200))
def test_only_the_reply_to_the_current_request_counts(
    step: int, offset: int, status: int, nonce: int, request: int, detail: int
) -> None:
    t = Transaction(NONCE, 200, step, offset, 1, 5)
    late = step == CHUNK and status == Status.OK and detail != offset
    after = after_answer(t, nonce, request, status, detail)
    assert (after == t) == (nonce != NONCE or request != step or late)
    if after != t:
        assert (after.step == REFUSED) == (status != Status.OK)
        assert after.tries == 0


@pytest.mark.parametrize("end", [DONE, REFUSED, UNANSWERED])
def test_ended_transaction_stays_ended(end: int) -> None:
    t = Transaction(NONCE, 0, end)
    assert after_time(t, 10**12, MOST_TRIES) == after_answer(t, NONCE, end, 0, 0) == t
