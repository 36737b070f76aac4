"""Public names of a package, listed only in the stub file beside its ``__init__.py`` and loaded on first use.

A type checker and an editor read the stub (``__init__.pyi``). Its lines ``from module import name as alias`` are also
the table from which the package resolves attributes. So stub and package cannot differ, and an import loads nothing.

`rig` and `rig.testing` use it, and the documentation build reads the tables. It must not import a module that would
slow down ``import rig``.
"""

from __future__ import annotations

import os
from importlib import import_module

_ROOMS = os.path.dirname(os.path.dirname(__file__))
TYPE_CHECKING = False  # `typing` and `collections` would be most of what ``import rig`` costs
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any


def public_names(init: str) -> dict[str, tuple[str, str]]:
    """Return (module, name) by public name, from a package's stub, without names of extras that are not installed."""
    table = {}
    with open(f"{init}i", encoding="utf-8") as stub:
        for line in stub:
            match line.split():
                case ["from", module, "import", name, "as", alias] if _is_installed(module):
                    table[alias] = (module, name)
    return table


def _is_installed(module: str) -> bool:
    # Only for extras the folder is looked up; a module of the core is taken as installed without a look at the disk.
    _, *parts = module.split(".")
    return parts[:1] != ["extras"] or os.path.isdir(os.path.join(_ROOMS, *parts[:2]))


def loader(package: str, table: Mapping[str, tuple[str, str]]) -> Callable[[str], Any]:
    """Return a ``__getattr__`` for a package that imports a public name on first use.

    `table` has the module and the name in it for each public name.
    """

    def loaded(name: str) -> Any:
        if name not in table:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, attribute = table[name]
        found = import_module(module)
        if not hasattr(found, attribute):  # a module of that package
            return import_module(f"{module}.{attribute}")
        return getattr(found, attribute)

    return loaded
