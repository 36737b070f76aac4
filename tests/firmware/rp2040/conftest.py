"""The image, built once in each test process, and boards that run it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from rig.bench.firmware.build import BuildResult
from rig.config.derive import rig_model
from rig.config.presets import load
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.session import Session

PRESET = "koul-rigid"


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> BuildResult:
    return emulator.image(rig_model(load(PRESET)), tmp_path_factory.mktemp("rp2040"))


@pytest.fixture
def powered(built: BuildResult) -> Iterator[Callable[..., Session]]:
    """Power a board up: without a rig behind it, or with one at a position (rad)."""
    with ExitStack() as boards:

        def power(position: float | None = None) -> Session:
            pico = emulator.Pico(rig_model(load(PRESET)), built.bin, position=position)
            return Session(boards.enter_context(pico), built)

        yield power
