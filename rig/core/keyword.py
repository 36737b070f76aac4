"""Declare a value that users give by name: an argument in Python, an option of a command, a field of a page's request.

The field of a request declares it once: ``Annotated[int, Ge(1), Keyword("How many hits.", key="trial.repeats")]``. Code
that checks, explains or asks for the value reads type, range, default and text there.

Requests of experiments and firmware declare them; commands and pages read them. It must not parse or check a value.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints


@dataclass(frozen=True, slots=True)
class Keyword:
    """Declaration of a value that users give by name: as an argument, an option of a command, or a field of a web form.

    `help` is its meaning with the unit; a command has an option for the value only if `help` is not empty.

    Attributes
    ----------
    key
        Dotted key of the experiment that the value changes; empty if it is not part of the experiment.
    names
        Names of the command-line option; if empty, the name of the field.
    group
        Group of the option on a help page.
    values, metavar
        Kind of values for shell completion (`rig.cli._values.KINDS`), and placeholder of the value on a help page.
    name, type, marks, default
        Name, type (without None), annotations and default of the declared field, filled in by `keywords`.
    """

    help: str = ""
    key: str = ""
    names: tuple[str, ...] = ()
    group: Literal["Experiment", "Options", "Excitation and judgement", "Device", "Result"] = "Options"
    values: str = ""
    metavar: str | None = None
    name: str = ""
    type: Any = None
    marks: tuple[Any, ...] = ()
    default: Any = None


@cache
def keywords(request: type) -> Mapping[str, Keyword]:
    """Return the declaration (`Keyword`) of each field of a dataclass or TypedDict that has one, by field name."""
    defaults = {one.name: one.default for one in fields(request)} if is_dataclass(request) else {}
    found = {}
    for name, hint in get_type_hints(request, include_extras=True).items():
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        default = defaults.get(name, MISSING)
        if get_origin(kind) in (UnionType, Union):  # the latter of Literal[…] | None
            kind = next(arm for arm in get_args(kind) if arm is not NoneType)
        for mark in marks:
            if isinstance(mark, Keyword):
                found[name] = replace(
                    mark,
                    name=name,
                    type=kind,
                    marks=tuple(marks),
                    default=None if default is MISSING else default,
                )
    return found
