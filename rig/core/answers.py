"""Helpers to write a check of a computer or device as a function that returns a `Check`.

`rig.doctor`, `rig.firmware` and `rig.experiments` define their checks with it. It must not examine anything itself.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec

from rig.core.check import Check, Outcome

Asked = ParamSpec("Asked")


def ok(text: str) -> Check:
    """Return a passed check with this result text."""
    return Check("", Outcome.OK, text)


def warning(text: str, remedy: str = "") -> Check:
    """Return a check with a warning: the examined thing works, but less well or less reliably."""
    return Check("", Outcome.WARNING, text, remedy)


def refused(text: str, remedy: str = "") -> Check:
    """Return a failed check: the request is impossible, or a device has failed."""
    return Check("", Outcome.REFUSED, text, remedy)


def skipped(text: str) -> Check:
    """Return a skipped check; `text` says why its subject was not examined."""
    return Check("", Outcome.SKIPPED, text)


def question(name: str, why: str = "") -> Callable[[Callable[Asked, Check]], Callable[Asked, Check]]:
    """Return a decorator for functions that return a `Check`: it sets the check's name, and why it matters."""

    def named(answer: Callable[Asked, Check]) -> Callable[Asked, Check]:
        @wraps(answer)
        def check(*arguments: Asked.args, **options: Asked.kwargs) -> Check:
            return replace(answer(*arguments, **options), name=name, why=why)

        return check

    return named
