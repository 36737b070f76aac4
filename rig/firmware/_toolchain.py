"""Find and run the C cross compiler for the board, and name the package to install if it is missing.

The build and `rig.firmware._cortex` use it. It must not install anything.
"""

import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.core.child import find_program, installed_path
from rig.core.errors import ToolchainError

COMPILER = "arm-none-eabi-gcc"
COMPILER_VARIABLE = "ARM_NONE_EABI_GCC"  # another one, by its path
COMPILE_S = 300.0
INSTALL = (
    "install it: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi (Debian, Ubuntu), brew install --cask "
    "gcc-arm-embedded (macOS), winget install Arm.GnuArmEmbeddedToolchain (Windows); or set "
    f"{COMPILER_VARIABLE}=/path/to/{COMPILER}"
)
_SHOWN_LINES = 12  # of the compiler's errors, in a message


@dataclass(frozen=True, slots=True)
class Compiler:
    """A working cross compiler: the path of its program, and its version text."""

    path: str
    version: str

    def run(self, arguments: Sequence[str], directory: Path) -> None:
        """Run the compiler in a directory; raise `ToolchainError` with the first lines of its errors if it fails."""
        done = _call([self.path, *arguments], directory)
        if done.returncode != 0:
            shown = "\n".join(done.stderr.strip().splitlines()[:_SHOWN_LINES])
            raise ToolchainError(f"the firmware cannot be built:\n{shown}\n", remedy=_remedy(done.stderr))

    def tool(self, name: str, arguments: Sequence[str], directory: Path) -> str:
        """Run a tool of the compiler, such as ``nm``; return what it printed. Raise `ToolchainError` if it fails."""
        done = _call([f"{self.path.removesuffix('gcc')}{name}", *arguments], directory)
        if done.returncode != 0:
            raise ToolchainError(f"the compiler's tool {name} failed: {done.stderr.strip()}", remedy=INSTALL)
        return done.stdout


def find_compiler() -> Compiler:
    """Return the installed cross compiler; raise `ToolchainError` if the compiler or its C library is missing."""
    named = os.environ.get(COMPILER_VARIABLE)
    path = find_program(named or COMPILER)
    if path is None:
        missing = (
            f"{COMPILER_VARIABLE} is {named}, which cannot be run"
            if named
            else f"{COMPILER} is not installed"
        )
        raise ToolchainError(missing, remedy=INSTALL)
    version = _call([path, "--version"], None)
    if version.returncode != 0 or not version.stdout:
        raise ToolchainError(f"the compiler {path} cannot be run: {version.stderr.strip()}", remedy=INSTALL)
    header = _call([path, "-E", "-include", "string.h", "-x", "c", os.devnull], None)
    if header.returncode != 0:
        raise ToolchainError(f"the compiler {path} has no C library: string.h is missing", remedy=INSTALL)
    return Compiler(path, version.stdout.splitlines()[0])


def _call(command: list[str], directory: Path | None) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "LC_ALL": "C", "PATH": installed_path()}
    if directory is not None:  # what an interrupted compiler leaves goes with it
        environment["TMPDIR"] = str(directory)
    try:
        return subprocess.run(
            command,
            cwd=directory,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=COMPILE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ToolchainError(f"the program {command[0]} cannot be run: {error}", remedy=INSTALL) from None


def _remedy(complaint: str) -> str:
    if "overflowed" in complaint or "will not fit" in complaint:
        return "the program is too large for the board: reduce the sizes in its board.toml, or use a larger board"
    if "#error" in complaint:
        return "change the setting that the compiler's message names"
    return "report this with the output above and the compiler's version"
