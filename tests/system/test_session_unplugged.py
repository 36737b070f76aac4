"""A rig that is unplugged in the middle of a session, and two sessions that open the same rig."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from rig.config import Experiment
from rig.devices.fault_script import Direction, FaultKind, FrameFault
from rig.experiments.hits import hit as one_hit
from rig.extras.study import AnalysisOptions, analyse
from rig.recording.reader import open_recording
from rig.session.engine._desk import Desk, Question, Reply
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Day, Person, RehearsalDesk
from rig.session.engine._run import rehearsal_desk, resume_session, run_session
from rig.session.engine._runner import TrialDone
from rig.session.engine._state import RecordedTrial, SessionState
from sim_backend.ends.channel import ScriptedLine
from tests.system.session_study import written

PERSON = Person(thresholds={"hidden-dual": 65.0, "hidden-uniform": 65.0}, spread=0.5)
UNPLUGGED = "t0003"  # the trial in which it happens
FRAMES = 300  # of the armed device that reach the host before


class Loose(DeviceRunner):
    def hit(self, experiment: Experiment, changes: Any, directory: Path, name: str, *rest: Any) -> TrialDone:
        if name != UNPLUGGED:
            return super().hit(experiment, changes, directory, name, *rest)
        with pytest.MonkeyPatch.context() as patch:
            run_trial = one_hit.run_trial

            def loosened(device: Any, request: Any) -> Any:
                arm = device.arm

                def armed() -> int:
                    session: int = arm()
                    fault = FrameFault(kind=FaultKind.UNPLUG, direction=Direction.TO_HOST, frame=FRAMES)
                    device.link.line = ScriptedLine((fault,))
                    return session

                patch.setattr(device, "arm", armed)
                return run_trial(device, request)

            patch.setattr(one_hit, "run_trial", loosened)
            return super().hit(experiment, changes, directory, name, *rest)


class Leaving(RehearsalDesk):
    def ask(self, question: Question) -> Reply:
        if question.kind == "trouble":
            return Reply(action="abort")
        return super().ask(question)


def test_a_session_resumes_after_a_pulled_plug_to_the_same_results(tmp_path: Path) -> None:
    protocol = written(tmp_path)
    protocol.write_text(protocol.read_text().replace("repeats = 2", "repeats = 1"))
    studies = tmp_path / "calm", tmp_path / "loose"
    run_session(
        protocol, "P01", rehearsal_desk(PERSON), runner=DeviceRunner(), study=studies[0], person=PERSON
    )

    def leaving(*about: Any) -> Desk:
        return Leaving(PERSON, Day())

    left = run_session(protocol, "P01", leaving, runner=Loose(), study=studies[1], person=PERSON)
    assert left.stopped == "the operator left"
    directory = studies[1] / "P01"
    broken = next(event for event in read(directory / LOG) if event.content.get("trial") == 3)
    assert (broken.content["ended"], broken.content["automatic"]) == ("link_closed", "invalid")
    assert open_recording(directory / broken.content["recording"]).complete
    done = resume_session(directory, rehearsal_desk(PERSON), runner=DeviceRunner())
    assert done.ended == "complete"
    calm, loose = (SessionState.of(read(study / "P01" / LOG)) for study in studies)
    assert [trial.trial for trial in loose.trials if trial.invalid] == [3]
    assert [about(trial) for trial in loose.trials if not trial.invalid] == [
        about(trial) for trial in calm.trials
    ]
    marked = AnalysisOptions(include_marked=True)  # `most` is small: a run ends by it
    found = [analyse([study / "P01"], marked) for study in studies]
    limits = [[str(asdict(one)) for one in one.of_participants if one.measure == "rule"] for one in found]
    assert limits[0] == limits[1] != []


def about(trial: RecordedTrial) -> tuple[Any, ...]:
    return trial.condition, trial.repeat, trial.stiffness, trial.verdict
