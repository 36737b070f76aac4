"""``rig session new, check, run, resume, show`` without a terminal."""

import json
import shutil
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from rig.cli import run as rig
from rig.doctor import pace
from rig.session.engine._directory import LOG
from rig.session.engine._log import read
from rig.session.engine._rehearsal import Person
from tests.conformance.far_end import patient_host
from tests.conformance.tiers import first_by_default
from tests.system.session_study import PROTOCOL, written

ALL = Path("rehearsals/quick")
SHORT = PROTOCOL.replace("repeats = 2", "repeats = 1")
OF_THE_WALL = ("hidden", "0.211", "stiffness", "damping")


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Rehearse a session with practice from its protocol's directory; return this, and what was printed."""
    place, output = tmp_path_factory.mktemp("study"), StringIO()
    (place / "quick.toml").write_text(SHORT + "[practice]\nstiffness = [30.0]\n")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(output), redirect_stderr(output):
        patch.chdir(place)
        assert rig(["session", "run", "quick.toml", "P01", "--rehearse"]) == 0
    return place, output.getvalue()


@pytest.fixture
def study(rehearsal: tuple[Path, str]) -> Path:
    return rehearsal[0]


def test_a_rehearsal_is_complete_in_its_own_directory_and_shows_no_wall(rehearsal: Any, run: Any) -> None:
    place, printed = rehearsal
    assert "session of P01: complete" in printed
    assert not any(word in printed for word in OF_THE_WALL)
    assert not (place / "sessions").exists()
    directory = place / ALL / "P01"
    assert (directory / "protocol.toml").read_text() == (place / "quick.toml").read_text()
    found = json.loads(run("session", "show", directory, "--json")[1])
    assert (found["blocks"], found["blocks_done"]) == (1, 1), "practice is not counted"
    before = {path: path.stat().st_mtime_ns for path in place.rglob("*")}
    for more in ((), ("--rehearse",)):
        status, _, err = run("session", "run", place / "quick.toml", "P01", "--study", place / ALL, *more)
        assert (status, "already contains a rehearsal with a simulated person" in err) == (2, True)
    assert {path: path.stat().st_mtime_ns for path in place.rglob("*")} == before


@pytest.mark.exhaustive("::test_a_rehearsal_is_complete_in_its_own_directory_and_shows_no_wall")
def test_a_rehearsal_starts_again_on_request_and_replaces_no_session(tmp_path: Path, run: Any) -> None:
    study, there = str(written(tmp_path)), tmp_path / "all"
    rehearse = ("run", study, "P01", "--rehearse", "--study", str(there), "--json")
    first, again = (json.loads(run("session", *rehearse, *more)[1]) for more in ((), ("--again",)))
    assert first["trials"] == again["trials"]
    assert run("session", *rehearse)[0] == 2
    people = [
        Person(thresholds={"hidden-dual": 100.0}, people_sd=0.3).of_code(code, 1) for code in ("P01", "P02")
    ]
    assert len({one.thresholds["hidden-dual"] for one in people}) == 2
    assert people[0].of_code("P03", 1).people_sd == 0.3
    (there / "P02").mkdir()
    assert run("session", "run", study, "P02", "--again", "--study", there)[0] == 2
    assert (there / "P02").is_dir()


def test_show_is_blind_by_default(study: Path, run: Any) -> None:
    directory = str(study / ALL / "P01")
    _, blind, _ = run("session", "show", directory, "--log")
    _, blind_json, _ = run("session", "show", directory, "--json")
    assert not any(word in blind + blind_json for word in OF_THE_WALL)
    shown: dict[str, Any] = json.loads(blind_json)
    assert shown["ended"] == "complete"
    judged = sum(event["kind"] == "judged" for event in shown["events"])
    assert shown["counted"] == judged - 1, "one is practice"
    _, open_log, _ = run("session", "show", directory, "--log", "--unblind")
    assert "hidden-dual" in open_log


