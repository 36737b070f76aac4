"""Signals while a loop runs, and at the moment in which the program's own handlers are restored."""

import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from rig.loop._signals import stop_on_signals
from rig.realtime.stop_requests import STOPPING

pytestmark = pytest.mark.signals


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in STOPPING}
    for number in STOPPING:  # which a shell may have set to be ignored
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", STOPPING)
def test_a_signal_requests_a_stop_and_raises_nothing(number: int) -> None:
    with stop_on_signals() as caught:
        assert not caught.series.is_stopped
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert caught.series.is_stopped
    assert (caught.is_stopped, caught.number, caught.raised) == (True, number, None)


def test_a_handler_of_the_callers_is_called_at_once_and_what_it_raises_waits() -> None:
    called: list[int] = []

    def leave(number: int, frame: object) -> None:
        called.append(number)
        raise SystemExit(7)

    signal.signal(signal.SIGTERM, leave)
    with stop_on_signals() as caught:
        signal.raise_signal(signal.SIGTERM)
        assert called == [signal.SIGTERM]
    assert isinstance(caught.raised, SystemExit)


@pytest.mark.parametrize("place", range(len(STOPPING)))
def test_ctrl_c_while_handlers_return_is_raised_when_all_of_them_have(
    monkeypatch: pytest.MonkeyPatch, place: int
) -> None:
    """Raised earlier, it would leave handlers that swallow SIGTERM, and a closed wake-up descriptor."""
    received: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: received.append(number))
    signal.signal(signal.SIGHUP, lambda number, frame: received.append(number))
    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPPING}
    restored: list[int] = []

    def set_handler(number: int, handler: Any) -> Any:
        if number in STOPPING and handler is before[number]:
            if len(restored) == place:
                signal.raise_signal(signal.SIGINT)
            restored.append(number)
        return plain(number, handler)

    plain = signal.signal
    open_before = set(os.listdir("/proc/self/fd"))
    with monkeypatch.context() as patch:  # noqa: SIM117
        with pytest.raises(KeyboardInterrupt), stop_on_signals():
            patch.setattr(signal, "signal", set_handler)
    assert {number: signal.getsignal(number) for number in STOPPING} == before
    assert signal.set_wakeup_fd(-1) == -1
    assert set(os.listdir("/proc/self/fd")) == open_before
