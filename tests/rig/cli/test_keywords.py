"""A named value is described once: commands, Python and experiment files print the same description."""

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import click
import pytest
from annotated_types import Ge, Gt, Le

import rig
from rig.cli._keyword_options import gathered_options
from rig.cli.command import GroupedCommand
from rig.cli.options import CommandSettings
from rig.config._table import parameters
from rig.core.keyword import Keyword, keywords
from rig.experiments.hits.hit import HitRequest
from rig.experiments.identification.identify import IdentifyRequest
from rig.experiments.lab import HitOptions
from rig.experiments.measure import IdentifyOptions
from rig.experiments.trials.settings import ExcitationSettings

TYPES = {float: "number", int: "whole number", bool: "true or false", str: "text"}


@dataclass(frozen=True)
class Asked:
    """A request with a value of every kind."""

    count: Annotated[int, Ge(1), Le(9), Keyword("How many.")] = 3
    share: Annotated[float | None, Gt(0), Le(1), Keyword("Of all.")] = None
    way: Annotated[Literal["up", "down"], Keyword("Which way.", names=("-w", "--which-way"))] = "up"
    side: Annotated[Literal["left", "right"] | None, Keyword("Which side.")] = None
    names: Annotated[tuple[str, ...], Keyword("Repeat it.")] = ()
    output: Annotated[str | Path, Keyword("Where.", group="Result", values="path")] = "here"
    by_hand: Annotated[bool, Keyword("No motor.")] = False
    silent: Annotated[int, Keyword()] = 0
    unasked: int = 0


def answered(*words: str) -> Any:
    """Return the request that a command builds from these words."""

    @click.command(cls=GroupedCommand)
    @gathered_options(Asked, "request")
    def command(request: Asked) -> Asked:
        return request

    return command.main(list(words), standalone_mode=False)


def test_a_field_makes_an_option_with_its_type_range_and_default() -> None:
    assert answered() == Asked(output=Path("here"))
    words = "--count 2 --share 0.5 -w down --side left --names a --names b --output x --by-hand"
    assert answered(*words.split()) == Asked(2, 0.5, "down", "left", ("a", "b"), Path("x"), True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--count 0", "0 is not in the range 1<=x<=9"),
        ("--share 0", "0.0 is not in the range 0<x<=1"),
        ("--which-way left", "'left' is not one of 'up', 'down'"),
        ("--side up", "'up' is not one of 'left', 'right'"),
        ("--silent 1", "No such option"),
        ("--unasked 1", "No such option"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(words: str, message: str) -> None:
    with pytest.raises(click.UsageError) as failed:
        answered(*words.split())
    assert message in failed.value.format_message()


@pytest.mark.parametrize("settings", [CommandSettings, ExcitationSettings])
def test_a_setting_has_type_range_and_unit_of_its_key(settings: type) -> None:
    hints = get_type_hints(settings)
    for name, one in keywords(settings).items():
        if not one.key:  # a band: two keys
            continue
        key = parameters()[one.key]
        if get_origin(hints[name]) is Literal:
            assert get_args(hints[name]) == key.choices, name
        elif key.kind not in ("table", "choice"):
            assert TYPES[hints[name]] == key.kind, name
        bounds = {f"≥ {m.ge:g}" for m in one.marks if isinstance(m, Ge)}
        bounds |= {f"≤ {m.le:g}" for m in one.marks if isinstance(m, Le)}
        assert bounds <= set(key.bounds), name
        if one.help and key.unit not in ("", "1"):
            assert f"({key.unit_for(None)})" in one.help, name


@pytest.mark.parametrize(
    ("options", "request_"), [(HitOptions, HitRequest), (IdentifyOptions, IdentifyRequest)]
)
def test_the_keywords_of_a_function_are_the_fields_of_its_request(options: type, request_: type) -> None:
    asked, given = get_type_hints(request_), get_type_hints(options)
    for name in set(asked) & set(given) - {"law"}:
        assert asked[name] in (given[name], given[name] | None), name


def test_python_shows_every_keyword_with_range_and_unit() -> None:
    for function in (rig.hit, rig.load, rig.plan, rig.compare):
        named = inspect.signature(function).parameters
        assert set(named) > {"stiffness", "duration_s", "operator", "changes"}
        assert not any(one.kind is inspect.Parameter.VAR_KEYWORD for one in named.values())
    assert set(get_type_hints(HitOptions)) <= set(inspect.signature(rig.hit).parameters)
    assert inspect.signature(rig.hit).parameters["verified"].default is False
    text = inspect.getdoc(rig.hit) or ""
    assert "* `stiffness`: K; a number ≥ 0 N·m/rad or N/m (``wall.stiffness``)" in text
    assert "* `arm_anyway`: Arm a real rig although" in text
    assert text.index("`stiffness`") < text.index("Raises")
