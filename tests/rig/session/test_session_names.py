"""Names are normalised on input, so that spellings compare equal everywhere; each study title has a directory."""

from pathlib import Path
from unicodedata import normalize

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.session.engine._directory import study_directory
from rig.session.engine._rehearsal import Person, thresholds_of
from rig.session.engine._run import rehearsal_desk, run_session
from rig.session.planning._items import describe_item, parse_answer
from rig.session.planning._load import as_mapping, protocol_from_mapping
from rig.session.planning._protocol import Item, Protocol
from tests.rig.session.session_fakes import FakeRunner, protocol_of, study
from tests.system.session_study import PROTOCOL

NBSP, NFD = "\u00a0", "Gro\u0308ße"


def directory_of(title: str) -> str:
    return study_directory(protocol_of(study=study(title=title)), None).name


def protocol_named(*conditions: str, practice: str | None = None) -> Protocol:
    table = {"condition": [{"name": name, "scheme": "dual:20k/2k"} for name in conditions]}
    return protocol_of(**table, **({} if practice is None else {"practice": {"condition": practice}}))


@pytest.mark.parametrize(
    ("title", "name"),
    [
        ("Two schemes", "two-schemes"),
        ("Z-width: 1_kHz (pilot)", "z-width-1-khz-pilot"),
        ("!!!", "study"),
        ("Größe (A)", "größe-a"),
        ("Grüße A", "grüße-a"),
        ("研究一", "研究一"),
        ("हिन्दी", "हिन्दी"),
    ],
)
def test_a_title_of_any_script_names_its_directory(title: str, name: str) -> None:
    assert directory_of(title) == name
    assert directory_of(normalize("NFD", title)) == name


@pytest.mark.parametrize(
    ("one", "other"), [("研究一", "研究二"), ("🙂", "🙃"), ("K ≤ 5", "K ≥ 5"), ("½", "?")]
)
def test_titles_that_differ_beyond_ascii_have_directories_of_their_own(one: str, other: str) -> None:
    assert directory_of(one) != directory_of(other)


@settings(max_examples=40)
@given(st.text(min_size=1, max_size=400).filter(str.strip))
def test_any_title_names_one_directory_that_a_file_system_takes(title: str) -> None:
    name = directory_of(title)
    assert len(name.encode()) <= 255
    assert name not in ("", ".", "..")
    assert "/" not in name
    assert name.isprintable()
    assert directory_of(f"  {title} ") == name


def test_names_are_made_one_spelling_where_they_enter() -> None:
    protocol = protocol_named(f" dual{NBSP} hidden\t", NFD, practice="dual\u3000hidden ")
    assert [one.name for one in protocol.condition] == ["dual hidden", "Größe"]
    assert protocol.practice.condition == "dual hidden"
    assert protocol_from_mapping(as_mapping(protocol), "again") == protocol
    assert thresholds_of([f" {NFD} =430"]) == {"Größe": 430.0}


def test_a_question_its_choices_and_what_is_fitted_are_names_too() -> None:
    question = [{"name": " hand ", "text": "Which?", "kind": "choice", "choices": [f"left{NBSP}one", NFD]}]
    (item,) = protocol_of(question=question).question
    assert (item.name, item.choices) == ("hand", ("left one", "Größe"))
    for typed, choice in (("left  one", "left one"), (NFD, "Größe")):
        assert parse_answer(describe_item(item), typed) == choice
    text = describe_item(Item(name="x", text="?", kind="text"))
    assert parse_answer(text, f" as{NBSP}typed ") == f"as{NBSP}typed"
    fits = [{"name": name, "fit": fit} for name, fit in (("a", "damper"), ("b", "damper "))]
    assert len({one.fit for one in protocol_of(condition=fits, order={"blocks": "condition"}).condition}) == 1


def test_a_code_is_a_name_as_well(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(PROTOCOL.replace("seed = 11", 'seed = 11\ncode = "Ä[0-9]{2}"', 1), encoding="utf-8")
    desk = rehearsal_desk(Person(thresholds={}))
    result = run_session(
        path, " A\u030801\n", desk, runner=FakeRunner(), study=tmp_path, person=Person(thresholds={})
    )
    assert (result.code, result.directory) == ("Ä01", tmp_path / "Ä01")
