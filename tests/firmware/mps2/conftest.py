"""Images for the emulator, built once for each processor."""

from __future__ import annotations

import functools
from collections.abc import Callable

import pytest

from rig.firmware.build import BuildResult
from tests.firmware import cross


@pytest.fixture(scope="session")
def tests_image(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], BuildResult]:
    """By board: the image that runs golden vectors, and lock-step with a plant."""

    @functools.cache
    def built(board: str) -> BuildResult:
        return cross.image(board, tmp_path_factory.mktemp("image"), "tests")

    return built
