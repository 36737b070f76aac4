"""The console's own loop in this process: what STOP does first, and how often it looks and prints."""

from __future__ import annotations

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


@dataclass
class Ends:
    """The session's ends of the console's pipes."""

    to_console: int
    from_console: int


@pytest.fixture
def console(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[program._Console, Ends]]:
    """A console whose session is this process; nothing is typed."""
    hear, to_console = os.pipe()
    from_console, say = os.pipe()
    typed, types = os.pipe()
    monkeypatch.setattr(program, "IN", typed)
    keys = plain(KeyMap.of(Keys()))
    os.write(to_console, line_of("setup", pid=os.getpid(), keys=keys, attributes=None, hand=None))
    yield program._Console(hear, say), Ends(to_console, from_console)
    for descriptor in (hear, to_console, from_console, say, typed, types):
        os.close(descriptor)


def test_stop_is_in_the_loops_memory_before_the_session_receives_it(
    console: tuple[program._Console, Ends], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when the session's program hangs, and its pipe takes nothing any more."""
    one, _ = console
    os.set_blocking(one._to, False)
    while select.select([], [one._to], [], 0.0)[1]:
        os.write(one._to, bytes(4096))
    assert one._talk.moving
    with Ring.allocate(16, info={}, shared=True) as ring:
        with pytest.raises(BlockingIOError):
            one._seat.do([StopPressed()])
        assert ring.peek(STOP) != 0


@pytest.mark.parametrize("moving", [True, False])
def test_lines_come_ten_to_twenty_times_a_second_while_the_handle_moves(
    moving: bool, console: tuple[program._Console, Ends], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of every moment that has something to show; while nothing moves, fewer. A clock that only waiting moves."""
    one, ends = console
    clock = [100.0]
    looks: list[float] = []
    printed: list[float] = []

    def wait(sources: list[int], *rest: Any) -> tuple[list[int], list[int], list[int]]:
        clock[0] += rest[-1]
        return [], [], []

    def look() -> None:
        looks.append(clock[0])

    def lines(*shown: Any) -> list[str]:
        printed.append(clock[0])
        return []

    monkeypatch.setattr(one._printer, "lines", lines)
    one._handle_message({"kind": "view", "view": plain(DeskView(state="hit"))})
    if not moving:
        question = Question(kind="ready", text="ready?", actions=("go",))
        one._handle_message({"kind": "ask", "number": 1, "question": plain(question)})
    monkeypatch.setattr(program, "select", SimpleNamespace(select=wait))
    monkeypatch.setattr(program, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(one._seat.live, "look", look)
    while clock[0] < 110.0:
        assert one._round()
        os.read(ends.from_console, 65536)  # that it is alive
    if moving:
        assert 10.0 <= len(printed) / 10.0 <= 20.0
        assert len(looks) == len(printed)  # each shows how things stand then
        gaps = [after - before for before, after in pairwise(printed)]
        assert max(gaps) <= 0.1
    else:
        assert 1.0 <= len(printed) / 10.0 <= 5.1
