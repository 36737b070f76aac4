"""A pytest plug-in that records the examples of property tests: ``python -m pytest -p tests.conformance.drawn``.

Each test that ran adds a line to the file that `FILE` names in the environment: its name, the number of its examples
and a digest of all choices that hypothesis made for them.
"""

import hashlib
import os
from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import core

FILE = "HAPTIC_RIG_DRAWN"
_execute = core.StateForActualGivenExecution._execute_once_for_engine
_choices: list[str] = []


def _record_choices(state: Any, data: Any) -> None:
    try:
        _execute(state, data)
    finally:
        _choices.append(repr(data.choices))


core.StateForActualGivenExecution._execute_once_for_engine = _record_choices


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Record what hypothesis drew for one test."""
    _choices.clear()
    done = yield
    if _choices:
        digest = hashlib.sha256("\n".join(_choices).encode("utf-8", "backslashreplace")).hexdigest()
        with open(os.environ[FILE], "a", encoding="utf-8") as file:
            file.write(f"{item.nodeid} {len(_choices)} {digest}\n")
    return done
