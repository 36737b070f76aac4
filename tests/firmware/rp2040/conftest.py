"""Fixtures: emulated boards that run an image of the RP2040."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from rig.firmware._build import BuildResult
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.session import Session


@pytest.fixture(scope="session")
def built() -> BuildResult:
    return emulator.built("usual")[1]


@pytest.fixture(scope="session", autouse=True)
def emulators() -> Iterator[None]:
    yield
    emulator.end()


@pytest.fixture
def powered() -> Iterator[Callable[..., Session]]:
    """A function that powers up a board with one of `emulator.IMAGES`: without a rig, or with one at a position."""
    with ExitStack() as boards:

        def power(position: float | None = None, image: str = "usual") -> Session:
            model, made = emulator.built(image)
            return Session(boards.enter_context(emulator.Pico(model, made.bin, position=position)), made)

        yield power
