"""Names and answers are normalised on input, so that spellings compare equal everywhere; titles name directories."""

from pathlib import Path
from typing import Any
from unicodedata import normalize

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.present import plain
from rig.session.engine._desk import Question
from rig.session.engine._directory import study_directory
from rig.session.engine._rehearsal import Person, thresholds_of
from rig.session.engine._run import rehearsal_desk, run_session
from rig.session.planning._items import describe_answer, describe_item, parse_answer
from rig.session.planning._keymap import KeyMap
from rig.session.planning._load import as_mapping, protocol_from_mapping
from rig.session.planning._protocol import Item, Keys, Protocol
from rig.session.terminal import _words as words
from rig.session.terminal._conversation import Answer, Conversation
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
        ("Z-width: 1_kHz (pilot)", "z-width-1-khz-pilot"),
        ("!!!", "study"),
        ("Größe (A)", "größe-a"),
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


SCALE = describe_item(Item(name="tired", text="How tired?", lowest=-2, highest=7))
CHOICE = describe_item(
    Item(name="hand", text="Which hand?", kind="choice", choices=("left", "right", "3", "1"))
)
TEXT = describe_item(Item(name="remarks", text="Anything?", kind="text"))


@pytest.mark.parametrize(
    ("item", "text", "kept"),
    [
        (SCALE, " 7 ", 7),
        (SCALE, "-2", -2),
        (SCALE, "8", None),
        (SCALE, "--5", None),
        (SCALE, "", None),
        (SCALE, "٥", None),
        (SCALE, "9" * 5000, None),
        (CHOICE, "left", "left"),
        (CHOICE, "2", "right"),
        (CHOICE, "1", "1"),  # the words win over the number
        (CHOICE, "4", "1"),
        (CHOICE, "0", None),
        (CHOICE, "5", None),
        (TEXT, "  none ", "none"),
        (TEXT, "--5", "--5"),
    ],
)
def test_an_answer_is_parsed_by_its_item(item: dict[str, Any], text: str, kept: str | int | None) -> None:
    assert parse_answer(item, text) == kept


@settings(max_examples=40)
@given(st.sampled_from([SCALE, CHOICE, TEXT]), st.text(max_size=12) | st.integers(-20, 20).map(str))
def test_an_answer_that_was_parsed_is_parsed_again_to_itself(item: dict[str, Any], text: str) -> None:
    once = parse_answer(item, text)
    assert once is None or parse_answer(item, str(once)) == once


@pytest.mark.parametrize(("text", "kept"), [("--5", None), ("8", None), ("-2", "-2"), ("07", "7")])
def test_the_console_takes_what_the_engine_takes(text: str, kept: str | None) -> None:
    conversation = Conversation(KeyMap.of(Keys()))
    question = Question(kind="item", text="How tired?", actions=("answer", "abort"), item=SCALE)
    conversation.ask(plain(question), 0.0)
    assert words.question(conversation, 0.0) == "How tired?  (-2 to 7)"
    assert words.list_offered(conversation)[0] == ("enter", "answer")
    answers = [answer for key in (*text, "enter") for answer in conversation.press(key)]
    assert answers == ([] if kept is None else [Answer("answer", kept)])
    assert (conversation.notice == f"please give {describe_answer(SCALE)}") is (kept is None)
