"""Helpers to write checks of a machine or device as functions that return a `Check`.

The packages `rig.doctor`, `rig.firmware` and `rig.experiments` define checks with it. It must not examine
anything itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec

from rig.core.check import Check, Outcome

Asked = ParamSpec("Asked")


def ok(text: str) -> Check:
    """Return a passed check, which needs no action."""
    return Check("", Outcome.OK, text)


def warning(text: str, remedy: str = "") -> Check:
    """Return a check with a warning: the examined thing works, but less well or less reliably."""
    return Check("", Outcome.WARNING, text, remedy)


def refused(text: str, remedy: str = "") -> Check:
    """Return a failed check: the request is impossible, or a device has failed."""
    return Check("", Outcome.REFUSED, text, remedy)


def skipped(text: str) -> Check:
    """Return a skipped check: its subject could not be examined, or the check was not requested."""
    return Check("", Outcome.SKIPPED, text)


def question(name: str, why: str = "") -> Callable[[Callable[Asked, Check]], Callable[Asked, Check]]:
    """Return a decorator that sets name and reason (`why`) in each check that the decorated function returns."""

    def named(answer: Callable[Asked, Check]) -> Callable[Asked, Check]:
        @wraps(answer)
        def check(*arguments: Asked.args, **options: Asked.kwargs) -> Check:
            return replace(answer(*arguments, **options), name=name, why=why)

        return check

    return named
