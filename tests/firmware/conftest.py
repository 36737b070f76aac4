"""The firmware's library, built once in each test process."""

from __future__ import annotations

import ctypes

import pytest

from tests.firmware import build, core


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return core.load(build.library(tmp_path_factory.mktemp("firmware")))
