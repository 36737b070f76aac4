"""A session that streams: what a recorder of Lab Streaming Layer receives is what the log says, without the walls."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

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


def test_markers_of_a_session_are_its_log_and_tell_no_wall(
    pylsl: Any,  # noqa: F811
    tmp_path: Path,
) -> None:
    protocol = tmp_path / "one.toml"
    protocol.write_text(
        PROTOCOL[: PROTOCOL.index("[[question]]")].replace("[order]", "[stop]\ntrials = 1\n[order]")
    )
    heard: list[dict[str, Any]] = []

    class Recording(RehearsalDesk):
        """Listens from the first question on, and looks at the second what has come."""

        def ask(self, question: Question) -> Reply:
            if question.kind == "ready":
                self.inlets = Inlets(pylsl, "haptic-rig")
            elif question.kind == "verdict":
                self.inlets.pull_until("trial")
                heard.extend(content for _, content in self.inlets.markers)
            return super().ask(question)

    def somebody(*about: Any) -> Desk:
        return Recording(PERSON, Day())

    result = run_session(
        protocol, "P01", somebody, runner=DeviceRunner(), study=tmp_path, person=PERSON, marks="lsl"
    )
    assert result.trials == 1
    events = read(tmp_path / "P01" / LOG)
    told = [event for event in events if event.kind not in ("began", "streamed")]
    (trial,) = (event for event in events if event.kind == "trial")
    named = {one["mark"]: one for one in heard}
    assert list(named)[-2:] == ["begins", "trial"]
    assert named["trial"]["text"] == line_of_event(trial)
    assert named["begins"]["trial"] == trial.content["trial"] == 1
    assert not any(word in json.dumps(heard) for word in ("hidden", "stiffness", "0.211"))
    (streamed,) = (event.content for event in events if event.kind == "streamed")
    assert streamed["lost_markers"] == 0
    assert streamed["sent"]["markers"] == len(told) + 1  # and the beginning of the trial
