"""Create the options of a command from the fields of its request, a dataclass with a help text for each field.

`rig.core.keyword` reads the fields.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, Literal, TypeVar, get_args, get_origin

import click
from annotated_types import Ge, Gt, Le

from rig.cli import _values as values
from rig.cli.command import option
from rig.core.keyword import Keyword, keywords

F = TypeVar("F", bound=Callable[..., Any])


def keyword_options(request: type, *names: str) -> Callable[[F], F]:
    """Return a decorator that adds a command-line option for each field in `names` of the dataclass `request`.

    Without names, it adds an option for each field that has a help text.
    """

    def add(function: F) -> F:
        for one in reversed(_chosen(request, names)):
            function = _option(one)(function)
        return function

    return add


def gathered_options(request: type, name: str, *fields: str) -> Callable[[F], F]:
    """Return a decorator that adds a command-line option for each of `fields` of the dataclass `request`.

    The command receives an instance of the dataclass, built from the options, as the argument `name`.
    """
    chosen = [one.name for one in _chosen(request, fields)]

    def add(function: F) -> F:
        @wraps(function)
        def called(**given: Any) -> Any:
            own = {field: given.pop(field) for field in chosen}
            return function(**given, **{name: request(**own)})

        return keyword_options(request, *chosen)(called)  # type: ignore[return-value]

    return add


def _chosen(request: type, names: tuple[str, ...]) -> list[Keyword]:
    return [one for name, one in keywords(request).items() if (name in names if names else one.help)]


def _option(one: Keyword) -> Callable[[F], F]:
    names = one.names or (f"--{one.name.replace('_', '-')}",)
    if one.type is bool:
        more: dict[str, Any] = {"is_flag": True}
    else:
        multiple = get_args(one.type)[1:] == (...,)
        kind = _type(one, get_args(one.type)[0] if multiple else one.type)
        shown = one.default not in (None, "", ())
        more = {"default": one.default, "show_default": shown, "multiple": multiple, "type": kind}
    return option(*names, one.name, group=one.group, help=one.help, metavar=one.metavar, **more)


def _type(one: Keyword, kind: Any) -> Any:
    if get_origin(kind) is Literal:
        return click.Choice(get_args(kind))
    if one.values:
        return values.KINDS[one.values]
    marks = {type(mark): mark for mark in one.marks}
    lowest, highest = marks.get(Ge) or marks.get(Gt), marks.get(Le)
    if lowest is None and highest is None:
        return kind
    return (click.IntRange if kind is int else click.FloatRange)(
        getattr(lowest, "ge", getattr(lowest, "gt", None)), getattr(highest, "le", None), min_open=Gt in marks
    )
