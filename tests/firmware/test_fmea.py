"""Every entry of the table of single faults names existing tests, codes and steps; a missing test is reported."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from firmware_protocol.codegen import main
from firmware_protocol.faults import Fault, LimitFlag
from firmware_protocol.fmea import FMEA, SingleFault, single_faults
from rig.extras.drives.faults import DriveFault

ROOT = Path(__file__).parents[2]
ROWS = single_faults()
PARTS = {
    "encoder", "wires", "sensor", "host", "USB", "supply", "hang", "overrun", "bridge", "converter", "image",
    "parameters", "stop", "heat", "jam", "crystal", "drive",
}  # fmt: skip


@cache
def functions(path: str) -> set[str]:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.part}: {row.fault}"[:60])
def test_each_row_names_existing_tests_codes_and_steps(row: SingleFault) -> None:
    for test in row.tests:
        path, _, name = test.partition("::")
        assert name.startswith("test_")
        assert name in functions(path), test
    known = {*Fault.__members__, *LimitFlag.__members__, *DriveFault.__members__}
    assert set(row.codes) <= known
    steps = {
        int(number) for number in re.findall(r"^## (\d+)\. ", (FMEA.with_name("BENCH.md")).read_text(), re.M)
    }
    assert set(row.bench) <= steps
    assert row.found
    assert row.reaction
    assert row.remains


def test_every_fault_of_the_protocol_and_every_part_has_a_row() -> None:
    assert {row.part for row in ROWS} == PARTS
    named = {code for row in ROWS for code in row.codes}
    assert named >= {fault.name for fault in Fault if fault is not Fault.NONE}


def test_a_row_without_a_test_says_so_on_the_page() -> None:
    assert main(["--check"]) == 0
    page = FMEA.read_text(encoding="utf-8")
    assert page.count("**no test**") == sum(not row.tests for row in ROWS) > 0
