"""The cross compiler and the emulator for tests, and images that are built once in a test process."""

from __future__ import annotations

import functools
import shutil
import subprocess
from pathlib import Path

import pytest

from rig import config, presets
from rig.firmware.build import BuildRequest, BuildResult, build
from rig.firmware.toolchain import COMPILER

RIG = "koul-rigid"


def need_compiler() -> None:
    """Skip the test where there is no cross compiler with a C library."""
    if shutil.which(COMPILER) is None:
        pytest.skip(f"{COMPILER} is not installed (package gcc-arm-none-eabi)")
    if not _has_newlib():
        pytest.skip("newlib is not installed (package libnewlib-arm-none-eabi)")


@functools.cache
def _has_newlib() -> bool:
    command = [COMPILER, "-E", "-include", "string.h", "-x", "c", "/dev/null"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def need_qemu() -> str:
    """The emulator; skips the test without one."""
    path = shutil.which("qemu-system-arm")
    if path is None:
        pytest.skip("qemu-system-arm is not installed (package qemu-system-arm)")
    return path


def image(board: str, directory: Path, application: str = "device", rig: str = RIG) -> BuildResult:
    """Build an image into a directory of its own."""
    need_compiler()
    model = config.rig_model(presets.load(rig))
    return build(BuildRequest(model=model, board=board, output=directory, application=application))
