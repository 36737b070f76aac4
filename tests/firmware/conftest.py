"""Fixtures: the firmware's library, and its law alone, each built once per test process."""

import ctypes

import pytest

from sim_backend.board import firmware_library
from tests.firmware import build
from tests.firmware.law.law_library import LawLibrary


@pytest.fixture(scope="session")
def library() -> ctypes.CDLL:
    return firmware_library.load(build.library())


@pytest.fixture(scope="session")
def law() -> LawLibrary:
    """The law in C as a separate library."""
    return LawLibrary.built()
