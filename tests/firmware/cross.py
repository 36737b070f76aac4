"""The cross compiler and the emulator for tests; each image is built once for each state of the sources."""

import functools
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rig import config
from rig.config import amplifiers, presets
from rig.core.model import RigModel
from rig.core.present import plain
from rig.firmware import _boards as boards
from rig.firmware._build import BuildRequest, BuildResult, build, sources_hash
from rig.firmware._toolchain import COMPILER, find_compiler
from rig.realtime.source_files import source_files
from tests.firmware.build import FIRMWARE, content, kept

RIG = "koul-rigid"
PYTHON = ("firmware_protocol", "rig.firmware", "rig.config", "rig.core")  # what configures an image


def need_compiler() -> None:
    if shutil.which(COMPILER) is None:
        pytest.skip(f"{COMPILER} is not installed (package gcc-arm-none-eabi)")
    if not _has_newlib():
        pytest.skip("newlib is not installed (package libnewlib-arm-none-eabi)")


@functools.cache
def _has_newlib() -> bool:
    command = [COMPILER, "-E", "-include", "string.h", "-x", "c", "/dev/null"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def need_qemu() -> str:
    path = shutil.which("qemu-system-arm")
    if path is None:
        pytest.skip("qemu-system-arm is not installed (package qemu-system-arm)")
    return path


@functools.cache
def image(board: str, application: str = "device", rig: str = RIG) -> BuildResult:
    return built(board, config.rig_model(presets.load(rig)), application)


def built(board: str, model: RigModel, application: str = "device", **settings: Any) -> BuildResult:
    need_compiler()

    def make(output: Path) -> None:
        request = BuildRequest(
            model=model, board=board, output=output, settings=settings, application=application
        )
        written = plain(build(request))
        (output / "built.json").write_text(json.dumps(written))

    key = f"image {boards.load(board).name} {model} {application} {settings} {sources_of(board)} {find_compiler()}"
    made = kept(key, make)
    written = json.loads((made / "built.json").read_text())
    paths = {
        kind: made / Path(written[kind]).name for kind in ("elf", "bin", "uf2", "facts") if written[kind]
    }
    return BuildResult(**{**written, **paths})


def sources_of(board: str) -> str:
    """Return a fingerprint of the C sources of a test image and of the Python that generates some."""
    beside = [path for part in ("host", "port_check") for path in (FIRMWARE / part).rglob("*.[ch]")]
    profiles = Path(amplifiers.__file__).parent.glob("*.toml")
    python = (path for module, path in source_files().items() if module.startswith(PYTHON))
    return sources_hash(boards.load(board)) + content([*beside, *profiles, *python])
