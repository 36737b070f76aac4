"""Find the Python files of this project, and those on which compiled code depends.

Compiled code of a kernel contains the code of its helpers and constants of other modules: it is outdated if a file with
a kernel changes, or any file that such a file imports, directly or indirectly.

The cache of machine code, sweeps, sessions and papers call it. It must not import a file that it examines.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Container, Iterable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("firmware_protocol", "rig", "sim_backend")
_KERNEL = b"\n@kernel("  # in a text whose first line begins like any other
_IMPORT = re.compile(
    rb"\n[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([\w.]+))"
)
_NAME = re.compile(rb"(\w+)(?:[ \t]+as[ \t]+\w+)?")


def source_files(packages: Iterable[str] = PACKAGES) -> dict[str, Path]:
    """Return the path of each Python file of the packages by module name, in a fixed order, without importing it."""
    return {module: Path(path) for module, path in _find_files(packages).items()}


def compiled_sources(packages: Iterable[str] = PACKAGES) -> dict[str, bytes]:
    """Return the content of all files with kernels and of all that they import, by module name, in a fixed order."""
    texts = {module: _text(path) for module, path in _find_files(packages).items()}
    waiting = [module for module, text in texts.items() if _KERNEL in text]
    reached: set[str] = set()
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting += _find_imports(texts[module], texts)
    return {module: text for module, text in texts.items() if module in reached}


def _find_files(packages: Iterable[str]) -> dict[str, str]:
    files: dict[str, str] = {}
    for package in packages:
        try:
            spec = importlib.util.find_spec(package)
        except ImportError:
            continue
        for root in (spec and spec.submodule_search_locations) or ():
            files.update(_below(root, package))
    return files


def _below(place: str, package: str) -> Iterator[tuple[str, str]]:
    for entry in sorted(os.scandir(place), key=lambda entry: entry.name):
        stem, ending = os.path.splitext(entry.name)
        if ending == ".py":
            yield package if stem == "__init__" else f"{package}.{stem}", entry.path
        elif not ending and stem != "__pycache__" and entry.is_dir(follow_symlinks=False):
            yield from _below(entry.path, f"{package}.{stem}")


def _text(path: str) -> bytes:
    with open(path, "rb", buffering=0) as file:
        return b"\n" + file.read()


def _find_imports(text: bytes, modules: Container[str]) -> list[str]:
    """Return those of `modules` that a source text imports: at its top, inside functions, or for types."""
    found: list[str] = []
    for base, names, plain in _IMPORT.findall(text):
        module = (base or plain).decode()
        parts = [f"{module}.{name.decode()}" for name in _NAME.findall(names)] if base else []
        found += [name for name in (module, *parts) if name in modules]
    return found


@cache
def code_version() -> str:
    """Return the version of this package with a hash of its sources; results depend on both."""
    digest = sha256()
    for path in source_files().values():
        digest.update(path.name.encode() + b"\0" + sha256(path.read_bytes()).digest())
    return f"{version('haptic-rig')}+{digest.hexdigest()[:12]}"
