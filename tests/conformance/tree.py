"""The product's modules and their imports, read from the sources without importing anything."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from rig.realtime.source_files import PACKAGES, source_files

ROOT = Path(__file__).parents[2]
IMPORT = re.compile(r"^ *(?:from ([\w.]+) import (\([^)]*\)|.+)|import ([\w., ]+))", re.MULTILINE)


@cache
def modules() -> dict[str, Path]:
    """Return the path of each module by its dotted name."""
    return source_files(PACKAGES)


def tree_of(module: str) -> ast.Module:
    """Parse a module; not cached, because the trees of all modules take 160 MB per worker."""
    return ast.parse(modules()[module].read_text(encoding="utf-8"))


def module_of(name: str) -> str:
    """Return the module that a dotted name is, or is defined in; empty if it is not in this product."""
    while name and name not in modules():
        name = name.rpartition(".")[0]
    return name


def room_of(module: str) -> str:
    """Return the package of a module: ``control`` for `rig.control.step`, ``extras.console`` inside that extra."""
    parts = module.split(".")
    if parts[0] != "rig":
        return parts[0]
    if parts[1:2] == ["extras"]:
        return ".".join(parts[1:3])
    is_room = len(parts) > 2 or (len(parts) == 2 and modules()[module].name == "__init__.py")
    return parts[1] if is_room else "(rig)"


@cache
def imports_of(module: str) -> frozenset[str]:
    """Return the modules of this product that a module imports anywhere, also in an example in a string.

    Found by a pattern: to parse every file takes ten times as long (3 s, 2026-11-30).
    """
    names: list[str] = []
    for origin, imported, plain in IMPORT.findall(modules()[module].read_text(encoding="utf-8")):
        found = re.findall(r"([\w.]+)(?: as \w+)?", re.sub("#.*", "", imported or plain))
        names += [f"{origin}.{name}" if origin else name for name in found]
    return frozenset(found for name in names if (found := module_of(name)) and found != module)


def crossings() -> Iterator[tuple[str, str]]:
    """Yield the importing and the imported module of each import between two packages."""
    for module in modules():
        for other in sorted(imports_of(module)):
            if room_of(other) != room_of(module):
                yield module, other


def closure_of(module: str) -> frozenset[str]:
    """Return a module and all that it imports directly or indirectly, which a reader may have to open."""
    seen: set[str] = set()
    todo = [module]
    while todo:
        one = todo.pop()
        if one not in seen:
            seen.add(one)
            todo += imports_of(one)
    return frozenset(seen)


def lines_of(module: str) -> int:
    return modules()[module].read_text(encoding="utf-8").count("\n")
