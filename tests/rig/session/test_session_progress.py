"""The progress of a rehearsal."""

import itertools

import pytest

from rig.cli._session_progress import Rehearsed
from rig.session.engine._desk import DeskView
from rig.session.engine._log import Event


@pytest.mark.parametrize("quiet", [False, True])
def test_without_a_terminal_events_are_lines_and_the_time_is_printed_once(
    quiet: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with Rehearsed(quiet=quiet, clock=itertools.count(0.0, 0.5).__next__) as seen:
        for trial in range(1, 8):
            seen.looks(DeskView(state="ready", trial=trial, trials=104, block=2, blocks=5))
        seen.on_event(Event(1, 0.0, "paused", {"reason": "requested by the operator"}))
    lines = ["trial 4 of about 104, block 2 of 5, about 50 s left", "paused: requested by the operator"]
    assert capsys.readouterr() == ("", "" if quiet else "".join(f"  {line}\n" for line in lines))
