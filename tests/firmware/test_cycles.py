"""No two files of the firmware depend on each other, neither by includes nor by calls."""

import re
import subprocess
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.firmware.build import FIRMWARE, SOURCES, compiler, kept_objects

Graph = Mapping[str, set[str]]  # file without its ending → those that it needs
INCLUDE = re.compile(r'^#include "([^"]+)"', re.MULTILINE)
GENERATED = {"board_config"}


def cycle_of(graph: Graph) -> list[str] | None:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return None


def includes() -> Graph:
    """Return the includes of each node; x.c and x.h are one."""
    files = [*FIRMWARE.rglob("*.c"), *FIRMWARE.rglob("*.h")]
    graph: dict[str, set[str]] = {}
    for path in files:
        needed = graph.setdefault(node_of(path), set())
        for name in INCLUDE.findall(path.read_text(encoding="utf-8")):
            beside = (path.parent / name).resolve()
            found = [beside] if beside.exists() else [file for file in files if file.name == name]
            assert len(found) == 1 or Path(name).stem in GENERATED, f"{path.name} includes {name}"
            needed |= {node_of(file) for file in found} - {node_of(path)}
    return graph


def node_of(path: Path) -> str:
    return str(path.relative_to(FIRMWARE).with_suffix(""))


def calls() -> Graph:
    """Return the files that define the symbols that each object file uses."""
    defined: dict[str, str] = {}
    wanted: dict[str, set[str]] = {}
    nodes = {str(built): node_of(source) for source, built in kept_objects(compiler(), SOURCES).items()}
    listed = subprocess.run(["nm", "-A", *nodes], capture_output=True, text=True, check=True).stdout
    for line in listed.splitlines():
        node = nodes[line.partition(":")[0]]
        kind, symbol = line.split()[-2:]
        if kind == "U":
            wanted.setdefault(node, set()).add(symbol)
        elif kind.isupper():
            defined[symbol] = node
    return {node: {defined[name] for name in names if name in defined} for node, names in wanted.items()}


def test_no_file_includes_itself_around_others() -> None:
    assert cycle_of(includes()) is None


def test_no_file_calls_itself_around_others() -> None:
    assert cycle_of(calls()) is None


@pytest.mark.parametrize(
    ("graph", "found"), [({"a": {"b"}, "b": {"a"}}, True), ({"a": {"b"}, "b": set()}, False)]
)
def test_a_way_around_is_found(graph: Graph, found: bool) -> None:
    assert (cycle_of(graph) is not None) is found
