"""A changed protocol within a study: differences are listed before a session begins, and the analysis reports them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from rig.cli import rig
from rig.config._files import parse_toml
from rig.core.check import Outcome
from rig.core.errors import ConfigError
from rig.extras.study import AnalysisOptions, analyse
from rig.extras.study.report_events import deviations
from rig.extras.study.study import read_study
from rig.session.engine._check import check
from rig.session.engine._log import read
from rig.session.engine._protocol_changes import ChangedProtocolError
from rig.session.engine._rehearsal import Person
from rig.session.engine._run import rehearsal_desk, run_session
from rig.session.planning._load import load_walls, protocol_from_mapping
from tests.conformance.studies import Person as SimulatedPerson
from tests.conformance.studies import protocol, sitting, without_sync
from tests.rig.session.session_fakes import FakeRunner
from tests.system.session_study import PROTOCOL

PERSON = Person(thresholds={})
NEUTRAL = [
    ("study.notes", "seed = 11", 'seed = 11\nnotes = "fitted a new cable"'),
    ("trial.say", "[trial]", '[trial]\nsay = "Push into the wall until it stops you and stay there."'),
    ("trial.attempts", "[trial]", "[trial]\nattempts = 5"),
    ("trial.ready_s", "[trial]", "[trial]\nready_s = 4.0"),
]
DECIDING = [
    ("trial.posture", "[trial]", '[trial]\nposture = "standing"'),
    ("search.highest", "highest = 120.0", "highest = 140.0"),
    ("study.seed", "seed = 11", "seed = 12"),
]


def run(place: Path, code: str, *changes: Sequence[str], **more: Any) -> Path:
    text = PROTOCOL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = place / "study.toml"
    path.write_text(text)
    run_session(
        path, code, rehearsal_desk(PERSON), runner=FakeRunner(), study=place / "study", person=PERSON, **more
    )
    return place / "study" / code / "session.log"


def found_by_check(place: Path) -> dict[str, Any]:
    walls = load_walls(place / "study.toml")
    plan = check(walls.protocol, place, study=place / "study")
    return {one.name: one for one in plan.checks}


def test_changes_without_effect_on_results_are_recorded_and_block_nothing(tmp_path: Path) -> None:
    run(tmp_path, "P01")
    log = run(tmp_path, "P02", *(change for _, *change in NEUTRAL))
    keys = sorted(key for key, *_ in NEUTRAL)
    assert sorted(read(log)[0].content["differs"]) == keys
    study = read_study([tmp_path / "study"])
    (message,) = [one for one in study.messages if "that do not affect results" in one]
    assert all(key in message for key in keys)
    found = [one.detail for one in deviations(study) if one.what == "wording or conduct"]
    assert sorted(detail.partition(":")[0] for detail in found) == keys
    assert found_by_check(tmp_path)["protocol"].outcome is Outcome.OK


def test_changes_with_effect_on_results_are_named_before_anything_is_written(tmp_path: Path) -> None:
    changes, keys = [change for _, *change in DECIDING], sorted(key for key, *_ in DECIDING)
    run(tmp_path, "P01")
    with pytest.raises(ChangedProtocolError, match=r"sessions in .*:") as caught:
        run(tmp_path, "P02", *changes)
    assert "`other_protocol`" in caught.value.remedy
    assert not (tmp_path / "study" / "P02").exists()
    checked = found_by_check(tmp_path)["protocol"]
    assert checked.outcome is Outcome.WARNING
    log = run(tmp_path, "P02", *changes, other_protocol=True)
    assert sorted(read(log)[0].content["differs"]) == keys
    with pytest.raises(ConfigError, match="the protocols of the sessions differ: ") as refused:
        read_study([tmp_path / "study"])
    for key in keys:
        assert f"{key} (" in caught.value.message
        assert key in checked.text
        assert f"{key} (" in refused.value.message
        assert f"`across` {key}" in caught.value.remedy
        assert f"`across` {key}" in refused.value.remedy
    study = read_study([tmp_path / "study"], across=("trial", "search.highest", "study.seed"))
    stated = [one for one in study.messages if one.startswith("analysed together despite a difference in ")]
    assert all(any(f" {key} (" in message for message in stated) for key in keys)
    found = [(one.participant, one.detail) for one in deviations(study) if one.what == "another protocol"]
    assert sorted(detail.partition(":")[0] for code, detail in found if code == "P02") == keys


def test_the_rigs_own_file_is_compared_and_what_describes_it_is_not(tmp_path: Path) -> None:
    rig_file = tmp_path / "mine.toml"

    def with_rig(text: str, code: str) -> None:
        rig_file.write_text(f'preset = "koul-rigid"\n[rig]\n{text}')
        run(tmp_path, code, ('preset = "koul-rigid"', 'experiment = "mine.toml"'))

    with_rig('description = "mine"\n', "P01")
    with_rig('description = "mine, with a new cable"\n', "P02")
    with pytest.raises(
        ChangedProtocolError,
        match=r"experiment\.rig\.mechanics\.link_coulomb \(0\.0: P01, P02; 0\.002: here\)",
    ):
        with_rig("mechanics.link_coulomb = 0.002\n", "P03")


def test_a_title_that_shares_its_directory_with_another_is_asked_about(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "study.toml"

    def titled(title: str, code: str, study: Path | None = None) -> None:
        lines = [f'title = "{title}"' if one.startswith("title") else one for one in PROTOCOL.splitlines()]
        path.write_text("\n".join(lines))
        run_session(path, code, rehearsal_desk(PERSON), runner=FakeRunner(), study=study, person=PERSON)

    titled("C study", "P01")
    with pytest.raises(ChangedProtocolError, match=r'study\.title \("C study": P01; "C\+\+ study": here\)'):
        titled("C++ study", "P02")
    titled("C++ study", "P02", tmp_path / "elsewhere")
    titled("C study, renamed", "P03", tmp_path / "elsewhere")  # wording, where the directory was named


def test_a_terminal_asks_and_a_script_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.cli.session_run.DeviceRunner", lambda **_: FakeRunner())
    run(tmp_path, "P01")
    (tmp_path / "study.toml").write_text(PROTOCOL.replace("seed = 11", "seed = 12", 1))
    words = ["session", "run", str(tmp_path / "study.toml"), "P02", "--study", str(tmp_path / "study")]
    refused = CliRunner().invoke(rig, [*words, "--rehearse"])
    assert refused.exit_code != 0
    monkeypatch.setattr("rig.cli.session_run._is_interactive", lambda: True)
    left = CliRunner().invoke(rig, [*words, "--rehearse"], input="n\n")
    assert left.exit_code != 0
    assert "study.seed" in left.output
    begun = CliRunner().invoke(rig, [*words, "--rehearse"], input="y\n")
    assert begun.exit_code == 0, begun.output
    assert read(tmp_path / "study" / "P02" / "session.log")[0].content["differs"] == ["study.seed"]


def test_each_participant_is_estimated_on_the_levels_of_their_own_protocol(tmp_path: Path) -> None:
    person = SimulatedPerson(threshold=lambda condition, damping: 430.0)
    with without_sync():
        for row, (code, highest) in enumerate((("P01", 900.0), ("P02", 1000.0))):
            mapping = protocol(search={"highest": highest}, order={"repeats": 1})
            with sitting(tmp_path / code, mapping, person, code=code, row=row) as one:
                one.run()
    found = analyse([tmp_path], AnalysisOptions(across=("search.highest",)))
    k50 = {
        (one.participant, one.condition): one.mean
        for one in found.of_participants
        if one.measure == "K50 person"
    }
    assert np.allclose(list(k50.values()), 430.0, atol=60.0)
    alone = analyse([tmp_path / "P02"])
    for one in alone.of_participants:
        if one.measure == "K50 person":
            assert k50["P02", one.condition] == one.mean


@pytest.mark.parametrize(
    "change",
    [{"condition": [{"name": "uniform", "scheme": "uniform:2k"}]}, {"damping": [0.1]}],
    ids=["conditions", "dampings"],
)
def test_sessions_that_compare_other_things_are_two_studies(tmp_path: Path, change: dict[str, Any]) -> None:
    person = SimulatedPerson(threshold=lambda condition, damping: 430.0)
    mapping = protocol()
    conditions = change.get("condition") or [{**one, **change} for one in mapping["condition"]]
    with without_sync():
        for code, table in (("P01", mapping), ("P02", protocol(condition=conditions))):
            with sitting(tmp_path / code, table, person, code=code, row=int(code[1:])) as one:
                one.run(trials=1)
    with pytest.raises(ConfigError, match="compare different things: they differ in condition"):
        read_study([tmp_path], across=("condition",))


def test_a_key_that_an_earlier_version_did_not_know_is_no_difference(tmp_path: Path) -> None:
    log = run(tmp_path, "P01")
    began = read(log)[0].content["protocol"]
    older = {**began, "trial": {key: value for key, value in began["trial"].items() if key != "unsure"}}
    assert protocol_from_mapping(older, "older") == protocol_from_mapping(parse_toml(PROTOCOL, "x"), "x")
