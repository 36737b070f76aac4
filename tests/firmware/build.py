"""Build the firmware for this machine: the library for ctypes, and programs under the address sanitizer."""

import fcntl
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pytest

from rig.realtime.kernel import CACHE_DIRECTORY
from sim_backend.board import firmware_library

SOURCES = firmware_library.FIRMWARE.sources()
FIRMWARE = firmware_library.FIRMWARE.root
CORE = [path for path in SOURCES if path.parent.name != "host"]
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror")
FLAGS = ("-std=c99", "-O1", "-g1", "-ffp-contract=off", *WARNINGS)
UNDEFINED = ("-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all")
ADDRESS = ("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
COMPILE_S = 120.0


def compiler() -> str:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed (package gcc)")
    return gcc


def compile_c(output: Path, sources: Sequence[Path], flags: Sequence[str]) -> Path:
    """Compile and link `sources`; a warning is an error."""
    command = [compiler(), *FLAGS, *flags, "-o", str(output), *map(str, sources), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=COMPILE_S, check=False)
    assert done.returncode == 0, done.stderr
    return output


def kept_c(name: str, sources: Sequence[Path], flags: Sequence[str]) -> Path:
    """Return the cached output of `compile_c`; sources include headers beside them and the firmware's files."""
    beside = {path for source in sources for path in source.parent.glob("*.h")}
    read = content({*FIRMWARE.rglob("*.[ch]"), *beside, *sources})

    def make(output: Path) -> None:
        compile_c(output / name, sources, flags)

    return kept(f"{name} {identity(compiler())} {FLAGS} {flags} {sources} {read}", make) / name


def kept_objects(gcc: str, sources: Sequence[Path], *flags: str) -> dict[Path, Path]:
    """Return the object file of each source of the firmware, optimised for size."""
    options = [*FLAGS, "-g0", "-Os", "-fno-stack-protector", *flags]

    def make(output: Path) -> None:
        command = [gcc, *options, "-c", *map(str, sources)]
        done = subprocess.run(
            command, cwd=output, capture_output=True, text=True, timeout=COMPILE_S, check=False
        )
        assert done.returncode == 0, done.stderr
        assert len(list(output.iterdir())) == len(sources), "two sources have one name"

    place = kept(f"{identity(gcc)} {options} {sources} {content(FIRMWARE.rglob('*.[ch]'))}", make)
    return {source: place / f"{source.stem}.o" for source in sources}


def library() -> Path:
    """Return the core with its host port as a shared library; undefined behaviour ends the process."""
    return kept_c("libfirmware.so", SOURCES, ["-fPIC", "-shared", *UNDEFINED])


# ---------------------------------------------------------------------- a cache, shared by test processes and runs


def kept(key: str, make: Callable[[Path], None]) -> Path:
    """Return a directory that `make` has filled for this key, now or in an earlier run; safe for parallel calls."""
    path = CACHE_DIRECTORY / f"test-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if not path.exists():
        with open(f"{path}.lock", "w") as lock, tempfile.TemporaryDirectory(dir=CACHE_DIRECTORY) as workplace:
            fcntl.flock(lock, fcntl.LOCK_EX)  # linking an image takes seconds: once is enough
            if not path.exists():
                made = Path(workplace) / "made"
                made.mkdir()
                make(made)
                made.rename(path)
    return path


def identity(program: str) -> str:
    place = Path(program).resolve()
    return f"{place} {place.stat().st_size} {place.stat().st_mtime_ns}"


def content(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
