"""Find the Python files of this project, and the files on which compiled code depends.

The machine code of a kernel contains code of helpers and constants from other modules. It is outdated if the kernel's
file changes, or any file that the kernel's file imports, directly or indirectly.

The cache of machine code, sweeps, sessions and papers use it. It must not import a file that it examines.
"""

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
    """Return the path of each Python file in the given packages, keyed by module name, without importing a file."""
    return {module: Path(path) for module, path in _find_files(packages).items()}


def compiled_sources(packages: Iterable[str] = PACKAGES) -> dict[str, bytes]:
    """Return the content, by module name, of each file with kernels and each file that it imports, also indirectly."""
    texts = {module: _read_source(path) for module, path in _find_files(packages).items()}
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
            files.update(_find_below(root, package))
    return files


def _find_below(place: str, package: str) -> Iterator[tuple[str, str]]:
    for entry in sorted(os.scandir(place), key=lambda entry: entry.name):
        stem, ending = os.path.splitext(entry.name)
        if ending == ".py":
            yield package if stem == "__init__" else f"{package}.{stem}", entry.path
        elif not ending and stem != "__pycache__" and entry.is_dir(follow_symlinks=False):
            yield from _find_below(entry.path, f"{package}.{stem}")


def _read_source(path: str) -> bytes:
    with open(path, "rb", buffering=0) as file:
        return b"\n" + file.read()


def _find_imports(text: bytes, modules: Container[str]) -> list[str]:
    """Return the names among `modules` that a Python source imports, also inside functions or for type checking."""
    found: list[str] = []
    for base, names, plain in _IMPORT.findall(text):
        module = (base or plain).decode()
        parts = [f"{module}.{name.decode()}" for name in _NAME.findall(names)] if base else []
        found += [name for name in (module, *parts) if name in modules]
    return found


@cache
def code_version() -> str:
    """Return the version of this package and a hash of its source files, for example ``1.2.0+0123456789ab``."""
    digest = sha256()
    for path in source_files().values():
        digest.update(path.name.encode() + b"\0" + sha256(path.read_bytes()).digest())
    return f"{version('haptic-rig')}+{digest.hexdigest()[:12]}"
