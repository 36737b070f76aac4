"""Fixtures: images of the RP2040 and emulated boards that run them."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from rig.config._derive import rig_model
from rig.config._load import override
from rig.config.presets import load
from rig.core.model import RigModel
from rig.firmware._build import BuildResult
from tests.firmware.rp2040 import emulator
from tests.firmware.rp2040.session import Session

PRESET = "koul-rigid"


@pytest.fixture(scope="session")
def built() -> BuildResult:
    return emulator.image(rig_model(load(PRESET)))


@pytest.fixture(scope="session")
def built_dac() -> BuildResult:
    return emulator.image(rig_model(load(PRESET)), output="dac")


@pytest.fixture(scope="session")
def delayed() -> tuple[RigModel, BuildResult]:
    """A rig whose amplifier delays its set-point by 0.1 ms, as the profile of an ESCON by PWM states, and its image."""
    model = rig_model(override(load(PRESET), {"rig.amplifier.set_point_delay_s": 1e-4}))
    return model, emulator.image(model)


@pytest.fixture(scope="session", autouse=True)
def emulators() -> Iterator[None]:
    yield
    emulator.end()


@pytest.fixture
def boards() -> Iterator[Callable[..., Session]]:
    """A function that powers up a board with an image: without a rig, or with one at a position (rad)."""
    with ExitStack() as powered:

        def power(
            image: BuildResult, position: float | None = None, model: RigModel | None = None
        ) -> Session:
            pico = emulator.Pico(model or rig_model(load(PRESET)), image.bin, position=position)
            return Session(powered.enter_context(pico), image)

        yield power


@pytest.fixture
def powered(built: BuildResult, boards: Callable[..., Session]) -> Callable[..., Session]:
    return lambda position=None: boards(built, position)


@pytest.fixture
def powered_dac(built_dac: BuildResult, boards: Callable[..., Session]) -> Callable[..., Session]:
    return lambda position=None: boards(built_dac, position)


@pytest.fixture
def powered_delayed(
    delayed: tuple[RigModel, BuildResult], boards: Callable[..., Session]
) -> Callable[..., Session]:
    model, image = delayed
    return lambda position=None: boards(image, position, model)
