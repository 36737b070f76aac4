"""The "doors" of `rig`, the modules that other packages import, are all listed in doors.txt."""

import json
import re

from rig.cli._table import TITLES
from tests.conformance.tree import PACKAGES, ROOT, crossings, module_of, modules, room_of

LIST = ROOT / "tests" / "doors.txt"
PROGRAMS = {"examples", "recipe"}  # to copy or to run, imported by nothing
NAME = re.compile(r"\brig(?:\.\w+)+")


def doors() -> set[str]:
    """Return the modules of `rig` that a module of another package imports."""
    return {other for _, other in crossings() if room_of(other) not in PACKAGES}


def named() -> set[str]:
    """Return the modules that are found by name: public names and tables of commands, schemes and pictures."""
    texts = [path.read_text() for path in (ROOT / "rig").rglob("*.pyi")]
    texts += [path.read_text() for path in (ROOT / "rig").rglob("table.json")]
    texts += [json.dumps(TITLES), (ROOT / "pyproject.toml").read_text().partition("[tool.")[0]]
    return {module_of(name) for text in texts for name in NAME.findall(text)}


def test_every_door_is_listed_and_every_one_listed_is_a_door() -> None:
    """A new door is a promise to other packages: use an existing one, or add it with its purpose."""
    listed = LIST.read_text(encoding="utf-8").split()
    assert listed == sorted(doors())


def test_no_room_imports_a_private_file_of_another() -> None:
    assert [
        f"{module} -> {other}"
        for module, other in crossings()
        if any(re.match("_(?!_)", part) for part in other.split("."))
    ] == []


def is_private_to_its_room(module: str) -> bool:
    path, room = modules()[module], room_of(module)
    is_core = module.startswith("rig.") and not room.startswith("extras") and room not in {"(rig)", "docs"}
    return is_core and not path.name.startswith("__") and not PROGRAMS & set(path.parts)


def test_a_file_that_its_own_room_alone_uses_begins_with_an_underscore() -> None:
    """Extras have no doors except those in their tables, so their files need no underscore."""
    used = doors() | named()
    assert [
        module
        for module in modules()
        if is_private_to_its_room(module)
        and module not in used
        and not any(part.startswith("_") for part in module.split("."))
    ] == []
