"""The firmware's library, built once in each test process."""

from __future__ import annotations

import ctypes

import pytest

from sim_backend import firmware_library
from tests.firmware import build


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return firmware_library.load(build.library(tmp_path_factory.mktemp("firmware")))
