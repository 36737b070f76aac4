"""A streaming session: a recorder of Lab Streaming Layer receives the events of the log, without the walls."""

import json
from pathlib import Path
from typing import Any

import pytest

from rig.session.engine._desk import Desk, Question, Reply
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Day, Person, RehearsalDesk
from rig.session.engine._run import run_session
from rig.session.engine._telling import line_of_event
from tests.extras.lsl.test_lsl import Inlets, pylsl  # noqa: F401  (a fixture)
from tests.system.session_study import PROTOCOL

PERSON = Person(thresholds={})


@pytest.mark.exhaustive(
    "tests/extras/lsl/test_lsl.py::test_inlets_receive_every_row_at_its_time_and_what_a_session_marks"
)
def test_markers_of_a_session_are_its_log_without_the_walls(
    pylsl: Any,  # noqa: F811
    tmp_path: Path,
) -> None:
    protocol = tmp_path / "one.toml"
    protocol.write_text(
        PROTOCOL[: PROTOCOL.index("[[question]]")].replace("[order]", "[stop]\ntrials = 1\n[order]")
    )
    received: list[dict[str, Any]] = []

    class Recording(RehearsalDesk):
        """A desk that opens inlets at the first question and reads them at the second."""

        def ask(self, question: Question) -> Reply:
            if question.kind == "ready":
                self.inlets = Inlets(pylsl, "haptic-rig")
            elif question.kind == "verdict":
                self.inlets.pull_until("trial")
                received.extend(content for _, content in self.inlets.markers)
            return super().ask(question)

    def sit(*about: Any) -> Desk:
        return Recording(PERSON, Day())

    result = run_session(
        protocol, "P01", sit, runner=DeviceRunner(), study=tmp_path, person=PERSON, marks="lsl"
    )
    assert result.trials == 1
    events = read(tmp_path / "P01" / LOG)
    logged = [event for event in events if event.kind not in ("began", "streamed")]
    (trial,) = (event for event in events if event.kind == "trial")
    named = {one["mark"]: one for one in received}
    assert list(named)[-2:] == ["begins", "trial"]
    assert named["trial"]["text"] == line_of_event(trial)
    assert named["begins"]["trial"] == trial.content["trial"] == 1
    assert not any(word in json.dumps(received) for word in ("hidden", "stiffness", "0.211"))
    (streamed,) = (event.content for event in events if event.kind == "streamed")
    assert streamed["lost_markers"] == 0
    assert streamed["sent"]["markers"] == len(logged) + 1  # and the beginning of the trial
