"""The firmware's library, and its law alone, built once in each test process."""

from __future__ import annotations

import ctypes

import pytest

from sim_backend import firmware_library
from tests.firmware import build
from tests.firmware.law.law_library import LawLibrary, compile_law


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return firmware_library.load(build.library(tmp_path_factory.mktemp("firmware")))


@pytest.fixture(scope="session")
def law(tmp_path_factory: pytest.TempPathFactory) -> LawLibrary:
    """The law in C as a library of its own."""
    return LawLibrary(compile_law(tmp_path_factory.mktemp("law") / "law.so", "-O2", "-fPIC", "-shared"))
