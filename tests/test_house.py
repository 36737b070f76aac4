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


def walks() -> list[list[tuple[int, str, str]]]:
    """Return the rows of the walks in DESIGN.md: number, file, action."""
    text = (RIG / "DESIGN.md").read_text().partition("\n## Walks")[2].partition("\n## ")[0]
    tables = text.split("\n| | file |")[1:]
    rows = [re.findall(r"^\| (\d+) \| `([^`]+)` \| (.+) \|$", table, re.MULTILINE) for table in tables]
    return [[(int(number), file, what) for number, file, what in table] for table in rows]


def test_the_design_is_a_page() -> None:
    assert len((RIG / "DESIGN.md").read_text().splitlines()) <= 300
    assert len((RIG.parent / "README.md").read_text().splitlines()) <= 110
    for record in (RIG / "decisions").iterdir():
        assert len(record.read_text().splitlines()) <= 30, record.name


def test_the_walks_of_the_design_go_through_files_and_say_why_they_enter_a_room_again() -> None:
    host, device = walks()[1:3]
    assert [number for number, _, _ in device] == list(range(13, 13 + len(device)))
    whole = [walks()[0], host, host[:12] + device, *walks()[3:]]
    assert len(whole) == 5
    for steps in whole:
        files = [file for _, file, _ in steps]
        assert len(files) == len(set(files)), "a file stands in a walk once"
        assert [number for number, _, _ in steps] == list(range(1, len(steps) + 1))
        assert all((ROOT / file).is_file() for file in files), files
        rooms = [file.split("/")[1] if file.startswith("rig/") else file.split("/")[0] for file in files]
        again = {
            number
            for number, room, _ in zip(range(1, len(rooms) + 1), rooms, files, strict=True)
            if number > 1 and room != rooms[number - 2] and room in rooms[: number - 2]
        }
        assert {number for number, _, what in steps if what.startswith("back")} == again


def test_rig_holds_rooms_and_nothing_loose() -> None:
    assert {path.name for path in RIG.iterdir() if path.is_file()} == {
        "__init__.py", "__init__.pyi", "__main__.py", "DESIGN.md", "py.typed",
    }  # fmt: skip
    assert len(ROOMS) <= 16


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


def test_modules_are_imported_by_name_in_few_places() -> None:
    """Only for tables of names, optional libraries, and one module of numba."""
    found = {
        str(path.relative_to(ROOT))
        for path in modules().values()
        if re.search(r"import_module\(|resolve_name\(", path.read_text())
    }
    assert found == {
        "rig/core/lazy.py", "rig/core/extras.py", "rig/core/deferred.py",
        "rig/cli/_lazy.py", "rig/cli/session_protocol.py",
        "rig/control/laws.py", "rig/control/estimators/__init__.py", "rig/control/estimators/_family.py",
        "rig/devices/__init__.py", "rig/realtime/parts.py",
        "rig/extras/cluster/cluster.py", "rig/extras/lsl/library.py",
    }  # fmt: skip


def test_imports_stand_at_the_top_of_files() -> None:
    """Except in the ring and the entry, because `rig stop` must not wait for numba or click, and in extras.

    ruff demands the comment (PLC0415).
    """
    inside = {module for module, path in modules().items() if "noqa: PLC0415" in path.read_text()}
    assert inside == {"rig.realtime.ring", "rig.__main__", "rig.extras.console.cli"}


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
