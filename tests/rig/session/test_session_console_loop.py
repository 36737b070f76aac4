"""The console's own loop in this process: where STOP is stored first, and how often the console reads and prints."""

import os
import select
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from rig.core.present import plain
from rig.realtime.control_words import STOP
from rig.realtime.ring import Ring
from rig.session.engine._desk import DeskView, Question
from rig.session.planning._keymap import KeyMap
from rig.session.planning._protocol import Keys
from rig.session.terminal import _program as program
from rig.session.terminal._conversation import StopPressed
from rig.session.terminal._messages import line_of
from rig.session.terminal._program import QUIET_S

START_S, DURATION_S = 100.0, 10.0


@dataclass
class SessionEnds:
    """The session's ends of its pipes to the console (file descriptors)."""

    to_console: int
    from_console: int


@pytest.fixture
def console(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[program._Console, SessionEnds]]:
    """Yield a console whose session is this process; no key is typed."""
    console_reads, to_console = os.pipe()
    from_console, console_writes = os.pipe()
    keyboard_read, keyboard_write = os.pipe()
    monkeypatch.setattr(program, "IN", keyboard_read)
    keys = plain(KeyMap.of(Keys()))
    os.write(to_console, line_of("setup", pid=os.getpid(), keys=keys, attributes=None, hand=None))
    yield program._Console(console_reads, console_writes), SessionEnds(to_console, from_console)
    pipes = (console_reads, to_console, from_console, console_writes, keyboard_read, keyboard_write)
    for descriptor in pipes:
        os.close(descriptor)


def test_stop_is_in_the_shared_control_words_before_the_session_receives_it(
    console: tuple[program._Console, SessionEnds],
) -> None:
    """STOP acts on the realtime loop also if the session's program hangs and no longer reads its pipe."""
    under_test, _ = console
    to_session = under_test._to  # the console's end of the pipe to the session, which is filled here
    os.set_blocking(to_session, False)
    while select.select([], [to_session], [], 0.0)[1]:
        os.write(to_session, bytes(4096))
    # No question is open, so the handle may move; only then the console's seat also sends STOP to the session.
    assert under_test._talk.moving
    with Ring.allocate(16, info={}, shared=True) as ring:
        with pytest.raises(BlockingIOError):
            under_test._seat.do([StopPressed()])
        assert ring.peek(STOP) != 0


@pytest.mark.parametrize("moving", [True, False])
def test_the_console_prints_ten_to_twenty_times_a_second_while_the_handle_moves(
    moving: bool, console: tuple[program._Console, SessionEnds], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It prints 12.5 times a second while the handle moves, at most 5 otherwise; only `select` advances the clock."""
    under_test, ends = console
    clock = [START_S]
    position_read_at: list[float] = []
    printed_at: list[float] = []

    def wait(sources: list[int], *rest: Any) -> tuple[list[int], list[int], list[int]]:
        clock[0] += rest[-1]
        return [], [], []

    def lines(*shown: Any) -> list[str]:
        printed_at.append(clock[0])
        return []

    monkeypatch.setattr(under_test._printer, "lines", lines)
    under_test._handle_message({"kind": "view", "view": plain(DeskView(state="hit"))})
    if not moving:
        question = Question(kind="ready", text="ready?", actions=("go",))
        under_test._handle_message({"kind": "ask", "number": 1, "question": plain(question)})
    monkeypatch.setattr(program, "select", SimpleNamespace(select=wait))
    monkeypatch.setattr(program, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(under_test._seat.live, "look", lambda: position_read_at.append(clock[0]))
    while clock[0] < START_S + DURATION_S:
        assert under_test._round()
        os.read(ends.from_console, 65536)  # discard the alive messages, or the pipe fills
    rate_hz = len(printed_at) / DURATION_S
    if moving:
        assert 10.0 <= rate_hz <= 20.0
        assert position_read_at == printed_at  # the handle's position is read once before each print
        assert max(after - before for before, after in pairwise(printed_at)) <= 0.1
    else:
        assert 1.0 <= rate_hz <= 1.0 / QUIET_S + 1.0 / DURATION_S  # one round more than intervals
