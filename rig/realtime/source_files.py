"""The Python files of this project, and those on which compiled code depends.

A kernel freezes what it finds when it is compiled: the code of the helpers that it calls and the constants
(flags, phases, offsets of a message) of every module that it names. So machine code is fresh only while no file
changed that holds a kernel or that such a file imports, directly or not. Editing anything else compiles nothing.

Read as text, without importing anything, and quickly: each process asks when it starts.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Iterable
from pathlib import Path

PACKAGES = ("firmware_protocol", "rig", "sim_backend")
_KERNEL = b"\n@kernel("  # in a text whose first line begins like any other
_IMPORT = re.compile(
    rb"\n[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([\w.]+))"
)
_NAME = re.compile(rb"(\w+)(?:[ \t]+as[ \t]+\w+)?")


def source_files(packages: Iterable[str] = PACKAGES) -> dict[str, Path]:
    """Every Python file of the packages by module name, found without importing them, in a fixed order."""
    files: dict[str, Path] = {}
    for package in packages:
        try:
            spec = importlib.util.find_spec(package)
        except ImportError:
            continue
        if spec is None or not spec.submodule_search_locations:
            continue
        for root in spec.submodule_search_locations:
            for place, below, names in os.walk(root):
                below.sort()
                parts = (package, *Path(place).relative_to(root).parts)
                for name in sorted(names):
                    if name.endswith(".py"):
                        module = ".".join((*parts, name.removesuffix(".py")))
                        files[module.removesuffix(".__init__")] = Path(place, name)
    return files


def compiled_files(packages: Iterable[str] = PACKAGES) -> list[Path]:
    """The files with kernels and all that they import, transitively, in a fixed order."""
    files = source_files(packages)
    texts = {module: b"\n" + path.read_bytes() for module, path in files.items()}
    waiting = [module for module, text in texts.items() if _KERNEL in text]
    reached: set[str] = set()
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting += _imported(texts[module], files)
    return [path for module, path in files.items() if module in reached]


def _imported(text: bytes, files: dict[str, Path]) -> list[str]:
    """Modules of ours that a source imports anywhere in it: at its top, inside functions, for types."""
    found: list[str] = []
    for base, names, plain in _IMPORT.findall(text):
        module = (base or plain).decode()
        parts = [f"{module}.{name.decode()}" for name in _NAME.findall(names)] if base else []
        found += [name for name in (module, *parts) if name in files]
    return found
