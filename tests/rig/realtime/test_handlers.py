"""Signals at moments in which the interpreter would lose the exception that their handler raises."""

import ctypes
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from rig.realtime.handlers import handle_signals, interrupts_later, interrupts_now
from rig.realtime.kernel import kernel

pytestmark = pytest.mark.signals


@pytest.fixture(autouse=True)
def _as_in_a_program_of_its_own() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class _Finalised:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def _called_by_c() -> None:
    compare = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    numbers = (ctypes.c_int * 2)(2, 1)
    order = compare(lambda a, b: signal.raise_signal(signal.SIGINT) or 0)
    ctypes.CDLL(None).qsort(numbers, ctypes.c_size_t(2), ctypes.c_size_t(4), order)


@pytest.mark.parametrize("place", [_Finalised, _called_by_c])
def test_ctrl_c_where_an_exception_would_be_forgotten_is_raised_afterwards(place: Any) -> None:
    done = []

    def whole() -> None:
        with interrupts_later():
            place()
            done.append("all of it")

    with pytest.raises(KeyboardInterrupt):
        whole()
    assert done


def test_an_impatient_ctrl_c_is_one_interruption() -> None:
    def twice() -> None:
        with interrupts_later():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        twice()
    with interrupts_later():
        interrupts_now()


def test_a_sigterm_that_nothing_handles_ends_the_process() -> None:
    """The default action is not a function; a call of it turned a process manager's SIGTERM into a TypeError."""
    program = """
import signal
from rig.realtime.handlers import interrupts_later, interrupts_now
signal.signal(signal.SIGTERM, signal.SIG_DFL)
with interrupts_later():
    signal.raise_signal(signal.SIGTERM)
    interrupts_now()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")


def test_interrupt_is_raised_also_after_an_error() -> None:
    def fails() -> None:
        with interrupts_later():
            signal.raise_signal(signal.SIGINT)
            raise ValueError("whatever it was")

    with pytest.raises(KeyboardInterrupt) as caught:
        fails()
    assert isinstance(caught.value.__context__, ValueError)


def test_interrupt_is_raised_between_two_parts() -> None:
    """Ctrl-C need not wait until all functions of a kernel are compiled."""
    done = []

    def in_parts() -> None:
        with interrupts_later():
            with interrupts_later():
                signal.raise_signal(signal.SIGINT)
            done.append("the first")
            interrupts_now()
            done.append("the second")

    with pytest.raises(KeyboardInterrupt):
        in_parts()
    assert done == ["the first"]
    interrupts_now()  # it was raised once


def test_kernel_compiles_again_after_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    @kernel("f8(f8)", cache=False)
    def half(x: float) -> float:
        return 0.5 * x

    if not hasattr(half, "prepare"):
        pytest.skip("without the compiler there is nothing to interrupt")
    plain = type(half).compile

    def interrupted(self: Any, signature: Any) -> Any:
        _called_by_c()
        return plain(self, signature)

    with monkeypatch.context() as patch:
        patch.setattr(type(half), "compile", interrupted)
        with pytest.raises(KeyboardInterrupt):
            half.prepare()
    assert half(3.0) == 1.5


def test_ignored_signal_stays_ignored_and_other_threads_change_nothing() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    calls: list[int] = []
    with handle_signals((signal.SIGINT, signal.SIGTERM), lambda number, frame: calls.append(number)) as here:
        signal.raise_signal(signal.SIGINT)
        assert here
    assert not calls
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN

    def elsewhere() -> None:
        with handle_signals((signal.SIGTERM,), lambda number, frame: None) as here:
            calls.append(here)

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert calls == [False]
    assert signal.getsignal(signal.SIGTERM) is before
