"""Rules of the source tree: one description per package, no cycle of files, no bypass of the import contracts."""

import ast
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.conformance.tree import ROOT, imports_of, modules, tree_of

RIG = ROOT / "rig"
ROOMS = sorted(path.name for path in RIG.iterdir() if (path / "__init__.py").is_file())
MODULE_BY_NAME = re.compile(r"[\"']((?:rig|sim_backend|firmware_protocol)(?:\.\w+)+)(?::\w+)?[\"']")
# Registries that may name modules by string: those of their own room, and the simulation.
REGISTRIES = {
    "rig/cli/_table.py": "rig.cli.",
    "rig/cli/hit.py": "rig.views.plots.",  # the process that draws
    "rig/cli/session_protocol.py": "rig.session.",
    "rig/devices/__init__.py": ("rig.devices.", "sim_backend."),
    "rig/control/laws.py": "rig.control.",
    "rig/control/estimators/_family.py": "rig.control.estimators.",
    "rig/control/estimators/__init__.py": "rig.control.estimators.",
    "rig/docs/conf.py": "sim_backend.",  # the program that writes the first page's wall
}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_the_same_of_itself_and_in_the_design(room: Any) -> None:
    sentence = (RIG / room / "__init__.py").read_text().removeprefix('"""').split("\n")[0].removesuffix('"""')
    design = " ".join((RIG / "DESIGN.md").read_text().split())
    assert f"* **{room}**: {sentence[0].lower()}{sentence[1:]} " in design


def test_no_file_is_part_of_a_cycle() -> None:
    state: dict[str, int] = {}
    way: list[str] = []

    def visit(module: str) -> None:
        state[module] = 1
        way.append(module)
        for other in sorted(imports_of(module)):
            assert state.get(other) != 1, " -> ".join([*way[way.index(other) :], other])
            if other not in state:
                visit(other)
        way.pop()
        state[module] = 2

    for module in modules():
        if module not in state:
            visit(module)


def named_by_string() -> Iterator[tuple[str, str, str]]:
    """Yield file, module, and every module of this product that the file names in a string."""
    for module, path in modules().items():
        for match in MODULE_BY_NAME.finditer(path.read_text(encoding="utf-8")):
            if match[1] in modules():
                yield str(path.relative_to(ROOT)), module, match[1]


def test_no_way_around_the_contracts_by_string() -> None:
    """A resource or a child process may only name its own module or the package around it."""
    around = [
        f"{file} names {named}"
        for file, module, named in named_by_string()
        if not named.startswith(REGISTRIES.get(file, "\0")) and not f"{module}.".startswith(f"{named}.")
    ]
    assert around == []


def test_every_child_of_this_interpreter_takes_no_module_from_the_working_directory() -> None:
    commands = [
        ast.unparse(node)
        for module, path in modules().items()
        if "sys.executable" in path.read_text()
        for node in ast.walk(tree_of(module))
        if isinstance(node, ast.List) and node.elts and ast.unparse(node.elts[0]) == "sys.executable"
    ]
    assert len(commands) == 8
    assert [command for command in commands if not command.startswith("[sys.executable, '-P', ")] == []
