"""Build the firmware for a Cortex-M and simulate it; a missing tool skips the test."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import pytest

from rig.firmware import _cortex as cortex
from rig.firmware._cortex import RAM, CortexCore, Image
from rig.firmware._toolchain import find_compiler
from tests.firmware import cross
from tests.firmware.build import FIRMWARE
from tests.firmware.kept import content, kept

__all__ = ["CORES", "RAM", "CortexCore", "Image", "Simulator", "build"]
CORES = {name: core for name, core in cortex.CORES.items() if core.cycles_known}


def build(core: CortexCore, sources: Sequence[Path], entries: Sequence[str], *more: str) -> Image:
    """Compile and link sources of the firmware for a core."""
    cross.need_compiler()
    options = [*(f"-I{FIRMWARE / part}" for part in ("core", "law")), *more]

    def make(output: Path) -> None:
        image = cortex.build(core, output, sources, entries, *options)
        (output / "image").write_bytes(pickle.dumps(image))

    read = content({*FIRMWARE.rglob("*.[ch]"), Path(cortex.__file__), *sources})
    key = f"{core} {find_compiler()} {sources} {entries} {options} {read}"
    image: Image = pickle.loads((kept(key, make) / "image").read_bytes())
    return image


class Simulator(cortex.Simulator):
    """A simulated core with an image in its flash."""

    def __post_init__(self) -> None:
        pytest.importorskip("unicorn", reason="unicorn is not installed (pip install unicorn==2.1.4)")
        super().__post_init__()
