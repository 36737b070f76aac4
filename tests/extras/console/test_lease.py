"""Only one page operates the console, while its heartbeats arrive."""

import pytest

from rig.extras.console.lease import BEAT_S, LOOK_S, LOST_S, Lease


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def taken() -> tuple[Clock, Lease]:
    clock = Clock()
    lease = Lease(clock)
    lease.take("one")
    return clock, lease


def test_the_first_operates_and_the_others_look_on() -> None:
    lease = Lease(Clock())
    assert lease.take("one")
    assert lease.take("one")
    assert not lease.take("two")
    lease.release("two")
    assert lease.held().by == "one"
    lease.release("one")
    assert lease.take("two")


def test_a_page_that_is_silent_loses_it_once() -> None:
    clock, lease = taken()
    gone, silent_s = None, 0.0
    while gone is None:
        lease.beat("two")  # has no effect on the operator
        clock.now += LOOK_S
        silent_s += LOOK_S
        assert lease.held().overdue == (silent_s > BEAT_S)
        gone = lease.expire()
    assert gone == "one"
    assert LOST_S < silent_s < LOST_S + 2 * LOOK_S
    assert lease.expire() is None
    assert lease.held().by is None


def test_a_server_that_did_not_listen_counts_no_silence() -> None:
    clock, lease = taken()
    clock.now += 10.0  # a computer that had no time for it: beats wait in the socket
    assert lease.expire() is None
    lease.beat("one")
    clock.now += LOOK_S
    assert lease.expire() is None
    assert lease.held().by == "one"


@pytest.mark.parametrize("each_s", [LOOK_S, 0.11, 0.35, 0.8, 1.5])
def test_a_server_that_is_late_at_every_look_lengthens_the_lease_by_one_of_them(each_s: float) -> None:
    clock, lease = taken()
    begun = clock.now
    while lease.expire() is None:
        assert clock.now - begun <= LOST_S + each_s, "two looks after it was lost"
        clock.now += each_s
    assert clock.now - begun > LOST_S


def test_a_server_that_is_always_late_keeps_a_page_that_beats() -> None:
    clock, lease = taken()
    for _ in range(50):
        clock.now += 1.2
        assert lease.expire() is None
        lease.beat("one")  # what waited in the socket


def test_a_beat_before_the_server_listened_again_buys_no_silence() -> None:
    clock, lease = taken()
    clock.now += 60.0  # stopped, as with SIGSTOP; then a beat that waited comes before the lease is checked
    lease.beat("one")
    assert lease.expire() is None
    silent_s = 0.0
    while lease.expire() is None:
        clock.now += LOOK_S
        silent_s += LOOK_S
        assert silent_s < LOST_S + 2 * LOOK_S
    assert lease.held().by is None
