"""Requests to stop: counted in machine code for every thread, without any change to the caller's signal handlers."""

import ctypes
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rig.core.errors import StoppedError
from rig.realtime import stop_requests
from rig.realtime.stop_requests import STOPPING, RunSeries

pytestmark = pytest.mark.signals


def handlers() -> list[tuple[Any, bytes]]:
    """Return for each signal Python's handler, and the C library's handler with its flags and mask."""
    found = []
    for number in STOPPING:
        action = ctypes.create_string_buffer(152)
        ctypes.CDLL(None).sigaction(int(number), None, action)
        # The rest of the mask is not set.
        found.append((signal.getsignal(number), action.raw[:16] + action.raw[136:140]))
    return found


@pytest.fixture(autouse=True)
def unchanged() -> Iterator[None]:
    """Set the handlers of a new program, and check that they are the same afterwards."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    expected = handlers()
    try:
        yield
        assert handlers() == expected
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def in_a_thread(context: Callable[[], Any]) -> Iterator[RunSeries]:
    """Enter a context in another thread while this one lasts; yield the other's series of runs."""
    ready, leave, found = threading.Event(), threading.Event(), []

    def body() -> None:
        with context() as series:
            found.append(series)
            ready.set()
            leave.wait(30)

    thread = threading.Thread(target=body)
    thread.start()
    assert ready.wait(30)
    try:
        yield found[0]
    finally:
        leave.set()
        thread.join()


@pytest.mark.parametrize("context", [stop_requests.run, stop_requests.listening])
def test_signal_stops_runs_of_other_threads_and_calls_the_callers_handler(context: Any) -> None:
    with in_a_thread(context) as series, in_a_thread(context) as other:
        assert not series.is_stopped
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert series.is_stopped
        assert other.is_stopped
        assert stop_requests.last_signal() == signal.SIGINT
        with pytest.raises(StoppedError):
            series.check()
    with in_a_thread(context) as series:
        assert not series.is_stopped, "a new one begins anew"


def test_a_wake_up_descriptor_of_the_caller_gets_its_bytes() -> None:
    reader, writer = os.pipe2(os.O_NONBLOCK)
    before = signal.set_wakeup_fd(writer)
    try:
        with in_a_thread(stop_requests.run), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert os.read(reader, 8) == bytes([signal.SIGINT])
    finally:
        signal.set_wakeup_fd(before)
        os.close(reader)
        os.close(writer)


def test_a_handler_that_the_program_sets_meanwhile_is_called_and_the_signal_still_counted() -> None:
    calls: list[int] = []
    with in_a_thread(stop_requests.run) as series:
        signal.signal(signal.SIGINT, lambda number, frame: calls.append(number))
        stop_requests.renew()  # as a loop's thread does while it waits
        signal.raise_signal(signal.SIGINT)
        assert calls == [signal.SIGINT]
        assert series.is_stopped
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_a_handler_compiles_nothing() -> None:
    stop_requests.count()  # once, before any handler is installed
    assert stop_requests._add_request.prepared  # type: ignore[attr-defined]


def test_an_ignored_signal_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with in_a_thread(stop_requests.run) as series:
        signal.raise_signal(signal.SIGINT)
        assert not series.is_stopped
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_a_stop_between_two_runs_ends_the_series_and_not_the_next_one() -> None:
    with stop_requests.together():
        stop_requests.request()
        with stop_requests.run() as series, pytest.raises(StoppedError):
            series.check()
    with stop_requests.run() as series:
        series.check()
    assert stop_requests.running() == 0


def test_a_forked_child_ends_by_the_default_action() -> None:
    with in_a_thread(stop_requests.run) as series:
        child = multiprocessing.get_context("fork").Process(target=time.sleep, args=(30,))
        child.start()
        child.terminate()
        child.join(10)
        assert child.exitcode == -signal.SIGTERM
        assert not series.is_stopped
