"""Property tests draw the same inputs in each run and in any worker, which has loaded other modules."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conformance.tiers import first_by_default

ROOT = Path(__file__).parents[1]
DRAW = """
import importlib, sys
import tests.conftest
for module in sys.argv[1:]:
    importlib.import_module(module)
from hypothesis import given, settings, strategies as st

@settings(max_examples=300)
@given(st.floats(), st.integers(), st.text(), st.binary())
def draw(real, integer, text, data):
    print(ascii((real, integer, text, data)))

draw()
"""


def inputs_beside(*modules: str) -> list[str]:
    command = [sys.executable, "-c", DRAW, *modules]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()


@pytest.mark.parametrize("module", first_by_default(["rig.control.excitation", "firmware_protocol.framing"]))
def test_inputs_do_not_depend_on_loaded_modules(module: str) -> None:
    alone = inputs_beside()
    assert len(alone) >= 300
    assert inputs_beside(module) == alone
