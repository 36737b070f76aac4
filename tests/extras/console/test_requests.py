"""A page's message is a valid request or an error that names the field, never an internal error."""

import json
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.core.errors import ConfigError
from rig.extras.console import requests as asked
from rig.extras.console import server
from rig.extras.console.errands import Errands
from rig.extras.console.jobs import Jobs
from rig.extras.console.requests import Request, request_of
from rig.extras.console.trigger import Trigger
from tests.conformance.console import served
from tests.extras.console.console_fakes import Here

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


FIRST = {bool: False, int: 1, float: 1.0, str: "koul-compliant", dict: {}, tuple: (), NoneType: None}
NUMBERS = ("1e308", "1e-308", "1e17", "-1.0", "0.0", "9223372036854775808", "1" + 400 * "0", "NaN", "1e999")
LONG, DEEP = '"' + 4096 * "é" + '"', 2000 * "[" + 2000 * "]"
OTHERS = (LONG, DEEP, '"\\u0000"', '"../.."', '"/dev/zero"', "true", "null", '{"a": {"a": 1}}')
KEYS = ("wall.damping", "rig.mechanics.motor_inertia", "trial.seed")


def plain_type(hint: Any) -> Any:
    """Return the first type that a field accepts."""
    while get_origin(hint) in (Annotated, Union, UnionType):
        hint = get_args(hint)[0]
    return hint


def required(kind: type[Request]) -> dict[str, Any]:
    """Return the required fields of a request, each with a usual value."""
    hints = get_type_hints(kind, include_extras=True)
    found: dict[str, Any] = {}
    for one in fields(kind):
        if one.name in ("do", "number") or one.default is not MISSING or one.default_factory is not MISSING:
            continue
        hint = plain_type(hints[one.name])
        found[one.name] = (
            get_args(hint)[0] if get_origin(hint) is Literal else FIRST[get_origin(hint) or hint]
        )
    return found


def contents(kind: type[Request]) -> Iterator[str]:
    """Yield requests of a kind with one unusual value each, as JSON, because a client need not be a browser."""
    usual = {name: json.dumps(value) for name, value in required(kind).items()}
    for one in fields(kind):
        if one.name in ("do", "number"):
            continue
        values = (
            [f'{{"{key}": {number}}}' for key in KEYS for number in NUMBERS] if one.name == "changes" else []
        )
        for value in (*NUMBERS, *OTHERS, *values):
            content = {**usual, one.name: value}
            yield ", ".join(f'"{name}": {value}' for name, value in content.items())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # where theory has no number
async def test_no_value_in_a_request_is_a_defect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def not_started(*_: Any, **__: Any) -> Any:
        raise ConfigError("nothing is started here", remedy="")

    consoles: list[server.Console] = []
    made = server.Console.__init__

    def keep(console: server.Console, *arguments: Any) -> None:
        made(console, *arguments)
        consoles.append(console)

    monkeypatch.setattr(server.Console, "__init__", keep)
    monkeypatch.setattr(Errands, "run", Here.run)
    monkeypatch.setattr(Jobs, "start", not_started)
    monkeypatch.setattr("rig.extras.console.bounds.MOST_A_SECOND", 1e9)
    monkeypatch.setattr("rig.extras.console.live.FRAME_S", 0.001)  # a zoom is answered with the next frame
    monkeypatch.chdir(tmp_path)
    defects: dict[tuple[str, str], str] = {}
    async with served(tmp_path) as console, console.page() as page:
        number, refused = 0, set()
        for do, kind in consoles[0]._kinds.items():
            for content in contents(kind):
                number += 1
                message = f'{{"do": "{do}", "number": {number}, {content}}}'
                try:
                    request_of(message, consoles[0]._kinds)
                except ConfigError:
                    if do in refused:  # one is sent of each
                        continue
                    refused.add(do)
                await page.socket.send(message)
                answer = await page.until(lambda page, number=number: page.answer(number) or page.answer(0))
                if "report it" in str((answer.get("error") or {}).get("remedy")):
                    defects[do, content[:200]] = answer["error"]["error"]
                page.messages.clear()
        assert number > 100
    assert not defects, "\n".join(f"{key}: {value}" for key, value in defects.items())
