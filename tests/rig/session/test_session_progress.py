"""The progress of a rehearsal at a terminal."""

from collections.abc import Iterator

import pytest

from rig.cli import _session_progress as session_progress
from rig.cli._session_progress import Rehearsed
from rig.session.engine._desk import DeskView
from rig.session.engine._log import Event


class Terminal:
    def isatty(self) -> bool:
        return True


@pytest.fixture
def printed_lines(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    lines: list[str] = []
    monkeypatch.setattr(
        session_progress.click, "echo", lambda text, nl=True, err=False: lines.append(f"{err} {text}")
    )
    return lines


def clock(step_s: float) -> Iterator[float]:
    now = 0.0
    while True:
        yield now
        now += step_s


def ready_view(trial: int, block: int = 2) -> DeskView:
    return DeskView(state="ready", trial=trial, trials=104, block=block, blocks=5, practice=block == 0)


def test_a_terminal_has_one_line(monkeypatch: pytest.MonkeyPatch, printed_lines: list[str]) -> None:
    monkeypatch.setattr(session_progress.sys, "stderr", Terminal())
    with Rehearsed(quiet=False, clock=clock(3.0).__next__) as seen:
        for trial in (1, 2, 3, 4):
            seen.looks(ready_view(trial, 0 if trial == 1 else 2))
        seen.looks(DeskView(state="homing"))
        seen.on_event(Event(1, 0.0, "paused", {"reason": "requested by the operator"}))
    start = "True \r\033[K"
    assert printed_lines == [
        f"{start}trial 1 of about 104, practice",
        f"{start}trial 2 of about 104, block 2 of 5",
        f"{start}trial 3 of about 104, block 2 of 5",
        f"{start}trial 4 of about 104, block 2 of 5, about 5 min left",  # 101 trials of 3 s
        start,
    ]


def test_without_a_terminal_events_are_lines_and_the_time_is_printed_once(printed_lines: list[str]) -> None:
    with Rehearsed(quiet=False, clock=clock(0.5).__next__) as seen:
        for trial in range(1, 8):
            seen.looks(ready_view(trial))
        seen.on_event(Event(1, 0.0, "paused", {"reason": "requested by the operator"}))
    assert printed_lines == [
        "True   trial 4 of about 104, block 2 of 5, about 50 s left",
        "True   paused: requested by the operator",
    ]


def test_a_quiet_rehearsal_prints_nothing(printed_lines: list[str]) -> None:
    with Rehearsed(quiet=True) as seen:
        for trial in range(1, 8):
            seen.looks(ready_view(trial))
        seen.on_event(Event(1, 0.0, "paused", {"reason": "requested by the operator"}))
    assert printed_lines == []
