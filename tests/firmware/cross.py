"""The cross compiler and the emulator for tests, and what is built with them: once for each state of the sources."""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rig import config
from rig.bench.firmware import boards
from rig.bench.firmware.build import BuildRequest, BuildResult, build, sources_hash
from rig.bench.firmware.toolchain import COMPILER, find_compiler
from rig.config import presets
from rig.core.present import plain
from rig.realtime.cache import cache_key
from rig.realtime.kernel import CACHE_DIRECTORY
from rig.realtime.source_files import source_files
from tests.firmware.build import FIRMWARE

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


@functools.cache
def image(board: str, application: str = "device", rig: str = RIG) -> BuildResult:
    """Return an image, built when nobody has yet."""
    need_compiler()
    model = config.rig_model(presets.load(rig))

    def make(output: Path) -> None:
        request = BuildRequest(model=model, board=board, output=output, application=application)
        written = plain(build(request))
        (output / "built.json").write_text(json.dumps(written))

    made = cached(f"image {board} {application} {rig} {sources_of(board)} {find_compiler()}", make)
    written = json.loads((made / "built.json").read_text())
    paths = {
        kind: made / Path(written[kind]).name for kind in ("elf", "bin", "uf2", "facts") if written[kind]
    }
    return BuildResult(**{**written, **paths})


def sources_of(board: str) -> str:
    """Fingerprint of all C files that an image for tests may have."""
    beside = (path for part in ("host", "port_check") for path in sorted((FIRMWARE / part).rglob("*.[ch]")))
    host = b"".join(path.read_bytes() for path in beside)
    return sources_hash(boards.load(board)) + hashlib.sha256(host).hexdigest()[:12]


def cached(key: str, make: Callable[[Path], None]) -> Path:
    """Return a directory that `make` has filled for this key, now or in an earlier run; two may try at once."""
    key += cache_key(source_files().values())  # every Python file: what generates C, too
    path = CACHE_DIRECTORY / f"test-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if not path.exists():
        with tempfile.TemporaryDirectory(dir=CACHE_DIRECTORY, prefix="test-") as workplace:
            made = Path(workplace) / "made"
            made.mkdir()
            make(made)
            try:
                made.rename(path)
            except OSError:
                assert path.exists()  # somebody else was quicker
    return path
