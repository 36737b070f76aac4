"""A page's message is either a valid request or rejected with an error that names the field."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.extras.console import requests as asked
from rig.extras.console.requests import Request, request_of
from rig.extras.console.trigger import Trigger

KINDS: dict[str, type[Request]] = {
    "operate": asked.Operate, "run": asked.Run, "set": asked.Set, "hand": asked.Hand, "show": asked.Show,
}  # fmt: skip


def test_a_request_is_what_it_says() -> None:
    text = json.dumps(
        {"do": "show", "number": 3, "columns": ["position"], "trigger": {"on": "velocity", "level": 1}}
    )
    request = request_of(text, KINDS)
    assert request == asked.Show(
        do="show", number=3, columns=("position",), trigger=Trigger(on="velocity", level=1.0)
    )


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ({}, "unknown request"),
        ({"do": ["run"]}, "unknown request"),
        ({"do": "operate"}, "take"),
        ({"do": "operate", "take": "yes"}, "take"),
        ({"do": "operate", "take": True, "else": 1}, "else"),
        ({"do": "run", "job": "hit", "changes": {"a": {"b": 1}}}, "changes"),
        ({"do": "run", "job": "hit", "rig": "x" * 5000}, "rig"),
        ({"do": "hand", "position": None}, "position"),
        ({"do": "hand", "position": 1.0, "number": -1}, "number"),
    ],
)
def test_a_wrong_field_is_named(message: Any, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        request_of(json.dumps(message), KINDS)


def test_a_wrong_field_is_named_with_its_value_and_what_is_allowed() -> None:
    message = {"do": "run", "job": "format"}
    with pytest.raises(ConfigError, match=r"field job = \"format\" is not valid: .*'hit' or 'play'; send"):
        request_of(json.dumps(message), KINDS)
    with pytest.raises(ConfigError, match=r'unknown request "shutdown"; send one of operate, run'):
        request_of('{"do": "shutdown"}', KINDS)


@pytest.mark.parametrize(
    "text", ["NaN", '{"do":"hand","position":NaN}', '{"do":"hand","position":1e999}', "[" * 9999, b"\xff"]
)
def test_text_that_is_no_json_is_refused(text: str | bytes) -> None:
    with pytest.raises(ConfigError):
        request_of(text, KINDS)


@given(st.binary(max_size=64))
def test_any_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(ConfigError):
        request_of(data, KINDS)
