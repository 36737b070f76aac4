"""The tests of drives need the compiled bridge."""

import pytest

from tests.conformance.firmware import need_compiler


@pytest.fixture(scope="session", autouse=True)
def _compiler() -> None:
    need_compiler()
