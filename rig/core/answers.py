"""Questions about a machine or a device: a name and a reason stated once, and a function that answers with a check.

The rooms `doctor`, `firmware` and `experiments` state their checks with it. It must not examine anything itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec

from rig.core.check import Check, Outcome

Asked = ParamSpec("Asked")


def ok(text: str) -> Check:
    """Return a passing check, which needs no action."""
    return Check("", Outcome.OK, text)


def warning(text: str, remedy: str = "") -> Check:
    """Return the answer for what works, but less well or less surely."""
    return Check("", Outcome.WARNING, text, remedy)


def refused(text: str, remedy: str = "") -> Check:
    """Return a refusing check: the request is impossible, or a device has failed."""
    return Check("", Outcome.REFUSED, text, remedy)


def skipped(text: str) -> Check:
    """Return the answer for what could not be examined, or was not requested."""
    return Check("", Outcome.SKIPPED, text)


def question(name: str, why: str = "") -> Callable[[Callable[Asked, Check]], Callable[Asked, Check]]:
    """Give the answers of a function this name and this reason why they matter."""

    def named(answer: Callable[Asked, Check]) -> Callable[Asked, Check]:
        @wraps(answer)
        def check(*arguments: Asked.args, **options: Asked.kwargs) -> Check:
            return replace(answer(*arguments, **options), name=name, why=why)

        return check

    return named
