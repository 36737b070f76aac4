"""The firmware built for a Cortex-M; what is missing for that skips the test."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest

from rig.bench.firmware import cortex
from rig.bench.firmware.cortex import RAM, Core, Image
from tests.firmware.build import FIRMWARE

__all__ = ["CORES", "RAM", "Core", "Image", "Simulator", "build"]
CORES = {name: core for name, core in cortex.CORES.items() if core.cycles_known}


def build(core: Core, directory: Path, sources: Sequence[Path], entries: Iterable[str], *more: str) -> Image:
    """Compile and link sources of the firmware for a core."""
    if shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip(
            "arm-none-eabi-gcc is not installed (packages gcc-arm-none-eabi, libnewlib-arm-none-eabi)"
        )
    includes = [f"-I{FIRMWARE / part}" for part in ("core", "law")]
    return cortex.build(core, directory, sources, entries, *includes, *more)


class Simulator(cortex.Simulator):
    """One core with an image in its flash."""

    def __post_init__(self) -> None:
        pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
        super().__post_init__()
