"""The names of a package that people import, stated once: in the stub beside its ``__init__``, and loaded on first use.

A stub (``__init__.pyi``) is what a type checker and an editor read; here its lines ``from module import name as alias``
are the table from which the package answers. So the two cannot differ, and importing the package loads nothing.

`rig` and `rig.testing` answer by it, and the builder of documents reads the tables. It must not import anything that
``import rig`` would have to pay for.
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
    """Return public name → module and name there, from the stub of the package whose ``__init__.py`` this is.

    Names of an extra that is not installed are left out.
    """
    table = {}
    with open(f"{init}i", encoding="utf-8") as stub:
        for line in stub:
            match line.split():
                case ["from", module, "import", name, "as", alias] if _is_installed(module):
                    table[alias] = (module, name)
    return table


def _is_installed(module: str) -> bool:
    """Return False for a module in the folder of an extra that does not exist; others are not looked for."""
    _, *parts = module.split(".")
    return parts[:1] != ["extras"] or os.path.isdir(os.path.join(_ROOMS, *parts[:2]))


def loader(package: str, table: Mapping[str, tuple[str, str]]) -> Callable[[str], Any]:
    """Return the ``__getattr__`` of a package with such a table."""

    def loaded(name: str) -> Any:
        if name not in table:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, attribute = table[name]
        found = import_module(module)
        if not hasattr(found, attribute):  # a module of that package
            return import_module(f"{module}.{attribute}")
        return getattr(found, attribute)

    return loaded
