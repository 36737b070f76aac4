"""A session stays on its rig: how a resumption identifies it, what it rejects, how an analysis reports mixtures."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rig.config import Experiment, override
from rig.config.presets import load as preset
from rig.core.errors import ConfigError, StoppedError
from rig.experiments.motion.pulse import NO_HANDS
from rig.extras.study import read_study
from rig.session.engine import _hits as hits
from rig.session.engine import _run as sessions
from rig.session.engine._conduct import conduct
from rig.session.engine._directory import LOG
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import read
from rig.session.engine._place import Place, resume_command
from tests.rig.session.session_fakes import FakeRunner, ScriptedDesk, started

REAL = {
    "place": {"url": "serial:///dev/ttyACM0", "realtime": True},
    "device": "bench-3",
    "simulated": False,
    "serial_number": "E661",
    "versions": {"haptic-rig": "0.1.0"},
}
SIMULATED = {"place": {"url": None, "realtime": True}, "device": "koul-rigid", "simulated": True}


class Runner(FakeRunner):
    def __init__(self, **facts: Any) -> None:
        super().__init__()
        self.given = facts
        self.simulated = bool(facts["simulated"])

    def facts(self, experiment: Experiment, changes: Mapping[str, Any]) -> dict[str, Any]:
        return self.given


class Tired(ScriptedDesk):
    def __init__(self, hits: int) -> None:
        super().__init__()
        self.left = hits

    def ask(self, question: Any) -> Any:
        if question.kind == "ready" and question.text != NO_HANDS:
            self.left -= 1
            if self.left < 0:
                raise StoppedError("enough")
        return super().ask(question)


def left(directory: Path, **facts: Any) -> Path:
    with started(directory / "P01") as session, pytest.raises(StoppedError):
        conduct(session, Runner(**facts), Tired(2))
    return directory / "P01"


def resume_and_leave(directory: Path, other_device: bool = False, **facts: Any) -> None:
    with pytest.raises(StoppedError):
        sessions.resume_session(
            directory, lambda *_: Tired(2), runner=Runner(**facts), at="trial", other_device=other_device
        )


def test_the_log_names_the_rig_to_resume_on(tmp_path: Path) -> None:
    directory = left(tmp_path, **REAL)
    assert sessions.took_place(directory) == Place("serial:///dev/ttyACM0", True, False)
    whole = f"rig session resume {directory} --url serial:///dev/ttyACM0 --verified"
    assert resume_command(directory, read(directory / LOG)) == whole
    assert sessions.summary(directory, *sessions.session_state(directory)).resume == whole
    with pytest.raises(ConfigError, match="--url serial:///dev/ttyACM0 --verified"):
        started(directory)
    simulated = left(tmp_path / "other", **SIMULATED)
    assert sessions.took_place(simulated) == Place(None, True, True)
    assert resume_command(simulated, read(simulated / LOG)) == f"rig session resume {simulated}"


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (SIMULATED, "simulated"),
        ({**REAL, "device": "bench-4"}, "bench-4"),
        ({**REAL, "serial_number": "E662"}, "E662"),
    ],
)
def test_another_device_is_refused_and_nothing_written(
    tmp_path: Path, facts: dict[str, Any], words: str
) -> None:
    directory = left(tmp_path, **REAL)
    before = (directory / LOG).read_bytes()
    with pytest.raises(ConfigError, match=words) as refused:
        resume_and_leave(directory, **facts)
    assert "`other_device`" in refused.value.remedy
    assert "`url` serial:///dev/ttyACM0" in refused.value.remedy
    assert (directory / LOG).read_bytes() == before
    resume_and_leave(directory, other_device=True, **facts)
    assert len(sessions.session_state(directory)[0].trials) > 2


def test_the_same_device_is_accepted_at_any_port(tmp_path: Path) -> None:
    directory = left(tmp_path, **REAL)
    place = {"url": "serial:///dev/ttyACM1", "realtime": True}
    resume_and_leave(directory, **{**REAL, "place": place, "serial_number": None})
    assert sessions.took_place(directory).url == "serial:///dev/ttyACM1"


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (REAL, ""),
        (SIMULATED, "P01: the session mixes a real rig with a simulated one (trials 3, 4)"),
        ({**REAL, "serial_number": "E662"}, "serial number E661) and bench-3 (real, serial number E662)"),
        ({**REAL, "versions": {"haptic-rig": "0.2.0"}}, "P01: from trial 3 on, haptic-rig changed"),
    ],
)
def test_an_analysis_says_what_changed_within_a_session(
    tmp_path: Path, facts: dict[str, Any], words: str
) -> None:
    directory = left(tmp_path, **REAL)
    resume_and_leave(directory, other_device=True, **facts)
    messages = [one for one in read_study([directory]).messages if "the session is not complete" not in one]
    messages = [one for one in messages if "protocol.toml" not in one]
    assert words in "".join(messages)
    assert len(messages) == (words != "")


def test_the_runner_says_where_it_is_and_what_runs() -> None:
    facts = DeviceRunner().facts(preset("koul-rigid"), {})
    assert facts["place"] == {"url": None, "realtime": False}
    assert {"haptic-rig", "sources", "numpy", "platform"} <= facts["versions"].keys()


def test_a_hand_that_an_operator_takes_over_opens_the_device_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The device is opened before the desk is, to measure its pace: without a hand of the operator."""
    held, closed = override(preset("koul-compliant"), {"trial.kind": "human"}), []

    @contextmanager
    def open_for_run(url: Any, model: Any, **options: Any) -> Iterator[Any]:
        yield SimpleNamespace(url=url)
        closed.append(url)

    monkeypatch.setattr(hits, "open_for_run", open_for_run)
    runner = DeviceRunner(realtime=True)
    scripted = runner._device(held, {})
    assert runner._device(held, {}) is scripted
    runner.hand = Path("/somewhere/hand")
    driven = runner._device(held, {})
    assert closed == [scripted.url] == ["sim://"]
    assert driven.url == "sim://?hand=/somewhere/hand"
    assert runner._device(held, {}) is driven
