"""Errors inside a session: the hit is in the log, no trial is lost, and the operator stays blinded."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.core.errors import ConfigError, LawError, LinkLostError, PlanError, RigError, StoppedError
from rig.session.engine._conduct import conduct
from rig.session.engine._desk import Reply
from rig.session.engine._directory import LOG, resume
from rig.session.engine._hits import DeviceRunner
from rig.session.engine._log import Event, read
from rig.session.engine._rehearsal import Day
from rig.session.engine._state import DoTrial
from rig.session.engine._telling import line_of_event
from rig.session.planning._protocol import Protocol
from tests.rig.session.session_fakes import INVALID, FakeRunner, ScriptedDesk, protocol_of, started, study


def events_of(directory: Path) -> list[Event]:
    return read(directory / LOG)


# --------------------------------------------------------------- a hit that ends by an error is a hit all the same


@pytest.mark.parametrize("error", [LawError("the law gave NaN"), RuntimeError("the console broke")])
def test_a_hit_that_breaks_is_logged_with_its_heat_before_the_session_ends(
    tmp_path: Path, error: Exception
) -> None:
    runner = FakeRunner({2: ({**INVALID, "ended": "stopped"}, error)})  # type: ignore[dict-item]
    runner.heat_of_a_hit = 0.2
    unblinded = protocol_of(study=study(blind="none"))
    with started(tmp_path / "P01", unblinded) as session, pytest.raises(type(error), match=str(error)):
        conduct(session, runner, ScriptedDesk())
    last, stopped = events_of(tmp_path / "P01")[-2:]
    assert (last.kind, last.content["trial"], last.content["automatic"]) == ("trial", 2, "invalid")
    assert stopped.kind == "stopped"
    assert str(error) in stopped.content["detail"]
    with resume(tmp_path / "P01", clock=Day()) as session:
        assert session.log.events[-1].content["abandoned"] == []
        assert session.state.heat > 0.3
        again = session.state.next()
    assert isinstance(again, DoTrial)
    assert (again.presented.trial, again.presented.attempt, again.presented.stiffness) == (
        3,
        2,
        runner.hits[1][1],
    )


class Breaks(ScriptedDesk):
    def watch(self) -> Callable[[int, int], None]:
        def watch(ticks: int, phase: int) -> None:
            if ticks:
                raise KeyError("a bug of the console")

        return watch


def quick_protocol() -> Protocol:
    changes = {
        "operator.press": 1.6,
        "operator.begin_s": 0.02,
        "homing.speed": 0.3,
        "verdict.lowpass_hz": 400.0,
    }
    return protocol_of(
        study=study(changes={**study()["changes"], **changes}),
        condition=[{"name": "hidden", "scheme": "uniform:2k", "damping": [0.211]}],
        search={"rule": "grid", "lowest": 20.0, "highest": 60.0, "step": 20.0, "settings": {"repeats": 1}},
    )


def test_a_desk_that_breaks_in_a_hit_loses_no_trial(tmp_path: Path) -> None:
    """On the simulated rig the loop stops, and the recording is sealed, judged and logged."""
    with (
        started(tmp_path / "P01", quick_protocol()) as session,
        pytest.raises(RigError, match="trial 1 ended by an error"),
    ):
        # The device in Python: the compiled one hits the wall before the desk is called.
        conduct(session, DeviceRunner(url="sim://?firmware=0"), Breaks())
    (trial,) = (event.content for event in events_of(tmp_path / "P01") if event.kind == "trial")
    assert (tmp_path / "P01" / trial["recording"]).is_file()
    assert (trial["ended"], trial["automatic"]) == ("stopped", "invalid")
    assert 0.0 < trial["heat"] < 1.0
    assert "a bug of the console" in events_of(tmp_path / "P01")[-1].content["detail"]


def test_a_clock_continues_where_the_log_ends(tmp_path: Path) -> None:
    leaves = ScriptedDesk(lambda question: Reply(action="abort") if question.kind == "verdict" else None)
    with started(tmp_path / "P01") as session:
        conduct(session, FakeRunner(), leaves)
    last = events_of(tmp_path / "P01")[-1].at
    with resume(tmp_path / "P01", clock=Day()) as session:
        assert session.clock() == last > 0.0


# ------------------------------------------------------------------------------------------------------- blinding


def refusing_runner(error: Exception) -> FakeRunner:
    class Refusing(FakeRunner):
        def hit(self, *arguments: Any) -> Any:
            raise error

    return Refusing()


@pytest.mark.parametrize(
    "error",
    [
        ConfigError("wall.stiffness = 412 is too much", remedy="choose less than 400"),
        PlanError("K = 412 with B = 0.37 is unstable"),
        LawError("the law raised ValueError(412)"),
        RigError("wall_stiffness 412: the device refuses it"),
        ValueError("412"),
    ],
)
def test_no_error_reveals_a_wall_to_a_blinded_operator(tmp_path: Path, error: Exception) -> None:
    with started(tmp_path / "P01") as session, pytest.raises(RigError) as raised:
        conduct(session, refusing_runner(error), ScriptedDesk())
    event = events_of(tmp_path / "P01")[-1]
    assert event.kind == "stopped"
    assert "412" not in str(raised.value) + line_of_event(event)
    assert "412" in event.content["detail"]
    assert raised.value.exit_code == getattr(error, "exit_code", RigError.exit_code)
    assert raised.value.__suppress_context__


def test_a_wall_that_an_experiment_refuses_stays_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The experiment's own check rejects the wall, before the rig is involved."""
    override = config.override

    def strict(*given: Any, **options: Any) -> Any:
        experiment = override(*given, **options)
        if experiment.wall.stiffness > 200.0:
            raise ConfigError(f"wall.stiffness = {experiment.wall.stiffness:g}: at most 200")
        return experiment

    monkeypatch.setattr(config, "override", strict)
    with started(tmp_path / "P01") as session, pytest.raises(PlanError) as raised:
        conduct(session, FakeRunner(), ScriptedDesk())
    assert not re.search(r"[1-9]\d\d", str(raised.value))
    assert "was refused before anything moved" in raised.value.message


@pytest.mark.parametrize("error", [LinkLostError("the cable is out"), StoppedError("stopped")])
def test_an_error_without_a_wall_is_raised_unchanged(tmp_path: Path, error: RigError) -> None:
    runner = FakeRunner({1: ({**INVALID, "ended": "link_closed"}, error)})
    runner.simulated = False
    if isinstance(error, StoppedError):
        error.signal = 2
    with started(tmp_path / "P01") as session, pytest.raises(type(error)) as raised:
        conduct(session, runner, ScriptedDesk())
    assert raised.value is error
    assert [event.kind for event in events_of(tmp_path / "P01")][-2:] == ["trial", "stopped"]


def test_an_unblinded_operator_sees_the_error_itself(tmp_path: Path) -> None:
    error = PlanError("K = 412 is unstable")
    with started(tmp_path / "P01", protocol_of(study=study(blind="participant"))) as session:
        with pytest.raises(PlanError) as raised:
            conduct(session, refusing_runner(error), ScriptedDesk())
        assert raised.value is error