def test_a_damaged_last_line_is_reported_and_set_aside(study: Path, run: Any, tmp_path: Path) -> None:
    here = tmp_path / "P01"
    shutil.copytree(study / ALL / "P01", here)
    lines = (here / LOG).read_bytes().splitlines(keepends=True)
    (here / LOG).write_bytes(b"".join(lines[:11]) + lines[11].replace(b'"', b"'", 1))
    status, out, err = run("session", "show", here, "--log")
    assert status != 0
    assert "   10  " in out
    assert "   11  " not in out
    assert "line 12, the last one: damaged" in err
    status, _, err = run("session", "resume", here)
    assert status != 0
    assert "--drop-damaged-line" in err
    status, out, err = run("session", "resume", here, "--drop-damaged-line")
    assert status == 0
    assert f"the damaged line was moved to {here / LOG}.damaged-1" in err
    assert "a damaged line of the log was moved to another file: session.log.damaged-1" in err
    assert "session of P01: complete" in out
    (resumed,) = [event for event in read(here / LOG) if event.kind == "resumed"]
    assert resumed.content["damaged"][0]["file"] == "session.log.damaged-1"


def test_a_persons_session_needs_a_terminal(study: Path, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    busy = "--lossy-anyway"  # the timing of this machine does not matter here
    monkeypatch.setattr(pace, "SECONDS", 0.1)
    with patient_host():
        status, _, err = run("session", "run", study / "quick.toml", "P09", "--study", study / ALL, busy)
    assert status == 2
    assert "terminal" in err
    assert not (study / ALL / "P09").exists()


def test_a_wall_beyond_the_limits_is_refused_before_a_file_is_written(tmp_path: Path, run: Any) -> None:
    path = tmp_path / "hard.toml"
    path.write_text(
        PROTOCOL.replace('"trial.minimum_rest_counts" = 0.0', '"rig.limits.position_maximum" = 0.001')
    )
    status, _, err = run("session", "run", path, "P01", "--rehearse", "--study", tmp_path / "all")
    assert status == 2
    assert "peak penetration" in err
    assert not (tmp_path / "all").exists()


# ---------------------------------------------------------------------- protocols

PLAN = """
[study]
title = "Short"
preset = "koul-compliant"
participants = 4
changes."operator.press" = 1.5
changes."trial.minimum_rest_counts" = 1.0
[[condition]]
name = "uniform"
scheme = "uniform:20k"
[[condition]]
name = "dual"
scheme = "dual:20k/2k"
[search]
lowest = 200
highest = 600
step = 100
"""


def test_a_new_protocol_is_written_once_and_passes(run: Any, tmp_path: Path) -> None:
    code, out, err = run("session", "new", "study.toml", "--template", "compare-schemes")
    assert code == 0, err
    assert "rig session check study.toml" in out
    text = (tmp_path / "study.toml").read_text()
    assert run("session", "new", "study.toml", "--template", "koul-fig6")[0] == 9
    assert (tmp_path / "study.toml").read_text() == text
    code, out, err = run("session", "check", "study.toml", "--participants", "3", "--unblind", "--json")
    assert code == 0, err
    plan = json.loads(out)
    assert plan["ok"]
    assert len(plan["orders"]) == 3
    assert {cell["condition"] for cell in plan["cells"]} == {"uniform 20 kHz", "dual-rate 20/2 kHz"}


@pytest.mark.parametrize("blind", first_by_default(["both", "none", "operator", "participant"], 2))
def test_the_plan_hides_the_order_from_a_blinded_operator(run: Any, tmp_path: Path, blind: str) -> None:
    (tmp_path / "study.toml").write_text(
        PLAN.replace("participants = 4", f'participants = 4\nblind = "{blind}"')
    )
    hidden = blind in ("both", "operator")
    _, out, _ = run("session", "check", "study.toml")
    assert ("A: " in out, "participant   blocks" in out) == (not hidden, not hidden)
    assert (
        "The person who plans the study and never operates a session can show it with --unblind" in out
    ) == hidden
    _, unblinded, _ = run("session", "check", "study.toml", "--unblind")
    assert "A: " in unblinded
    plan = json.loads(run("session", "check", "study.toml", "--json")[1])
    assert (plan["orders"] is None) == hidden


def test_a_refused_rule_is_printed_and_ends_with_an_error(run: Any, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(PLAN + "[stop]\ntrials = 2\n")
    code, out, err = run("session", "check", "study.toml")
    assert code == 2
    assert "no stop.trials" in out
    assert "refused by the checks stop.trials" in err
