"""The two tiers of tests: the default one, and the exhaustive one, which repeats claims on further cases.

`pytest` runs the first one, `pytest -m exhaustive` the other, `pytest -m ""` both. Each test of the exhaustive tier
names a smaller relative of the default tier, which fails when the same mechanism breaks (`tests/test_tiers.py`):
``@pytest.mark.exhaustive("tests/rig/devices/test_usb.py::test_libusbs_statuses_are_error_numbers")``, in the same file
``@pytest.mark.exhaustive("::test_of_one_frame")``.
"""

from collections.abc import Iterable
from typing import Any

import pytest


def first_by_default(values: Iterable[Any], number: int = 1) -> list[Any]:
    """Return parameters of which only the first `number` run by default, as relatives of the others."""
    rest = pytest.mark.exhaustive("the same test, by its first parameters")
    found = list(values)
    return found[:number] + [_marked(value, rest) for value in found[number:]]


def _marked(value: Any, mark: Any) -> Any:
    if isinstance(value, type(pytest.param())):
        return pytest.param(*value.values, marks=[*value.marks, mark], id=value.id)
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=mark)
