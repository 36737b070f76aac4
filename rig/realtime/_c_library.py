"""Compile C code of this package to a shared library on first use, and keep the library on disk.

The library is stored beside the compiled kernels, under a name with a hash of sources, flags and compiler. It must not
be shared with another user.
"""

import ctypes
import hashlib
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rig.core.child import find_program, installed_path
from rig.core.errors import ConfigError

# Without contraction to fused multiply-add, like the builds of the tests; a missing symbol is an error of the
# linker here (-z defs), not when the library is opened.
FLAGS: tuple[str, ...] = ("-std=c99", "-O1", "-shared", "-ffp-contract=off")
if sys.platform == "linux":  # the linkers of the others want all symbols defined anyway
    FLAGS += ("-Wl,-z,defs",)
if sys.platform != "win32":  # where code is relocated
    FLAGS += ("-fPIC",)
COMPILERS = ("cc", "gcc", "clang")
ZIG = "ziglang"  # a C compiler as a package of Python, for systems that have none
COMPILE_S = 600.0  # longest compilation: ziglang builds its C library first, once
_SHOWN_LINES = 6  # of the compiler's output, in a message


def doubles(numbers: Any) -> Any:
    """Return a ctypes struct type whose members are doubles with the names and order of a dataclass's fields."""
    members = [(field.name, ctypes.c_double) for field in fields(numbers)]
    return type(numbers.__name__, (ctypes.Structure,), {"_fields_": members})


@dataclass(frozen=True, slots=True, kw_only=True)
class CLibrary:
    """C sources that are compiled to one shared library.

    Attributes
    ----------
    name
        Name of the library, for its file and for messages.
    root, parts
        Directory of the sources, and the names of its subdirectories that are compiled.
    purpose
        What the library is needed for, in messages.
    instead
        Alternative for a user without a compiler, as the end of a remedy; "" without an alternative.
    flags
        Flags for the compiler.
    """

    name: str
    root: Path
    parts: tuple[str, ...]
    purpose: str
    instead: str = ""
    flags: tuple[str, ...] = FLAGS

    def sources(self) -> list[Path]:
        """Return the paths of the C files of this library, in the order in which they are compiled."""
        return [path for part in self.parts for path in sorted((self.root / part).glob("*.c"))]

    def compiler(self) -> list[str]:
        """Return the command of a C compiler (``$CC``, cc, gcc, clang or ziglang); raise `ConfigError` without one."""
        named = shlex.split(os.environ.get("CC", ""))
        for command in (named, *([name] for name in COMPILERS)):
            found = find_program(command[0]) if command else None
            if found is not None:
                return [found, *command[1:]]
        if find_spec(ZIG) is not None:
            return [sys.executable, "-P", "-m", ZIG, "cc"]
        raise ConfigError(
            f"there is no C compiler, which is needed once: {self.purpose}, compiled from C on first use",
            remedy="install one (Debian: apt install gcc libc6-dev; elsewhere: pip install ziglang) or set CC to it"
            + (f"; or {self.instead}" if self.instead else ""),
        )

    def compiled(self, directory: Path) -> Path:
        """Return the path of this C library in `directory`, compiled if missing; raise `ConfigError` on failure."""
        command = self.compiler()
        path = directory / f"{self.name}-{self.key(command)}.so"
        if path.exists():
            return path
        with tempfile.TemporaryDirectory(dir=directory, prefix=f"{self.name}-") as workplace:
            made = Path(workplace) / f"{self.name}.so"
            self._compile([*command, *self.flags, "-o", str(made), *map(str, self.sources()), "-lm"])
            # Two processes may compile it at once: the later one replaces the file in one step.
            made.replace(path)
        return path

    def opened(self, directory: Path, load: Callable[[Path], ctypes.CDLL]) -> ctypes.CDLL:
        """Return this C library, compiled if missing and opened by `load`; raise `ConfigError` on failure."""
        path = self.compiled(directory)
        try:
            return load(path)
        except (OSError, AttributeError) as error:
            raise ConfigError(
                f"the compiled library {path} ({self.name}) cannot be opened: {error}",
                remedy="remove this file; the next run compiles the library again",
            ) from error

    def key(self, command: list[str]) -> str:
        """Return a hash (sixteen hex digits) of the C library's sources, its flags and the compiler."""
        # Size and time of the compiler instead of its version: an update is seen without running it.
        facts = Path(command[0]).resolve().stat()
        digest = hashlib.sha256(f"{command} {facts.st_size} {facts.st_mtime_ns} {self.flags}".encode())
        for part in self.parts:
            for path in sorted((self.root / part).glob("*.[ch]")):
                digest.update(f"{part}/{path.name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
        return digest.hexdigest()[:16]

    def _compile(self, command: list[str]) -> None:
        remedy = "set the variable CC to another compiler" + (f", or {self.instead}" if self.instead else "")
        try:
            done = subprocess.run(
                command,
                # ziglang places its cache in a home, and services have none in their environment.
                env={"HOME": os.path.expanduser("~"), **os.environ, "PATH": installed_path()},
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                timeout=COMPILE_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ConfigError(f"cannot start the C compiler {command[0]}: {error}", remedy=remedy) from error
        if done.returncode != 0:
            output = "\n".join((done.stderr or done.stdout).strip().splitlines()[:_SHOWN_LINES])
            raise ConfigError(
                f"the C compiler {command[0]} could not compile the library {self.name}:\n{output}",
                remedy=remedy,
            )
