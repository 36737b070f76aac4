"""Answers to the questionnaire: console, engine and corrections parse them with the same function."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.present import plain
from rig.session.engine._desk import Question
from rig.session.planning._items import describe_answer, describe_item, parse_answer
from rig.session.planning._keymap import KeyMap
from rig.session.planning._protocol import Item, Keys
from rig.session.terminal import _words as words
from rig.session.terminal._conversation import Answer, Conversation

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
