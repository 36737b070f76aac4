"""The compiled law, once for each process of tests."""

import pytest

from tests.firmware.law.law_library import LawLibrary, compile_law


@pytest.fixture(scope="session")
def law(tmp_path_factory):
    """The law in C as a shared library."""
    return LawLibrary(compile_law(tmp_path_factory.mktemp("law") / "law.so", "-O2", "-fPIC", "-shared"))
