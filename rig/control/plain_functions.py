"""Compile laws and estimators that users write as plain Python functions.

The names of a function's arguments select what is passed, in any order: quantities of this tick, ``memory`` and ``p``.
Inside the function `p` and `memory` have named numbers (`Parameters`, `Memory`). They are stored as arrays, so that a
loop, a recording and a replay use them like the numbers of a built-in law.

If a function cannot be compiled, the error is one sentence with the line of the function, not the compiler's report.
"""

import inspect
import math
import re
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from keyword import iskeyword
from pathlib import Path
from typing import Any

import numba
import numpy as np

from rig.core.errors import ConfigError
from rig.realtime.handlers import interrupts_later
from rig.realtime.parts import load_implementations

NO_NUMBERS: Mapping[str, float] = {}
MEMORY, PARAMETERS = "memory", "p"  # arguments beside the quantities
_NUMBERS = (
    "use numbers, arithmetic, conditions, loops, functions of math, and helpers decorated by numba.njit"
)
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": False, "_nrt": False}


class Parameters:
    """Argument `p` of a user's law or estimator: each parameter is a constant attribute with the parameter's name."""

    def __getattr__(self, name: str) -> float:
        raise AttributeError(name)


class Memory:
    """Argument `memory` of a user's law or estimator: named numbers, zero at first, that last from call to call."""

    def __getattr__(self, name: str) -> float:
        raise AttributeError(name)

    def __setattr__(self, name: str, value: float) -> None:
        raise AttributeError(name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number of a law or an estimator that a user may choose: default, range, unit and meaning."""

    default: float
    minimum: float = -math.inf
    maximum: float = math.inf
    unit: str = ""
    meaning: str = ""

    def checked(self, function_name: str, name: str, value: float) -> float:
        """Return the value as a float; raise `ConfigError` if it is not a number within the parameter's range.

        The message names the parameter `name` of `function_name`, for example ``law 'mine'``.
        """
        if (
            not isinstance(value, int | float)
            or not self.minimum <= value <= self.maximum
            or math.isinf(value)
        ):
            span = f"{self.minimum:g} to {self.maximum:g} {self.unit}".rstrip()
            raise ConfigError(
                f"{function_name}: parameter {name} = {value!r} is out of range",
                remedy=f"give a number from {span}",
            )
        return float(value)


@dataclass(frozen=True, slots=True)
class Form:
    """Interface of a user's law or estimator: allowed arguments, common parameters, and the kernel that calls it.

    `quantities` maps the name of an argument to its meaning and to its expression in the kernel. `given` are the names
    of the parameters that every `p` has; they come first. `memory` is the expression for the user's numbers in the
    memory, ``{count}`` of them. `around` is the source text of the kernel, in which ``{call}`` is replaced by the call
    of the function; `names` maps the names used in that source to objects.
    """

    kind: str
    quantities: Mapping[str, tuple[str, str]]
    given: tuple[str, ...]
    memory: str
    around: str
    names: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Compiled:
    """A user's law or estimator after compilation: the kernel that calls it, its parameters, names of its memory."""

    name: str
    summary: str
    kernel: Callable[..., float]  # not yet declared as one
    parameters: Mapping[str, Parameter]
    memory: tuple[str, ...]
    arguments: tuple[str, ...]  # of the function, by name


def compile_function(
    form: Form,
    function: Callable[..., float],
    name: str | None,
    parameters: Mapping[str, float | Parameter],
    memory: Sequence[str],
) -> Compiled:
    """Check the arguments of a user's function, compile it, and return it with a kernel that calls it.

    `form` describes the allowed arguments; `name` defaults to the function's name, with hyphens.

    Raises
    ------
    ConfigError
        An argument, parameter or name of memory is invalid, or the function cannot be compiled.
    """
    function_name = f"{form.kind} {getattr(function, '__name__', function)!r}"
    own = {
        key: value if isinstance(value, Parameter) else Parameter(default=value)
        for key, value in parameters.items()
    }
    for key, parameter in own.items():
        parameter.checked(function_name, key, parameter.default)
    _check_names(function_name, "parameter", own, taken=form.given)
    _check_names(function_name, "memory", memory, taken=())
    arguments = _check_arguments(form, function_name, function, memory)
    seen = namedtuple("Parameters", [*form.given, *own])  # type: ignore[misc]
    kept = np.dtype((np.record, [(one, np.float64) for one in memory]))
    inner = _compile(form, function_name, function, arguments, seen, kept)
    numbers = ", ".join(f"parameters[{k}]" for k in range(len(seen._fields)))
    sources = {
        **{argument: source for argument, (_, source) in form.quantities.items()},
        MEMORY: f"{form.memory.format(count=len(memory))}.view(kept)[0]",
        PARAMETERS: f"seen({numbers})",
    }
    call = f"float(function({', '.join(sources[argument] for argument in arguments)}))"
    scope: dict[str, Any] = {**form.names, "function": inner, "seen": seen, "kept": kept}
    exec(compile(form.around.format(call=call), f"<{function_name}>", "exec"), scope)
    return Compiled(
        name=name or function.__name__.replace("_", "-"),
        summary=(inspect.getdoc(function) or function.__name__).partition("\n")[0],
        kernel=scope[form.kind],
        parameters=own,
        memory=tuple(memory),
        arguments=arguments,
    )


def unknown_name(function_name: str, noun: str, name: str, known: Iterable[str]) -> ConfigError:
    """Return the error for an unknown name; its remedy is the closest known name, or else all known names.

    `function_name` is the subject of the message (``law 'mine'``), `noun` the kind of the name ("parameter").
    """
    close = get_close_matches(name, list(known), n=1)
    choice = f"choose one of: {', '.join(known)}" if list(known) else f"remove it: no {noun} is defined"
    return ConfigError(
        f"{function_name}: unknown {noun} {name!r}", remedy=f"did you mean {close[0]}?" if close else choice
    )


def _check_names(function_name: str, noun: str, names: Iterable[str], taken: Sequence[str]) -> None:
    seen: set[str] = set(taken)
    for name in names:
        if not name.isidentifier() or iskeyword(name) or name.startswith("_"):
            raise ConfigError(
                f"{function_name}: {noun} {name!r} is not a valid name",
                remedy="use letters, digits and _, and begin with a letter",
            )
        if name in seen:
            why = f"is reserved: every p has {', '.join(taken)}" if name in taken else "is given twice"
            raise ConfigError(
                f"{function_name}: the name {name!r} of a {noun} {why}", remedy="choose another name"
            )
        seen.add(name)


def _check_arguments(
    form: Form, function_name: str, function: Callable[..., float], memory: Sequence[str]
) -> tuple[str, ...]:
    if not inspect.isfunction(function) or inspect.iscoroutinefunction(function):
        raise ConfigError(
            f"{function_name} is not a plain Python function",
            remedy="decorate a function that is defined by def",
        )
    known = {name: meaning for name, (meaning, _) in form.quantities.items()}
    known |= {MEMORY: "values that it stores", PARAMETERS: "its parameters"}
    signature = inspect.signature(function).parameters
    for argument in signature.values():
        argument_name = f"{function_name} ({_describe_place(function)}): argument {argument.name!r}"
        if argument.kind is not argument.POSITIONAL_OR_KEYWORD or argument.default is not argument.empty:
            raise ConfigError(
                f"{argument_name} must be positional, without a default",
                remedy="write only its name; declare numbers of your own as parameters of the decorator",
            )
        if argument.name not in known:
            close = get_close_matches(argument.name, known, n=1)
            choice = "; ".join(f"{name}: {meaning}" for name, meaning in known.items())
            raise ConfigError(
                f"{argument_name} is unknown",
                remedy=f"did you mean {close[0]}?" if close else f"choose from {choice}",
            )
        if argument.name == MEMORY and not memory:
            raise ConfigError(
                f"{argument_name} is used, but no memory is declared",
                remedy='declare the values that it stores: memory=("previous",)',
            )
    return tuple(signature)


def _compile(
    form: Form,
    function_name: str,
    function: Callable[..., float],
    arguments: Sequence[str],
    seen: type[tuple[float, ...]],
    kept: np.dtype[Any],
) -> Any:
    """Return a user's function compiled so that it cannot allocate; unchanged if numba's compiler is switched off."""
    if numba.config.DISABLE_JIT:
        return function
    length = len(seen._fields)  # type: ignore[attr-defined]
    others = {
        MEMORY: numba.from_dtype(kept),
        PARAMETERS: numba.types.NamedUniTuple(numba.float64, length, seen),
    }
    dispatcher = numba.njit(**_OPTIONS)(function)
    try:
        with interrupts_later():
            load_implementations()
            dispatcher.compile(tuple(others.get(argument, numba.float64) for argument in arguments))
    # Any exception: numba documents none, and a name that the function uses is evaluated here.
    except Exception as error:
        reason, remedy = _find_reason(str(error), form, seen, kept)
        line = _find_line(str(error), function)
        raise ConfigError(
            f"{function_name} ({_describe_place(function, line)}) cannot be compiled: {reason}", remedy=remedy
        ) from None
    returned = dispatcher.nopython_signatures[0].return_type
    if returned not in (numba.float64, numba.float32, numba.int64, numba.int32):
        optional = isinstance(returned, numba.types.Optional | numba.types.NoneType)
        problem = "returns no value on one of its paths" if optional else f"returns {returned}"
        raise ConfigError(
            f"{function_name} ({_describe_place(function)}) {problem}", remedy="return a number on every path"
        )
    return dispatcher


_FRAME = ("Failed in", "During", "raised from", "File", "- ", "There are")  # lines that say where, not what
# What the compiler says, and what that means here: the first that is found.
_REASONS: tuple[tuple[str, str, str], ...] = (
    (r"NameError: name '(\w+)' is not defined", "the name {0} is not defined", _NUMBERS),
    (r"Untyped global name '(\w+)'", "{0} cannot be used in compiled code", _NUMBERS),
    (
        r"Only accept returning of array|NRT required but not enabled",
        "it creates an array, a list or a text, and memory must not be allocated while a rig moves",
        "use single numbers; store those that must last in memory",
    ),
    (
        r"Cannot unify (\S+) and (\S+) for '(\w+)",
        "{2} is {0} in one place and {1} in another",
        "make it a number on every path",
    ),
    (
        r"No definition for lowering .*Parameters",
        "it assigns to a parameter",
        "store values that change in memory",
    ),
)


def _find_reason(
    text: str, form: Form, seen: type[tuple[float, ...]], kept: np.dtype[Any]
) -> tuple[str, str]:
    names, remembered = list(seen._fields), list(kept.names or ())  # type: ignore[attr-defined]
    for pattern, owner, known in (
        (r"Unknown attribute '(\w+)' of type Parameters", PARAMETERS, names),
        (r"^'(\w+)'$|Unknown attribute '(\w+)' of type Record", MEMORY, remembered),
    ):
        found = re.search(pattern, text)
        if found:
            missing = next(group for group in found.groups() if group)
            error = unknown_name(owner, "number", missing, known)
            return error.message, error.remedy
    for pattern, reason, remedy in _REASONS:
        found = re.search(pattern, text)
        if found:
            return reason.format(*found.groups()), remedy
    stripped = [line.strip() for line in text.splitlines() if line.strip()]
    plain = [line for line in stripped if not line.startswith(_FRAME)]
    return plain[0].partition(" Raised from")[0].rstrip(".") if plain else "no reason is given", _NUMBERS


def _find_line(text: str, function: Callable[..., float]) -> int | None:
    code = function.__code__
    lines = {line for _, _, line in code.co_lines() if line}
    file = re.escape(Path(code.co_filename).name)
    named = re.findall(rf"{file}(?:\", line | \()(\d+)", text)
    inside = [int(number) for number in named if int(number) in lines]
    return inside[0] if inside else None


def _describe_place(function: Callable[..., float], line: int | None = None) -> str:
    code = function.__code__
    return f"{Path(code.co_filename).name}, line {line or code.co_firstlineno}"
